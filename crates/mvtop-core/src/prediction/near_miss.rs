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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum MissReason {
    /// Too low a detector score; `camera` and `box` are the map's peak if no box reaches the lower
    /// threshold.
    DetectorScore,
    /// Rays of the best boxes of two views do not meet: distance, metres.
    RaysApart,
    /// These boxes do not fit each other or the class: radius, and the nearest one that would do,
    /// metres.
    SizesDisagree,
    /// Detected in too few images: number of images.
    MinViews,
    /// The boxes give no crop or no pose.
    NoPose,
    /// A better object is there: its confidence, and that of the better one.
    Duplicate,
    /// Too low a confidence: confidence, and `search.min_confidence`.
    Confidence,
    /// Too far from the nearest prior: standard deviations.
    Prior,
    /// Not upright: degrees.
    Tilt,
    /// Not on the plane: metres above it.
    Height,
    /// Outside the region of the request.
    Region,
    /// Outside a polygon of the request.
    Polygons,
    /// Less probable than the `most` objects of the request.
    Most,
}
