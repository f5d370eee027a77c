//! Evaluations: poses of many images, measured against their truth.

/// A split of a data set in BOP's layout.
pub mod bop;
/// A folder of samples, each with a rig, its images and the truth.
pub mod samples;

mod bounds;
mod conditions;
mod noise;
mod observer;
mod outcome;
mod right;
mod sample;
mod summary;

pub use bounds::Bounds;
pub use conditions::Conditions;
pub use noise::Noise;
pub use observer::Observer;
pub use outcome::{Errors, Outcome};
pub use right::{ByConfidence, COLUMNS, Right};
pub use sample::Sample;
pub use summary::{Bin, Reliability, Summary};
