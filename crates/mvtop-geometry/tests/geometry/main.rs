//! Rigs, lenses, transforms and poses.

mod bad_rigs;
mod cameras;
mod examples;
mod lenses;
mod poses;
mod rigs;
mod transforms;
