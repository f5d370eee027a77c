//! Data sets and metrics.

mod bop;
mod groups;
mod metrics;

use mvtop_core::{Intrinsics, Projection};

fn brown_conrady(params: &[f64]) -> Projection {
    Projection::from_params("pinhole", Some("brown_conrady"), params).unwrap()
}

fn pinhole(focal: f64, cx: f64, cy: f64) -> Intrinsics {
    Intrinsics::new(focal, focal, cx, cy, Projection::Pinhole).unwrap()
}
