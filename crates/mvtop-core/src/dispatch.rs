/// Calls a function as compiled for the first of these instruction sets that the processor has, else
/// as compiled for every processor.
///
/// The function must be `#[inline(always)]`, so that it is compiled anew for each, and not `unsafe`.
#[doc(hidden)]
#[macro_export]
macro_rules! dispatch {
    ([$($set:tt),*], $portable:ident $arguments:tt -> $returned:ty) => {{
        $($crate::dispatch!(@if $set, $portable $arguments -> $returned);)*
        $crate::dispatch!(@call $portable $arguments)
    }};
    (@if $set:tt, $portable:ident ($($name:ident: $type:ty),*) -> $returned:ty) => {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!($set) {
            #[target_feature(enable = $set)]
            fn compiled($($name: $type),*) -> $returned {
                $portable($($name),*)
            }
            // SAFETY: the processor has just said that it has these instructions.
            return unsafe { compiled($($name),*) };
        }
    };
    (@call $portable:ident ($($name:ident: $type:ty),*)) => {
        $portable($($name),*)
    };
}
