//! How far one predicted pose is off, and what the network expected: one line of `--out`.

use mvtop_core::Prediction;
use mvtop_core::prediction::{ObjectPose, Sigma, Timings};
use mvtop_core::report::rows;
use serde::{Deserialize, Serialize};

use super::bounds::Bounds;
use super::sample::Sample;

/// One object of a sample's truth. What is predicted is null where it was not found.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Name of the sample.
    pub sample: String,
    /// Its place in the sample's truth.
    pub object: usize,
    /// Name of its class.
    pub class: String,
    /// Images of the sample.
    pub views: usize,
    /// Whether a pose is matched with it.
    pub found: bool,
    /// Rotation error.
    pub rot_deg: Option<f64>,
    /// Translation error.
    pub trans_m: Option<f64>,
    /// See [`Errors::by_symmetry`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by_symmetry: Vec<[f64; 2]>,
    /// ADD.
    pub add_m: Option<f64>,
    /// The network's.
    pub score: Option<f64>,
    /// Expected errors.
    pub sigma: Option<Sigma>,
    /// Probability that the pose is right.
    #[serde(default)]
    pub confidence: Option<f64>,
    /// Ids of the cameras whose boxes the pose was predicted from.
    pub cameras: Vec<String>,
    /// The predicted pose: object frame to world frame, rows of a matrix, metres.
    #[serde(rename = "T_world_obj")]
    pub t_world_obj: Option<[[f64; 4]; 4]>,
    /// Of the whole sample, milliseconds.
    pub timings_ms: Timings,
}

/// How far a pose is off.
#[derive(Debug, Clone)]
pub struct Errors {
    /// Rotation error.
    pub rot_deg: f64,
    /// Translation error.
    pub trans_m: f64,
    /// Where these two are the least over symmetries, each of another one: both errors of each symmetry
    /// than which none is better in both.
    pub by_symmetry: Vec<[f64; 2]>,
    /// `None` where the object has no points.
    pub add_m: Option<f64>,
}

impl Errors {
    /// Whether the pose counts as right.
    pub fn within(&self, bounds: &Bounds) -> bool {
        let within = |[rot_deg, trans_m]: [f64; 2]| {
            rot_deg <= bounds.right_deg && trans_m * 1e3 <= bounds.right_mm
        };
        let mut by_symmetry = self.by_symmetry.iter().copied();
        within([self.rot_deg, self.trans_m])
            && (self.by_symmetry.is_empty() || by_symmetry.any(within))
    }
}

impl Outcome {
    /// What is said of one object of a sample.
    ///
    /// - `object`: its place in the sample's truth
    /// - `found`: what was predicted for it, and its `errors`
    pub fn new(
        sample: &Sample,
        object: usize,
        prediction: &Prediction,
        found: Option<&ObjectPose>,
        errors: Option<Errors>,
    ) -> Self {
        let cameras = found.iter().flat_map(|found| &found.cameras);
        Self {
            sample: sample.name.clone(),
            object,
            class: sample.truth[object].seen.class.clone(),
            views: sample.images.len(),
            found: found.is_some(),
            rot_deg: errors.as_ref().map(|errors| errors.rot_deg),
            trans_m: errors.as_ref().map(|errors| errors.trans_m),
            add_m: errors.as_ref().and_then(|errors| errors.add_m),
            by_symmetry: errors.map_or(Vec::new(), |errors| errors.by_symmetry),
            score: found.map(|found| found.score),
            sigma: found.map(|found| found.sigma),
            confidence: found.and_then(|found| found.confidence),
            cameras: cameras
                .filter(|seen| seen.bbox.is_some())
                .map(|seen| sample.rig.cameras()[seen.camera].id().to_owned())
                .collect(),
            t_world_obj: found.map(|found| rows(&found.world_from_obj)),
            timings_ms: prediction.timings,
        }
    }

    /// `None` where it was not found.
    pub fn errors(&self) -> Option<Errors> {
        Some(Errors {
            rot_deg: self.rot_deg?,
            trans_m: self.trans_m?,
            by_symmetry: self.by_symmetry.clone(),
            add_m: self.add_m,
        })
    }
}
