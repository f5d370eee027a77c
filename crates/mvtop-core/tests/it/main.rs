//! Tests across modules, in one binary.

mod fixtures;
mod onnx;
mod parity;
