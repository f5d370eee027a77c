//! Up to which errors a pose counts as what.

use serde::Serialize;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bounds {
    /// Largest rotation error of a pose that counts as resolved.
    pub resolved_deg: f64,
    /// Largest errors of a pose that counts as right.
    pub right_deg: f64,
    pub right_mm: f64,
}
