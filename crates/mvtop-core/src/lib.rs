//! Multi-view 6-DoF object pose estimation from calibrated RGB cameras.
//!
//! Modules in the order of the flow from images to poses, which [`estimator`] spells out.

pub mod estimator;

pub mod rig;

pub mod camera;

pub mod known;

pub mod image;

pub mod rays;

pub mod sampling;

pub mod bundle;

pub mod onnx;

pub mod network;

pub mod detect;

pub mod associate;

pub mod closeup;

pub mod pose;

pub mod prediction;

pub mod report;

pub mod overlay;

pub mod transform;

mod error;

pub use camera::{Camera, Intrinsics, Projection};
pub use error::{Error, ErrorKind, Result};
pub use estimator::{Estimator, Options, PredictOptions};
pub use prediction::Prediction;
pub use rig::Rig;
