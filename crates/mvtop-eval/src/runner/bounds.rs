//! Up to which errors a pose counts as what.

use serde::Serialize;

/// Up to which errors a pose counts as resolved or as right.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bounds {
    /// Largest rotation error of a pose that counts as resolved.
    pub resolved_deg: f64,
    /// Largest rotation error of a pose that counts as right.
    pub right_deg: f64,
    /// Largest translation error of a pose that counts as right.
    pub right_mm: f64,
}

impl Default for Bounds {
    fn default() -> Self {
        Self {
            resolved_deg: 15.0,
            right_deg: 5.0,
            right_mm: 5.0,
        }
    }
}
