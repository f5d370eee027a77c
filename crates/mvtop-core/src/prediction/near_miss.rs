//! Why no object of a class is given.

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use crate::BBox;

/// What came nearest to an object of a class of which none is given.
#[derive(Debug, Clone, PartialEq)]
pub struct NearMiss {
    /// Name of the class in the bundle.
    pub class: String,
    /// What it failed at.
    pub reason: MissReason,
    /// Index in the rig of the camera that shows it best; `None` where no detection belongs to it.
    pub camera: Option<usize>,
    /// In this camera's image, px.
    pub bbox: Option<BBox>,
    /// Object frame to world frame, metres; `None` before it has a pose.
    pub world_from_obj: Option<Isometry3<f64>>,
    /// What was measured, in the unit of the reason.
    pub value: Option<f64>,
    /// What it should have reached, or not exceeded.
    pub threshold: Option<f64>,
    /// One sentence.
    pub message: String,
}

/// What an object failed at, by the order of the stages; the names in JSON stay as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum MissReason {
    /// The detector's score is below its threshold: scores.
    DetectorScore,
    /// Boxes of two views, too faint each alone, have rays that do not meet: metres.
    RaysApart,
    /// Their rays meet, where their sizes do not fit each other or the class: metres of radius.
    SizesDisagree,
    /// Detected in too few images: images.
    MinViews,
    /// The boxes give no pose: no numbers.
    NoPose,
    /// A better object is at its place: confidences, of both.
    Duplicate,
    /// The confidence is too low: probabilities.
    Confidence,
    /// Too far from the priors of its class: standard deviations.
    Prior,
    /// Not upright on its plane: degrees.
    Tilt,
    /// Above or below its plane: metres.
    Height,
    /// Found, outside the region: no numbers.
    Region,
    /// Found, outside a polygon: no numbers.
    Polygons,
    /// Found, less probable than as many others as were asked for: no numbers.
    Most,
}
