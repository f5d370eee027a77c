//! What the network is shown, what is wrong with it, and what counts as right.

use super::{Bounds, Noise};

/// Conditions of an evaluation; by default all views, exact as they are known, and detected boxes.
#[derive(Debug, Clone, PartialEq)]
pub struct Conditions {
    /// Only the reference camera and those that follow it, this many; all by default.
    pub views: Option<u32>,
    /// Fewest images in which an object must be detected.
    pub min_views: u32,
    /// Whether poses are refined; by default those of classes with a mesh are.
    pub refine: Option<bool>,
    /// Poses of a lower confidence are left out.
    pub min_confidence: Option<f64>,
    /// Whether the true boxes are used in place of detected ones.
    pub true_boxes: bool,
    /// What is added to the calibration and the true boxes.
    pub noise: Noise,
    /// What counts as right.
    pub bounds: Bounds,
}

impl Default for Conditions {
    fn default() -> Self {
        Self {
            views: None,
            min_views: 1,
            refine: None,
            min_confidence: None,
            true_boxes: false,
            noise: Noise::default(),
            bounds: Bounds::default(),
        }
    }
}
