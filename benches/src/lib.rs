//! What the benchmarks share.

use ndarray::{Array, Dimension, ShapeBuilder};
use std::path::{Path, PathBuf};

/// A path in the repository.
pub fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

/// Numbers from `low` to `high` that are the same in every run.
pub fn noise<D: Dimension>(
    shape: impl ShapeBuilder<Dim = D>,
    low: f32,
    high: f32,
) -> Array<f32, D> {
    let mut state = 1u64;
    Array::from_shape_simple_fn(shape, || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        low + (high - low) * (state >> 40) as f32 / (1u64 << 24) as f32
    })
}
