//! Errors of poses against the truth, under the names they were published by.
//!
//! Every error is in the unit of the points that it is measured on (degrees and pixels where the
//! name or the text says so), smaller is better, and a pose that was not found counts as
//! [`f64::INFINITY`]. `docs/how-to/evaluate-on-bop.md` lists them; `fixtures/metrics.safetensors`
//! holds what the BOP toolkit gives for the same poses.

mod depth;
mod kernel;
mod nearest;
mod recall;
mod rotation;
mod surface;
mod symmetry;
mod vsd;

pub use depth::{DepthImage, PixelCenter, depth};
pub(crate) use kernel::Affine;
pub use recall::{
    MSPD_THRESHOLDS_PX, MSSD_THRESHOLDS, MSSD_THRESHOLDS_MM, VSD_THRESHOLDS, auc_exact, auc_poet,
    auc_posecnn, average_precision, average_recall, recall,
};
pub use rotation::{rotation_error_deg, translation_error};
pub use surface::Surface;
pub use symmetry::{BOP_MAX_STEP, ContinuousSymmetry, Symmetries};
pub use vsd::{MatchingCost, VSD_TAUS, VsdOptions, vsd};
