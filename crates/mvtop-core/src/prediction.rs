//! What the estimator answers. [`crate::report`] writes it as JSON.

mod near_miss;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

use crate::BBox;
use crate::bundle::Bundle;
use crate::scorer::Scored;
use crate::symmetry::Symmetry;

pub use self::near_miss::{MissReason, NearMiss};

/// Poses of all objects, and how long each stage took.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Index of the reference camera in the rig.
    pub reference: usize,
    /// Best score first, or in the order of the given boxes; empty where nothing was detected.
    pub objects: Vec<ObjectPose>,
    /// How well the rig fits what was found; `None` where no object is seen by two cameras.
    pub rig_consistency: Option<RigConsistency>,
    /// How long each stage took.
    pub timings: Timings,
    /// Folder of the model bundle that answered.
    pub model: String,
    /// What executed the dense layers, for example `cpu`.
    pub provider: String,
    /// What makes the poses doubtful; empty where nothing does.
    pub warnings: Vec<Warning>,
    /// What came nearest of each class that was asked for and has no object; empty unless
    /// [`PredictOptions::why`](crate::PredictOptions::why) asks.
    pub near_misses: Vec<NearMiss>,
}

/// What makes poses doubtful, though it is no error.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// What it is, for programs.
    pub code: WarningCode,
    /// Index in the rig of the camera that it is about, where it is one.
    pub camera: Option<usize>,
    /// Index of the object that it is about, or that shows it most, where there is one.
    pub object: Option<usize>,
    /// One sentence: what was seen, and what to do.
    pub message: String,
}

/// Kinds of [`Warning`]; the names in JSON stay as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum WarningCode {
    /// The values of an image differ by at most 8 of 255. Is the camera covered or dead?
    OneColor,
    /// The rays of one view miss the object as the other views place it. Check camera pose, lens
    /// model, principal point, image of the right camera.
    LinesMiss,
    /// Objects appear larger or smaller than their distance implies. Check unit and scale of
    /// translations, focal lengths, image resolution.
    SizesDisagree,
    /// One view gives another rotation than the others. Check rotations (roll above all), axes,
    /// rotated or mirrored images.
    TurnsDisagree,
    /// Two cameras do not show the same objects; some objects appear in both. Check direction,
    /// axes, quaternion order, focal lengths; swapped, rotated or mirrored images; images of one
    /// moment.
    ViewsContradict,
    /// The same; no object appears in both.
    NothingMatches,
    /// Red and blue are exchanged. Give RGB; OpenCV reads BGR.
    ColorsExchanged,
}

/// How well the rig fits what was found, see [`crate::consistency`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigConsistency {
    /// How far the objects' projections are beside their boxes where these agree best: root mean
    /// square over the objects, of the camera where it is greatest, px.
    pub px: f64,
    /// The greatest of the following over its limit for a true rig; above 1 it is warned of.
    pub deviation: f64,
    /// What corrections of all cameras gain, about standard deviations.
    pub camera_deviation: f64,
    /// What one scale of the rig, or of its focal lengths, gains, about standard deviations.
    pub scale_deviation: f64,
    /// How far boxes of an object are off each other, standard deviations, lower median over objects; 0
    /// where poses of single views could be compared.
    pub box_deviation: f64,
    /// Log-likelihood ratio by which two cameras do not show the same objects.
    pub contradiction: f64,
    /// Objects that both of these cameras show at one pose.
    pub confirmed: usize,
    /// Objects that one of them shows, and the other should show but does not.
    pub unconfirmed: usize,
    /// Index in the rig of the camera where `px` is greatest; `None` where two cameras show objects, of which none is known
    /// to be the wrong one.
    pub worst_camera: Option<usize>,
}

/// One object.
#[derive(Debug, Clone)]
pub struct ObjectPose {
    /// Name of the class in the bundle.
    pub class: String,
    /// Number of the class in the bundle.
    pub class_id: i64,
    /// Probability that not all views that detected the object are wrong, `1 - Π (1 - s)` over the
    /// detector's scores; 1 for given boxes.
    pub score: f64,
    /// Object frame to the reference camera's frame, metres.
    pub ref_from_obj: Isometry3<f64>,
    /// Object frame to the world frame, metres.
    pub world_from_obj: Isometry3<f64>,
    /// How far the pose is expected to be off, by the network or by the refinement; of the position,
    /// at least what lines of sight miss each other by.
    pub sigma: Sigma,
    /// How far the views are from one pose of it, in standard deviations; `None` where fewer than two
    /// show it.
    pub deviation: Option<f64>,
    /// Share of the object's projection whose object coordinates agree with the pose, 0 to 1, mean over
    /// the views that should show it; `None` where the network gives no object coordinates.
    pub coordinate_inliers: Option<f64>,
    /// How the refinement of the pose on the images went; `None` where there was none.
    pub refinement: Option<Refinement>,
    /// Probability that the pose is within the bounds that the bundle states, see [`crate::scorer`];
    /// `None` of a bundle that was not calibrated.
    pub confidence: Option<f64>,
    /// What the confidence is made of.
    pub evidence: Option<Scored>,
    /// The poses that the object may have, far from each other: this one first, then by their
    /// probability. Empty where nothing but the pose itself is known.
    pub hypotheses: Vec<Hypothesis>,
    /// Index of the camera, of those of the rig that gave no image, in which the hypotheses differ
    /// most; `None` where there is one hypothesis or no such camera sees the object.
    pub next_view: Option<usize>,
    /// What no view tells: motions of the object after which it looks the same. Of the poses that
    /// look alike the one is given whose axes are nearest to those of the world frame.
    pub symmetry: Symmetry,
    /// Every camera that gave an image, in the rig's order.
    pub cameras: Vec<CameraPose>,
    /// Number by which a tracker knows the object over time; `None` of single predictions.
    pub track_id: Option<u64>,
}

impl ObjectPose {
    /// A pose of which nothing else is known; its expected error is 0.
    ///
    /// - `class`, `class_id`: name and number of the class
    /// - `ref_from_obj`, `world_from_obj`: object frame to the reference camera's and the world frame,
    ///   metres
    pub fn new(
        class: impl Into<String>,
        class_id: i64,
        score: f64,
        ref_from_obj: Isometry3<f64>,
        world_from_obj: Isometry3<f64>,
    ) -> Self {
        Self {
            class: class.into(),
            class_id,
            score,
            ref_from_obj,
            world_from_obj,
            sigma: Sigma::default(),
            deviation: None,
            coordinate_inliers: None,
            refinement: None,
            confidence: None,
            evidence: None,
            hypotheses: Vec::new(),
            next_view: None,
            symmetry: Symmetry::default(),
            cameras: Vec::new(),
            track_id: None,
        }
    }

    /// Middle of the box around its surface points, world frame, metres; its origin where the bundle
    /// does not know the class.
    pub(crate) fn middle(&self, bundle: &Bundle) -> Point3<f64> {
        let class = bundle.class_index(&self.class);
        let middle = class.map(|class| bundle.classes[class].middle());
        self.world_from_obj * middle.unwrap_or_else(Point3::origin)
    }
}

/// A pose that an object may have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hypothesis {
    /// Object frame to world frame, metres.
    pub world_from_obj: Isometry3<f64>,
    /// How far it is expected to be off if it is the right one.
    pub sigma: Sigma,
    /// Of all of the object's, they sum up to 1.
    pub probability: f64,
}

/// How the refinement of a pose went, see [`crate::refine`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Refinement {
    /// Whether the images fit the refined pose better; otherwise the initial one was kept.
    pub accepted: bool,
    /// Share of visible contour points with an edge within 1.5 px of the crop.
    pub contour_inliers: f64,
    /// Mean distance of these edges from the contour, px of the crop.
    pub contour_residual_px: f64,
    /// Mean foreground probability by color, inside minus outside the silhouette.
    pub color_separation: f64,
    /// Mutual information of segment and color, bits per pixel.
    pub mutual_information: f64,
    /// The same, least view.
    pub mutual_information_min: f64,
    /// Normalised cross-correlation of texture and images; null without texture.
    #[serde(default)]
    pub texture_correlation: Option<f64>,
    /// Expected error before refinement.
    pub initial_sigma: Sigma,
}

/// The error that is expected of a pose.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Sigma {
    /// Expected rotation error, without rotation about a symmetry axis, degrees.
    pub rot_deg: f64,
    /// Expected translation error, metres; after a warning of the rig at least the distance to
    /// single-view poses.
    pub t_m: f64,
}

/// One object as one camera sees it.
#[derive(Debug, Clone)]
pub struct CameraPose {
    /// Index of the camera in the rig.
    pub camera: usize,
    /// Object frame to camera frame, metres.
    pub cam_from_obj: Isometry3<f64>,
    /// In the camera's image; `None` where the object was not detected.
    pub bbox: Option<BBox>,
}

/// Wall time of each stage, milliseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Timings {
    /// Images resized and normalised, rays of the cells.
    pub prepare: f64,
    /// Backbone and detector on whole images.
    pub features: f64,
    /// Boxes from the detector, associated across views.
    pub detect: f64,
    /// Crops of objects: pixels, backbone and encoder.
    pub crop: f64,
    /// Candidate poses: decoder, PnP, perturbations.
    pub propose: f64,
    /// Refinement and scoring of the candidates.
    pub refine: f64,
    /// Duplicates, comparison of views, results.
    pub check: f64,
    /// Sum of all stages.
    pub total: f64,
}
