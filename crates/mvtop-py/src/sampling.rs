//! Deformable sampling.

use ndarray::{ArrayD, Dimension, Ix4, Ix5, Ix6};
use pyo3::prelude::*;

use crate::convert::{ArrayLike, F32};
use crate::error::{python, value};
use crate::process::compute;

/// Weighted bilinear reads of a multi-level feature map (Zhu et al., "Deformable DETR", eq. 3).
///
/// - value: (B, N, H, D), the cells of all levels, finest first, row by row
/// - locations: (B, Q, H, L, K, 2), x and y from 0 to 1 over the full extent of a level; what is
///   read outside is 0, and what is not finite contributes nothing
/// - weights: (B, Q, H, L, K)
/// - levels: height and width of each level, cells
/// - returns: (B, Q, H * D), float32
#[pyfunction]
pub fn deformable_sampling(
    py: Python,
    value: ArrayLike,
    locations: ArrayLike,
    weights: ArrayLike,
    levels: Vec<(usize, usize)>,
) -> PyResult<F32> {
    let value = axes::<Ix4>("value", value.any_number("value", Some(4), &[])?)?;
    let locations = axes::<Ix6>(
        "locations",
        locations.any_number("locations", Some(5), &[2])?,
    )?;
    let weights = axes::<Ix5>("weights", weights.any_number("weights", Some(5), &[])?)?;
    let out = compute(py, || {
        mvtop_core::sampling::deformable_sampling(
            value.view(),
            locations.view(),
            weights.view(),
            &levels,
        )
    })?;
    Ok(F32(out.map_err(python)?.into_dyn()))
}

fn axes<D: Dimension>(name: &str, array: ArrayD<f32>) -> PyResult<ndarray::Array<f32, D>> {
    array
        .into_dimensionality()
        .map_err(|cause| value(format!("{name}: {cause}")))
}
