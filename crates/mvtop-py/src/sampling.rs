//! Deformable sampling, forward and backward.

use mvtop_core::sampling::{self, Gradients, LevelShapes, Sampling};
use ndarray::{Ix3, Ix4, Ix5, Ix6};
use pyo3::prelude::*;

use crate::convert::{ArrayInPlace, ArrayLike, F32, axes};
use crate::error::python;
use crate::process::compute;

/// Weighted bilinear reads of a multi-level feature map (Zhu et al., "Deformable DETR", eq. 3).
///
/// Parameters
/// ----------
/// value : array, (B, N, H, D)
///     The cells of all levels, finest first, row by row.
/// locations : array, (B, Q, H, L, K, 2)
///     X and y from 0 to 1 over the full extent of a level; what is read outside is 0, and what
///     is not finite contributes nothing.
/// weights : array, (B, Q, H, L, K)
/// levels
///     Height and width of each level, cells.
///
/// Returns
/// -------
/// array, (B, Q, H * D), float32
#[pyfunction]
pub fn deformable_sampling(
    py: Python,
    value: ArrayLike,
    locations: ArrayLike,
    weights: ArrayLike,
    levels: Vec<(usize, usize)>,
) -> PyResult<F32> {
    let value = axes::<_, Ix4>("value", value.any_number("value", Some(4), &[])?)?;
    let locations = locations.any_number("locations", Some(5), &[2])?;
    let locations = axes::<_, Ix6>("locations", locations)?;
    let weights = axes::<_, Ix5>("weights", weights.any_number("weights", Some(5), &[])?)?;
    let (v, l, w) = (value.view(), locations.view(), weights.view());
    let out = compute(py, || sampling::deformable_sampling(v, l, w, &levels))?;
    Ok(F32(out.map_err(python)?.into_dyn()))
}

/// `deformable_sampling` into an array of the caller's: nothing is converted or copied.
///
/// Arrays are C-contiguous and of float32, their shapes those of `deformable_sampling`.
///
/// Parameters
/// ----------
/// out : array, (B, Q, H * D)
///     Overwritten.
///
/// Raises
/// ------
/// ValueError
///     For an array of another kind or shape.
#[pyfunction]
pub fn deformable_sampling_forward(
    py: Python,
    value: ArrayInPlace,
    locations: ArrayInPlace,
    weights: ArrayInPlace,
    levels: Vec<(usize, usize)>,
    out: ArrayInPlace,
) -> PyResult<()> {
    let levels = LevelShapes::new(&levels).map_err(python)?;
    let value = value.read::<Ix4>("value")?;
    let locations = locations.read::<Ix6>("locations")?;
    let weights = weights.read::<Ix5>("weights")?;
    let (value, locations, weights) = (value.as_array(), locations.as_array(), weights.as_array());
    let sampling = Sampling::of_arrays(&levels, value, locations, weights).map_err(python)?;
    let mut out = out.write::<Ix3>("out", &sampling.output_shape())?;
    let out = out.as_slice_mut()?;
    compute(py, || sampling.forward(out))?.map_err(python)
}

/// Gradients of what `deformable_sampling_forward` reads, from that of what it writes.
///
/// Arrays are C-contiguous and of float32.
///
/// Parameters
/// ----------
/// grad_out : array, (B, Q, H * D)
/// grad_value, grad_locations, grad_weights
///     Shaped as what they belong to, overwritten.
///
/// Raises
/// ------
/// ValueError
///     For an array of another kind or shape.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // each is an array of the definition
pub fn deformable_sampling_backward(
    py: Python,
    value: ArrayInPlace,
    locations: ArrayInPlace,
    weights: ArrayInPlace,
    levels: Vec<(usize, usize)>,
    grad_out: ArrayInPlace,
    grad_value: ArrayInPlace,
    grad_locations: ArrayInPlace,
    grad_weights: ArrayInPlace,
) -> PyResult<()> {
    let levels = LevelShapes::new(&levels).map_err(python)?;
    let value = value.read::<Ix4>("value")?;
    let locations = locations.read::<Ix6>("locations")?;
    let weights = weights.read::<Ix5>("weights")?;
    let (value, locations, weights) = (value.as_array(), locations.as_array(), weights.as_array());
    let sampling = Sampling::of_arrays(&levels, value, locations, weights).map_err(python)?;
    let grad_out = grad_out.read::<Ix3>("grad_out")?;
    let grad_out = grad_out.as_slice()?;
    let mut grad_value = grad_value.write::<Ix4>("grad_value", value.shape())?;
    let mut grad_locations = grad_locations.write::<Ix6>("grad_locations", locations.shape())?;
    let mut grad_weights = grad_weights.write::<Ix5>("grad_weights", weights.shape())?;
    let gradients = Gradients {
        value: grad_value.as_slice_mut()?,
        locations: grad_locations.as_slice_mut()?,
        weights: grad_weights.as_slice_mut()?,
    };
    compute(py, || sampling.backward(grad_out, gradients))?.map_err(python)
}
