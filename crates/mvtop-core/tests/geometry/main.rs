//! Images, crops and lines of sight.

mod closeups;
#[path = "../../../mvtop-geometry/tests/geometry/examples.rs"]
mod examples;
mod images;
mod rays;

use mvtop_core::{Camera, Intrinsics};
use nalgebra::Isometry3;

fn camera(intrinsics: Intrinsics, width: u32, height: u32) -> Camera {
    Camera::new("left", [width, height], intrinsics, Isometry3::identity()).unwrap()
}
