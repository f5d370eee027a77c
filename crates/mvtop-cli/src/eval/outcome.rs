//! How far one predicted pose is off, and what the network expected: one line of `--out`.

use mvtop_core::annotations::TruePose;
use mvtop_core::pose::{rotation_error_deg, translation_error};
use mvtop_core::prediction::{ObjectPose, Sigma, Timings};
use mvtop_core::report::rows;
use mvtop_core::{Estimator, Prediction};
use mvtop_eval::metrics::Surface;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::sample::Sample;

/// One object of a sample's truth. What is predicted is null where it was not found.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    pub sample: String,
    /// Its place in the sample's truth.
    pub object: usize,
    pub class: String,
    pub views: usize,
    pub found: bool,
    pub rot_deg: Option<f64>,
    pub trans_m: Option<f64>,
    pub add_m: Option<f64>,
    pub score: Option<f64>,
    pub sigma: Option<Sigma>,
    /// Ids of the cameras whose boxes the pose was predicted from.
    pub cameras: Vec<String>,
    #[serde(rename = "T_world_obj")]
    pub t_world_obj: Option<[[f64; 4]; 4]>,
    /// Of the whole sample, milliseconds.
    pub timings_ms: Timings,
}

/// The objects of a sample's truth, each with what was predicted for it.
///
/// - `matched`: by true object
pub fn outcomes(
    sample: &Sample,
    views: usize,
    prediction: &Prediction,
    matched: &[Option<&ObjectPose>],
    estimator: &Estimator,
) -> Vec<Outcome> {
    let rig = &sample.rig;
    let outcome = |(object, (known, &found)): (usize, (&TruePose, &Option<&ObjectPose>))| {
        let error = |of: fn(&TruePose, &nalgebra::Isometry3<f64>) -> f64| {
            found.map(|found| of(known, &found.world_from_obj))
        };
        let seen = found.iter().flat_map(|found| &found.cameras);
        Outcome {
            sample: sample.name.clone(),
            object,
            class: known.seen.class.clone(),
            views,
            found: found.is_some(),
            rot_deg: error(|known, pose| {
                rotation_error_deg(&known.world_from_obj.rotation, &pose.rotation)
            }),
            trans_m: error(|known, pose| translation_error(&known.world_from_obj, pose)),
            add_m: found.and_then(|found| {
                let bundle = estimator.bundle();
                let class = &bundle.classes[bundle.class_index(&found.class)?];
                let points: Vec<Point3<f64>> =
                    class.points.iter().map(|p| p.position.into()).collect();
                let surface = Surface::new(&points).ok()?; // there may be no points
                Some(surface.add(&known.world_from_obj, &found.world_from_obj))
            }),
            score: found.map(|found| found.score),
            sigma: found.map(|found| found.sigma),
            cameras: seen
                .filter(|seen| seen.bbox.is_some())
                .map(|seen| rig.cameras()[seen.camera].id().to_owned())
                .collect(),
            t_world_obj: found.map(|found| rows(&found.world_from_obj)),
            timings_ms: prediction.timings,
        }
    };
    let known = sample.truth.iter().zip(matched);
    known.enumerate().map(outcome).collect()
}
