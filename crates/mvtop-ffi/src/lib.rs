//! C interface to the sampling kernel, for training code that calls it through `ctypes`.
//!
//! All arrays are contiguous and row-major, `f32` but for `shapes`; layouts are those of
//! [`mvtop_core::sampling::Sampling`]. Every function that returns a status gives 0 on success,
//! 1 for a null pointer or a size that is not valid, 2 when the kernel panicked.

// C has no structs of slices: the arguments are the arrays and their axes.
#![allow(clippy::too_many_arguments)]

use mvtop_core::sampling::{Dims, Gradients, LevelShapes, Sampling};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice;
use std::sync::{Arc, Mutex, PoisonError};

const OK: i32 = 0;
const INVALID: i32 = 1;
const PANICKED: i32 = 2;

/// The pool asked for by [`mvtop_ffi_threads`]; rayon's own when none.
static POOL: Mutex<Option<Arc<ThreadPool>>> = Mutex::new(None);

/// Version of this interface; it changes with any signature or layout.
#[unsafe(no_mangle)]
pub extern "C" fn mvtop_ffi_version() -> u32 {
    1
}

/// Sets the number of threads of the following calls; 0 for one per processor.
#[unsafe(no_mangle)]
pub extern "C" fn mvtop_ffi_threads(threads: usize) -> i32 {
    status(|| {
        let pool = match threads {
            0 => None,
            n => Some(Arc::new(
                ThreadPoolBuilder::new().num_threads(n).build().ok()?,
            )),
        };
        *POOL.lock().unwrap_or_else(PoisonError::into_inner) = pool;
        Some(())
    })
}

/// Samples `value` `[b, N, h, d]` at `locations` `[b, q, h, levels, k, 2]` with `weights`
/// `[b, q, h, levels, k]` into `out` `[b, q, h·d]`; `shapes` holds `levels` pairs
/// (height, width), N being the sum of their products.
///
/// # Safety
/// Each pointer must be null or point to that many numbers, and `out` must overlap nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mvtop_deformable_sampling_forward(
    value: *const f32,
    locations: *const f32,
    weights: *const f32,
    shapes: *const i64,
    levels: usize,
    b: usize,
    n: usize,
    h: usize,
    d: usize,
    q: usize,
    k: usize,
    out: *mut f32,
) -> i32 {
    status(|| {
        let dims = Dims {
            batch: b,
            heads: h,
            head_dim: d,
            queries: q,
            points: k,
        };
        // SAFETY: promised by the caller.
        unsafe {
            let levels = read_levels(shapes, levels, n)?;
            let taps = product(&[b, q, h, levels.len(), k])?;
            let value = read(value, product(&[b, n, h, d])?)?;
            let locations = read(locations, taps.checked_mul(2)?)?;
            let sampling = Sampling::new(&levels, dims, value, locations, read(weights, taps)?);
            let out = write(out, product(&[b, q, h, d])?)?;
            in_pool(|| sampling.ok()?.forward(out).ok())
        }
    })
}

/// Gradients of the forward function's inputs for a gradient `grad_out` `[b, q, h·d]` of its
/// output; the three results have the layouts of the inputs and are overwritten.
///
/// # Safety
/// Each pointer must be null or point to that many numbers, and the results must overlap nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mvtop_deformable_sampling_backward(
    value: *const f32,
    locations: *const f32,
    weights: *const f32,
    shapes: *const i64,
    levels: usize,
    b: usize,
    n: usize,
    h: usize,
    d: usize,
    q: usize,
    k: usize,
    grad_out: *const f32,
    grad_value: *mut f32,
    grad_locations: *mut f32,
    grad_weights: *mut f32,
) -> i32 {
    status(|| {
        let dims = Dims {
            batch: b,
            heads: h,
            head_dim: d,
            queries: q,
            points: k,
        };
        // SAFETY: promised by the caller.
        unsafe {
            let levels = read_levels(shapes, levels, n)?;
            let values = product(&[b, n, h, d])?;
            let taps = product(&[b, q, h, levels.len(), k])?;
            let value = read(value, values)?;
            let locations = read(locations, taps.checked_mul(2)?)?;
            let sampling = Sampling::new(&levels, dims, value, locations, read(weights, taps)?);
            let grad_out = read(grad_out, product(&[b, q, h, d])?)?;
            let gradients = Gradients {
                value: write(grad_value, values)?,
                locations: write(grad_locations, taps.checked_mul(2)?)?,
                weights: write(grad_weights, taps)?,
            };
            in_pool(|| sampling.ok()?.backward(grad_out, gradients).ok())
        }
    })
}

fn status(run: impl FnOnce() -> Option<()>) -> i32 {
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(Some(())) => OK,
        Ok(None) => INVALID,
        Err(_) => PANICKED,
    }
}

fn in_pool<R: Send>(run: impl FnOnce() -> R + Send) -> R {
    let pool = POOL.lock().unwrap_or_else(PoisonError::into_inner).clone();
    match pool {
        Some(pool) => pool.install(run),
        None => run(),
    }
}

/// Number of elements of a shape; none when they could not be addressed.
fn product(shape: &[usize]) -> Option<usize> {
    let len = shape
        .iter()
        .try_fold(1usize, |n, &axis| n.checked_mul(axis))?;
    (len <= isize::MAX as usize / size_of::<f32>()).then_some(len)
}

/// # Safety
/// `shapes` must be null or point to `levels` pairs.
unsafe fn read_levels(shapes: *const i64, levels: usize, n: usize) -> Option<LevelShapes> {
    let len = product(&[levels, 2, 2])? / 2;
    // SAFETY: promised by the caller.
    let shapes = unsafe { read(shapes, len)? };
    let size = |side: i64| usize::try_from(side).ok();
    let shapes: Option<Vec<_>> = shapes
        .chunks_exact(2)
        .map(|s| Some((size(s[0])?, size(s[1])?)))
        .collect();
    let levels = LevelShapes::new(&shapes?).ok()?;
    (levels.cells() == n).then_some(levels)
}

/// # Safety
/// `data` must be null or point to `len` numbers that live as long as the call.
unsafe fn read<'a, T>(data: *const T, len: usize) -> Option<&'a [T]> {
    if len == 0 {
        return Some(&[]); // An empty tensor may have no address.
    }
    if data.is_null() || !data.is_aligned() {
        return None;
    }
    // SAFETY: promised by the caller; null was ruled out above.
    Some(unsafe { slice::from_raw_parts(data, len) })
}

/// # Safety
/// `data` must be null or point to `len` numbers that nothing else reads or writes meanwhile.
unsafe fn write<'a, T>(data: *mut T, len: usize) -> Option<&'a mut [T]> {
    if len == 0 {
        return Some(&mut []);
    }
    if data.is_null() || !data.is_aligned() {
        return None;
    }
    // SAFETY: promised by the caller; null was ruled out above.
    Some(unsafe { slice::from_raw_parts_mut(data, len) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ptr::null;

    fn forward(value: *const f32, n: usize, shapes: [i64; 2], out: &mut [f32; 1]) -> i32 {
        let (location, weight) = ([0.5f32, 0.5], [2.0f32]);
        unsafe {
            mvtop_deformable_sampling_forward(
                value,
                location.as_ptr(),
                weight.as_ptr(),
                shapes.as_ptr(),
                1,
                1,
                n,
                1,
                1,
                1,
                1,
                out.as_mut_ptr(),
            )
        }
    }

    #[test]
    fn forward_returns_zero_and_the_sample() {
        let mut out = [0.0];
        assert_eq!(forward([3.0].as_ptr(), 1, [1, 1], &mut out), OK);
        assert_eq!(out, [6.0]);
    }

    #[test]
    fn null_pointers_and_wrong_sizes_return_invalid() {
        let mut out = [0.0];
        assert_eq!(forward(null(), 1, [1, 1], &mut out), INVALID);
        assert_eq!(forward([3.0].as_ptr(), 1, [-1, 1], &mut out), INVALID);
        assert_eq!(forward([3.0].as_ptr(), 1, [0, 1], &mut out), INVALID);
        assert_eq!(forward([3.0].as_ptr(), 1, [1, 2], &mut out), INVALID);
        assert_eq!(
            forward([3.0].as_ptr(), usize::MAX, [1, 1], &mut out),
            INVALID
        );
    }

    #[test]
    fn any_number_of_threads_is_accepted() {
        for threads in [1, 3, 0] {
            assert_eq!(mvtop_ffi_threads(threads), OK);
            let mut out = [0.0];
            assert_eq!(forward([3.0].as_ptr(), 1, [1, 1], &mut out), OK);
            assert_eq!(out, [6.0]);
        }
    }

    #[test]
    fn a_panic_becomes_a_status() {
        assert_eq!(status(|| panic!("expected by the test")), PANICKED);
    }
}
