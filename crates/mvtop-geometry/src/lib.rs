//! Geometry of calibrated cameras: lenses, rigs, rigid transforms, lines of sight, symmetries, and
//! errors of poses.
//!
//! Frames, axes, pixels and units are those of `CONVENTIONS.md`: OpenCV's camera axes (x right, y
//! down, z forward), pixel centers at integers, metres. `a_from_b` takes coordinates of frame b to
//! frame a.

#![deny(missing_docs)]

/// One calibrated camera: between points and pixels, whatever its lens.
pub mod camera;

/// Calibrated cameras in one world frame, from numbers or from a rig file.
pub mod rig;

/// Rigid transforms from numbers, checked.
pub mod transform;

mod bbox;

/// Lines of sight, of pixels and of boxes.
pub mod rays;

/// Rotations, and errors of poses.
pub mod pose;

/// What no view tells: turns after which an object looks the same.
pub mod symmetry;

/// Files, read whole and bounded.
pub mod file;

/// Files of JSON.
pub mod json;

mod error;

pub use bbox::BBox;
pub use camera::{Camera, Intrinsics, Projection};
pub use error::{Error, Result};
pub use nalgebra;
pub use rig::Rig;

// The example of the README, compiled.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
