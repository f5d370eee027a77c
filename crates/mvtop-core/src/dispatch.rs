/// Calls a function as compiled for the first of these instruction sets that the processor has, else
/// as compiled for every processor. A set is one extension or several, joined by `&`.
///
/// The function must be `#[inline(always)]`, so that it is compiled anew for each, and not `unsafe`.
/// Where another one does for every processor, it stands after `else`.
#[doc(hidden)]
#[macro_export]
macro_rules! dispatch {
    ([$($($extension:tt)&+),*], $function:ident $arguments:tt -> $returned:ty) => {
        $crate::dispatch!([$($($extension)&+),*], $function $arguments -> $returned, else $function)
    };
    ([$($($extension:tt)&+),*], $function:ident $arguments:tt -> $returned:ty, else $portable:ident) => {{
        $($crate::dispatch!(@if [$($extension)&+], $function $arguments -> $returned);)*
        $crate::dispatch!(@call $portable $arguments)
    }};
    (@if [$($extension:tt)&+], $function:ident ($($name:ident: $type:ty),*) -> $returned:ty) => {
        #[cfg(target_arch = "x86_64")]
        if $(std::arch::is_x86_feature_detected!($extension))&&+ {
            $(#[target_feature(enable = $extension)])+
            fn compiled($($name: $type),*) -> $returned {
                $function($($name),*)
            }
            // SAFETY: the processor has just said that it has these instructions.
            return unsafe { compiled($($name),*) };
        }
    };
    (@call $portable:ident ($($name:ident: $type:ty),*)) => {
        $portable($($name),*)
    };
}
