//! Multi-view 6-DoF object pose estimation from calibrated RGB cameras.
//!
//! Modules in the order of the flow from images to poses.

pub mod rig;

pub mod camera;

pub mod image;

pub mod rays;

pub mod sampling;

pub mod bundle;

pub mod onnx;

pub mod detect;

pub mod associate;

pub mod pose;

mod error;

pub use camera::{Camera, Distortion, Lens};
pub use error::{Error, Result};
pub use rig::Rig;
