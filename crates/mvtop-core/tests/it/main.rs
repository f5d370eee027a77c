//! Tests across modules, in one binary.

mod estimator;
mod fixtures;
mod onnx;
mod parity;
mod pipeline;
mod reference;
mod request;
mod settings;
