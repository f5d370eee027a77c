//! What data sets need: reading them, measuring poses against their truth, and checking that no split leaks
//! into another. Knows of networks only what [`mvtop_core`] predicts.

#![deny(missing_docs)]

/// Data sets in BOP's layout: scenes, models, targets, results, groups of views.
pub mod bop;
/// Files of results.
pub mod files;
/// Poses of one split that recur in another.
pub mod leakage;
/// Which prediction is of which true object.
pub mod matching;
/// Errors of poses against the truth, under the names they were published by.
pub mod metrics;
/// Evaluations: of samples, and of data sets in BOP's layout.
pub mod runner;
/// What expected and actual errors say of each other: AUROC, correlation, calibration.
pub mod statistics;

pub use mvtop_core::{Error, Result};
