//! Multi-view 6-DoF object pose estimation from calibrated RGB cameras.
//!
//! Modules in the order of the flow from images to poses, which [`estimator`] spells out.

#![deny(missing_docs)]

/// From images and a rig to poses: the whole way.
pub mod estimator;

/// Boxes that are given and poses that are true, from files.
pub mod annotations;

/// Computations that end when it is asked.
pub mod cancel;

mod dispatch;

mod parallel;

/// Images, from file to the network's input.
pub mod image;

/// Lines of sight, by which the network knows cameras.
pub mod rays;

/// The sampling of feature maps, as the network's operator does it.
pub mod sampling;
pub mod scorer;

/// Surfaces of objects as triangles, from PLY files.
pub mod mesh;

/// A model: its folder, checked.
pub mod bundle;

/// Graphs in ONNX Runtime.
#[cfg(feature = "onnx")]
pub mod onnx;

/// The network's parts as the estimator sees them.
pub mod network;

mod detect;

mod associate;

/// What a box shows, through a virtual camera of its own.
pub mod closeup;

/// Poses made exact on the images, by the object's mesh.
pub mod refine;

/// How well boxes, poses and the calibration agree.
pub mod consistency;

/// Where cameras stand by what their images show.
pub mod calibration;

/// What the estimator answers.
pub mod prediction;

/// The probability that a pose is right.
pub mod config;

/// What is asked of the images: which objects, where, in which frame.
pub mod request;

/// A prediction as JSON.
pub mod report;

/// JSON Schemas of documents, made of their types.
#[cfg(feature = "schema")]
pub mod schema;

/// Pictures of a prediction.
#[cfg(feature = "overlay")]
pub mod overlay;

/// One error for the whole crate, and how to print it.
pub mod error;

pub use error::{Error, ErrorKind, Result};
pub use estimator::{Estimator, Options, PredictOptions, Tracker};
pub use image::ViewImage;
pub use mvtop_geometry::{BBox, Camera, Intrinsics, Projection, Rig};
pub use mvtop_geometry::{camera, file, json, nalgebra, pose, rig, symmetry, transform};
pub use ndarray;
pub use prediction::Prediction;
pub use request::Request;

// The example of the documentation, compiled.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/reference/rust.md")]
struct Documentation;
