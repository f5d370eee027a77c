//! Data sets and metrics.

mod bop;
mod metrics;

use mvtop_core::camera::BrownConrady;
use mvtop_core::{Distortion, Lens};

fn brown_conrady(params: &[f64]) -> Distortion {
    Distortion::BrownConrady(BrownConrady::new(params).unwrap())
}

fn pinhole(focal: f64, cx: f64, cy: f64) -> Lens {
    Lens {
        fx: focal,
        fy: focal,
        cx,
        cy,
        distortion: Distortion::None,
    }
}
