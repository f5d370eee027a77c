//! A prediction as JSON. `docs/reference/json.md` describes it.

use std::collections::BTreeMap;

use nalgebra::Isometry3;
use serde::Serialize;

use crate::error::harmless;
use crate::pose::wxyz;
use crate::prediction::{
    CameraPose, Hypothesis, MissReason, NearMiss, ObjectPose, Prediction, Refinement, Sigma,
    Timings, Warning, WarningCode,
};
use crate::request::LeftOut;
use crate::scorer::{POSE_TERMS, Scored, VIEW_TERMS, Verdict, ViewEvidence};
use crate::symmetry::{Axis, Symmetry};
use crate::{BBox, Camera, Error, Result, Rig};

/// Raised when a key changes its meaning or goes away; new keys leave it as it is.
pub const SCHEMA_VERSION: u32 = 1;

/// The whole document.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Id of the reference camera.
    pub reference: String,
    /// Best score first, or in the order of the given boxes.
    pub objects: Vec<Object>,
    /// How well the rig fits what was found; null where no object is seen by two cameras.
    pub rig_consistency: Option<ReportedConsistency>,
    /// Wall time of each stage, milliseconds.
    pub timings_ms: Timings,
    /// What executed the dense layers.
    pub provider: String,
    /// What makes the poses doubtful; empty where nothing does.
    pub warnings: Vec<ReportedWarning>,
    /// Name of the frame of `T_frame_obj`; left out where none was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
    /// Objects that were found but not asked for; left out where all were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_out: Option<LeftOut>,
    /// What came nearest of each class without an object; left out where that was not asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<Vec<ReportedNearMiss>>,
}

/// A [`crate::prediction::NearMiss`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedNearMiss {
    /// Name of the class in the bundle.
    pub class: String,
    /// What it failed at, for programs.
    pub reason: MissReason,
    /// Id of the camera that shows it best, null where no detection belongs to it.
    pub camera: Option<String>,
    /// In this camera's image, px.
    #[serde(rename = "box")]
    pub bbox: Option<BBox>,
    /// Object frame to world frame, null before it has a pose: rows of the homogeneous matrix, metres.
    #[serde(rename = "T_world_obj")]
    pub t_world_obj: Option<[[f64; 4]; 4]>,
    /// What was measured, in the unit of the reason.
    pub value: Option<f64>,
    /// What it should have reached, or not exceeded.
    pub threshold: Option<f64>,
    /// One sentence.
    pub message: String,
}

/// The near misses of a prediction.
pub(crate) fn near_misses(prediction: &Prediction, rig: &Rig) -> Vec<ReportedNearMiss> {
    let told = |miss: &NearMiss| ReportedNearMiss {
        class: miss.class.clone(),
        reason: miss.reason,
        camera: miss.camera.map(|camera| id_of(rig, camera)),
        bbox: miss.bbox,
        t_world_obj: miss.world_from_obj.as_ref().map(rows),
        value: miss.value,
        threshold: miss.threshold,
        message: miss.message.clone(),
    };
    prediction.near_misses.iter().map(told).collect()
}

/// Id of a camera, by its index.
fn id_of(rig: &Rig, camera: usize) -> String {
    rig.cameras().get(camera).map_or("", Camera::id).to_owned()
}

/// A [`crate::prediction::Warning`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedWarning {
    /// What it is, for programs.
    pub code: WarningCode,
    /// Id of the camera that it is about, null where it is not one.
    pub camera: Option<String>,
    /// Index of the object that it is about, or that shows it most, null where there is none.
    pub object: Option<usize>,
    /// One sentence: what was seen, and what to do.
    pub message: String,
}

/// A [`crate::prediction::RigConsistency`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedConsistency {
    /// How far projections are beside their boxes, px.
    pub px: f64,
    /// See [`RigConsistency::deviation`](crate::prediction::RigConsistency::deviation).
    pub deviation: f64,
    /// What corrections of all cameras gain.
    pub camera_deviation: f64,
    /// What one scale gains.
    pub scale_deviation: f64,
    /// How far boxes of an object are off each other.
    pub box_deviation: f64,
    /// How far two cameras do not show the same objects.
    pub contradiction: f64,
    /// Objects that both of them show.
    pub confirmed: usize,
    /// Objects that one of them shows, and the other should show but does not.
    pub unconfirmed: usize,
    /// Id of the camera where `px` is most, null of two cameras.
    pub worst_camera: Option<String>,
}

/// One object.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Object {
    /// Name of the class in the bundle.
    pub class: String,
    /// Number of the class in the bundle.
    pub class_id: i64,
    /// See [`ObjectPose::score`].
    pub score: f64,
    /// Object frame to reference camera frame: rows of the homogeneous matrix, metres.
    #[serde(rename = "T_ref_obj")]
    pub t_ref_obj: [[f64; 4]; 4],
    /// Object frame to world frame.
    #[serde(rename = "T_world_obj")]
    pub t_world_obj: [[f64; 4]; 4],
    /// Object frame to the frame that was asked for; left out where none was.
    #[serde(rename = "T_frame_obj", skip_serializing_if = "Option::is_none")]
    pub t_frame_obj: Option<[[f64; 4]; 4]>,
    /// Translation of `T_ref_obj`, metres.
    pub t_m: [f64; 3],
    /// Rotation of `T_ref_obj` as a unit quaternion, `w >= 0`.
    pub q_wxyz: [f64; 4],
    /// How far the pose is expected to be off.
    pub sigma: Sigma,
    /// See [`ObjectPose::coordinate_inliers`].
    pub coordinate_inliers: Option<f64>,
    /// How its refinement went; null where there was none.
    pub refinement: Option<Refinement>,
    /// Probability that the pose is within the bounds that the bundle states; null where it states
    /// none, or the pose was not refined.
    pub confidence: Option<f64>,
    /// What that is made of, by name; null where nothing is known.
    pub evidence: Option<Evidence>,
    /// Whether it is certain enough, null where that was not asked.
    pub verdict: Option<Verdict>,
    /// The poses that it may have, this one first, then by their probability.
    pub hypotheses: Vec<ReportedHypothesis>,
    /// Id of the camera, of those that gave no image, in which the hypotheses differ most; null
    /// where there is one hypothesis or no such camera sees the object.
    pub next_view: Option<String>,
    /// What no view tells; null where the pose is the only one that looks like this.
    pub symmetry: Option<Undetermined>,
    /// Every camera that gave an image.
    pub cameras: Vec<ObjectInCamera>,
    /// How to grasp it; left out where that was not asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grasps: Option<Vec<ReportedGrasp>>,
    /// Number by which a tracker knows it over time; left out of single predictions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub track_id: Option<u64>,
}

/// One way to grasp an object, [`crate::request::Grasp`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedGrasp {
    /// As in the bundle's file.
    pub name: String,
    /// Tool frame to the frame that was asked for: rows of the homogeneous matrix, metres.
    #[serde(rename = "T_frame_tool")]
    pub t_frame_tool: [[f64; 4]; 4],
    /// Opening of the gripper, metres.
    pub opening_m: f64,
    /// Whether the gripper would touch another object that was found, given or not; null where its
    /// shape is not known.
    pub collides: Option<bool>,
    /// Indices of those that are given; null likewise.
    pub collides_with: Option<Vec<usize>>,
}

/// Poses that look like the one that is given, [`ObjectPose::symmetry`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Undetermined {
    /// How many poses look alike but for turns about the axis, this one among them.
    pub poses: usize,
    /// An axis in the object's frame about which any turn looks the same.
    pub axis: Option<Axis>,
}

impl Undetermined {
    fn of(symmetry: &Symmetry) -> Option<Self> {
        (!symmetry.is_none()).then(|| Self {
            poses: 1 + symmetry.discrete.len(),
            axis: symmetry.axis,
        })
    }
}

/// A [`Hypothesis`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedHypothesis {
    /// Object frame to world frame: rows of the homogeneous matrix, metres.
    #[serde(rename = "T_world_obj")]
    pub t_world_obj: [[f64; 4]; 4],
    /// How far it is expected to be off if it is the right one.
    pub sigma: Sigma,
    /// Of all of the object's, they sum up to 1.
    pub probability: f64,
}

impl ReportedHypothesis {
    fn of(hypothesis: &Hypothesis) -> Self {
        Self {
            t_world_obj: rows(&hypothesis.world_from_obj),
            sigma: hypothesis.sigma,
            probability: hypothesis.probability,
        }
    }
}

/// One object as one camera sees it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ObjectInCamera {
    /// Id of the camera.
    pub id: String,
    /// Object frame to camera frame.
    #[serde(rename = "T_cam_obj")]
    pub t_cam_obj: [[f64; 4]; 4],
    /// In the camera's image, null where the object was not detected.
    #[serde(rename = "box")]
    pub bbox: Option<BBox>,
    /// Whether there is a box.
    pub detected: bool,
}

/// What the confidence of a pose is made of, see [`crate::scorer`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evidence {
    /// Natural logarithm of the odds of this pose by itself.
    pub log_odds: f64,
    /// The same before refinement.
    pub initial_log_odds: f64,
    /// Of the pose as a whole, by name.
    pub pose: BTreeMap<&'static str, f64>,
    /// Of each view that should show the object, by name.
    pub views: Vec<BTreeMap<&'static str, f64>>,
}

impl Evidence {
    fn of(scored: &Scored) -> Self {
        let of_view = |view: &ViewEvidence| {
            let named = VIEW_TERMS.into_iter().zip(view.terms());
            named.chain([("visible", view.visible)]).collect()
        };
        Self {
            log_odds: scored.log_odds,
            initial_log_odds: scored.initial_log_odds,
            pose: POSE_TERMS.into_iter().zip(scored.terms).collect(),
            views: scored.views.iter().map(of_view).collect(),
        }
    }
}

impl Report {
    /// The document of a prediction.
    ///
    /// - `rig`: the one that the prediction was made with
    pub fn new(prediction: &Prediction, rig: &Rig) -> Self {
        let id = |camera| id_of(rig, camera);
        let objects = prediction.objects.iter();
        let warning = |warning: &Warning| ReportedWarning {
            code: warning.code,
            camera: warning.camera.map(id),
            object: warning.object,
            message: warning.message.clone(),
        };
        Self {
            schema_version: SCHEMA_VERSION,
            reference: id(prediction.reference),
            objects: objects.map(|object| Object::new(object, id)).collect(),
            rig_consistency: prediction.rig_consistency.map(|fit| ReportedConsistency {
                px: fit.px,
                deviation: fit.deviation,
                camera_deviation: fit.camera_deviation,
                scale_deviation: fit.scale_deviation,
                box_deviation: fit.box_deviation,
                contradiction: fit.contradiction,
                confirmed: fit.confirmed,
                unconfirmed: fit.unconfirmed,
                worst_camera: fit.worst_camera.map(id),
            }),
            timings_ms: prediction.timings,
            provider: prediction.provider.clone(),
            warnings: prediction.warnings.iter().map(warning).collect(),
            frame: None,
            left_out: None,
            why: None,
        }
    }

    /// The text of the document, for people to look into as well.
    ///
    /// Names in it are harmless to a terminal, see [`harmless`].
    ///
    /// # Errors
    /// [`Error::Data`] where it cannot be written.
    pub fn to_json(&self) -> Result<String> {
        let text = serde_json::to_string_pretty(self);
        let text = text.map_err(|cause| Error::Data(format!("cannot write JSON: {cause}")))?;
        Ok(harmless(&text))
    }
}

impl Object {
    fn new(object: &ObjectPose, id: impl Fn(usize) -> String) -> Self {
        let in_camera = |seen: &CameraPose| ObjectInCamera {
            id: id(seen.camera),
            t_cam_obj: rows(&seen.cam_from_obj),
            bbox: seen.bbox,
            detected: seen.bbox.is_some(),
        };
        Self {
            class: object.class.clone(),
            class_id: object.class_id,
            score: object.score,
            t_ref_obj: rows(&object.ref_from_obj),
            t_world_obj: rows(&object.world_from_obj),
            t_m: object.ref_from_obj.translation.vector.into(),
            q_wxyz: wxyz(&object.ref_from_obj.rotation),
            sigma: object.sigma,
            coordinate_inliers: object.coordinate_inliers,
            refinement: object.refinement,
            confidence: object.confidence,
            evidence: object.evidence.as_ref().map(Evidence::of),
            verdict: None,
            hypotheses: object
                .hypotheses
                .iter()
                .map(ReportedHypothesis::of)
                .collect(),
            next_view: object.next_view.map(&id),
            symmetry: Undetermined::of(&object.symmetry),
            cameras: object.cameras.iter().map(in_camera).collect(),
            t_frame_obj: None,
            grasps: None,
            track_id: object.track_id,
        }
    }
}

/// Rows of the homogeneous matrix.
pub fn rows(pose: &Isometry3<f64>) -> [[f64; 4]; 4] {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

#[cfg(test)]
mod tests;
