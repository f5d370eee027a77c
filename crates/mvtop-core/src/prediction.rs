//! What the estimator answers. [`crate::report`] writes it as JSON.

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use crate::BBox;
use crate::symmetry::Symmetry;

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
    /// What executed the dense layers, for example `cpu`.
    pub provider: String,
    /// What makes the poses doubtful; empty where nothing does.
    pub warnings: Vec<Warning>,
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
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum WarningCode {
    /// An image is of one color, up to noise: its camera is covered, dead or blinded.
    OneColor,
    /// Lines of sight through the boxes of one object miss each other.
    LinesMiss,
    /// Boxes of one object have another size than their distances by the rig give them.
    SizesDisagree,
    /// An object is turned otherwise in one view than in the others.
    TurnsDisagree,
    /// One camera alone finds an object in view of another, which finds its own elsewhere.
    ViewsContradict,
    /// Cameras find objects of one class, but none that two of them see.
    NothingMatches,
}

/// How well the rig fits what was found, see [`crate::consistency`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigConsistency {
    /// How far the objects' projections are beside their boxes where these agree best: root mean
    /// square over the objects, of the camera where it is greatest, px.
    pub px: f64,
    /// How far the views are from one pose of an object, in standard deviations of what each tells by
    /// itself; of several objects, the lower median. Warned of above the bundle's `most_deviation`.
    pub deviation: f64,
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
    /// Of what the object would cover in the images at this pose, the share that shows it so, by the
    /// object coordinates, 0 to 1: less where much of it is hidden or only one of the views has a box
    /// of it, and least where it is something else. `None` where the network gives no object coordinates.
    pub support: Option<f64>,
    /// How the refinement of the pose on the images went; `None` where there was none.
    pub refinement: Option<Refinement>,
    /// Probability that the pose is within the bounds that the bundle states, see
    /// [`crate::confidence`]; `None` where it states none or the pose was not refined.
    pub confidence: Option<f64>,
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
pub struct Refinement {
    /// Whether the images fit the refined pose better than the one before; otherwise that was kept.
    pub accepted: bool,
    /// Share of the mesh's visible edges that the images show where the pose has them.
    pub supported: f64,
    /// Mean distance of these edges from where the images show them, px of close-ups.
    pub residual_px: f64,
    /// How likely a pixel within the silhouette is of the object by its color, less how likely one
    /// next to it is, mean over views: 1 where colors tell them apart everywhere, 0 where they do not.
    pub overlap: f64,
    /// What knowing the part of the object tells of a pixel's color, bits, mean over views.
    pub explained: f64,
    /// Likewise, of the view where it is least.
    pub explained_least: f64,
    /// How far the images look like what is printed on the object, mean over the views that tell:
    /// correlation of color and brightness, at most 1; `None` without print.
    #[serde(default)]
    pub print: Option<f64>,
    /// How far the network expected its pose to be off, as it may have been another one.
    pub sigma_before: Sigma,
}

/// The error that is expected of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sigma {
    /// Expected angle between the true and the predicted rotation, degrees.
    pub rot_deg: f64,
    /// Standard deviation of the translation, metres.
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
pub struct Timings {
    /// Images resized and normalised, lines of sight of the cells computed.
    pub prepare: f64,
    /// Backbone and detector on the whole images, and the encoder where there are no close-ups.
    pub features: f64,
    /// Boxes read off the detector's maps and associated across views.
    pub detect: f64,
    /// Close-ups of the boxes: pictures, backbone and encoder; 0 where the bundle has none.
    pub closeup: f64,
    /// Pose decoder.
    pub decode: f64,
    /// Poses refined on the images; 0 where none is.
    #[serde(default)]
    pub refine: f64,
    /// What each view tells by itself compared with the others.
    #[serde(default)]
    pub check: f64,
    /// All of these together.
    pub total: f64,
}
