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

/// The whole document. Lengths are metres; `T_a_b` maps coordinates of frame b into frame a, rows of the
/// homogeneous matrix.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Report {
    /// Raised when a key changes or disappears.
    pub schema_version: u32,
    /// Id of the reference camera.
    pub reference: String,
    /// Most probable first, or in the order of the given boxes.
    pub objects: Vec<Object>,
    /// How well the rig fits the images; null if no two cameras see an object.
    pub rig_consistency: Option<ReportedConsistency>,
    /// Wall time of each stage, milliseconds.
    pub timings_ms: Timings,
    /// Folder of the model bundle.
    pub model: String,
    /// ONNX Runtime's execution provider.
    pub provider: String,
    /// Reasons to doubt the poses.
    pub warnings: Vec<ReportedWarning>,
    /// Frame of `T_frame_obj`, if one was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
    /// Number of objects found but not asked for, if some were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_out: Option<LeftOut>,
    /// The nearest candidate of each class without an object, if asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<Vec<ReportedNearMiss>>,
}

/// A [`crate::prediction::NearMiss`].
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "NearMiss")
)]
pub struct ReportedNearMiss {
    /// Class name.
    pub class: String,
    /// Check that it failed.
    pub reason: MissReason,
    /// Camera of its best detection; null if it has none.
    pub camera: Option<String>,
    /// This detection, px.
    #[serde(rename = "box")]
    pub bbox: Option<BBox>,
    /// Object to world, null if it has no pose.
    #[serde(rename = "T_world_obj")]
    pub t_world_obj: Option<[[f64; 4]; 4]>,
    /// Measured value, in the unit of the reason.
    pub value: Option<f64>,
    /// Bound of the value.
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
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "Warning")
)]
pub struct ReportedWarning {
    /// Stable name.
    pub code: WarningCode,
    /// Camera id, or null.
    pub camera: Option<String>,
    /// Index of the object with the largest deviation, or null.
    pub object: Option<usize>,
    /// One sentence: observation and advice.
    pub message: String,
}

/// A [`crate::prediction::RigConsistency`].
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "RigConsistency")
)]
pub struct ReportedConsistency {
    /// Reprojection distance of boxes, RMS over objects, worst camera, px.
    pub px: f64,
    /// The largest of the next four over its limit; a warning above 1.
    pub deviation: f64,
    /// Gain by corrected camera poses, standard deviations.
    pub camera_deviation: f64,
    /// Gain by one scale, standard deviations.
    pub scale_deviation: f64,
    /// Disagreement of the boxes of an object, standard deviations.
    pub box_deviation: f64,
    /// Log-likelihood ratio of two cameras that do not show the same objects.
    pub contradiction: f64,
    /// Objects that both of these cameras show.
    pub confirmed: usize,
    /// Objects that only one of them shows, though the other should.
    pub unconfirmed: usize,
    /// Camera with the largest `px`; null for two cameras.
    pub worst_camera: Option<String>,
}

/// One object.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Object {
    /// Class name.
    pub class: String,
    /// Class number.
    pub class_id: i64,
    /// 1 - Π (1 - s) over the detector scores s of the views; 1 for given boxes.
    pub score: f64,
    /// Object to reference camera.
    #[serde(rename = "T_ref_obj")]
    pub t_ref_obj: [[f64; 4]; 4],
    /// Object to world.
    #[serde(rename = "T_world_obj")]
    pub t_world_obj: [[f64; 4]; 4],
    /// Object to the frame that was asked for.
    #[serde(rename = "T_frame_obj", skip_serializing_if = "Option::is_none")]
    pub t_frame_obj: Option<[[f64; 4]; 4]>,
    /// Translation of `T_ref_obj`, metres.
    pub t_m: [f64; 3],
    /// Rotation of `T_ref_obj` as a unit quaternion with `w >= 0`.
    pub q_wxyz: [f64; 4],
    /// Expected error of the pose.
    pub sigma: Sigma,
    /// Share of the projection whose object coordinates agree with the pose; null if the model has
    /// none.
    pub coordinate_inliers: Option<f64>,
    /// Result of the refinement, means over views; null without. If it is not `accepted`, the initial pose is
    /// reported.
    pub refinement: Option<Refinement>,
    /// Probability that the pose is within the bundle's bounds (5° and 5 mm); null without
    /// calibration.
    pub confidence: Option<f64>,
    /// What the confidence is computed from; null if nothing is known.
    pub evidence: Option<Evidence>,
    /// By the confidence that was asked for, else null.
    pub verdict: Option<Verdict>,
    /// Distinct poses, the reported one first.
    pub hypotheses: Vec<ReportedHypothesis>,
    /// Unused camera whose view separates the hypotheses best, or null.
    pub next_view: Option<String>,
    /// Equivalent poses, or null. The pose closest to the axes of the world is reported.
    pub symmetry: Option<Undetermined>,
    /// Every camera that gave an image.
    pub cameras: Vec<ObjectInCamera>,
    /// The bundle's grasps, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grasps: Option<Vec<ReportedGrasp>>,
    /// Number of the object over time, from a tracker or stream.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub track_id: Option<u64>,
}

/// One way to grasp an object, [`crate::request::Grasp`].
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "Grasp")
)]
pub struct ReportedGrasp {
    /// As in `grasps.json`.
    pub name: String,
    /// Tool to the frame that was asked for.
    #[serde(rename = "T_frame_tool")]
    pub t_frame_tool: [[f64; 4]; 4],
    /// Gripper opening, metres.
    pub opening_m: f64,
    /// Whether the gripper touches another found object; null if its shape is unknown.
    pub collides: Option<bool>,
    /// Indices of these objects among those reported; null likewise.
    pub collides_with: Option<Vec<usize>>,
}

/// Poses that look like the one that is given, [`ObjectPose::symmetry`].
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "Symmetry")
)]
pub struct Undetermined {
    /// Number of equivalent poses, except for turns about the axis.
    pub poses: usize,
    /// Axis of a continuous symmetry, or null.
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
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "Hypothesis")
)]
pub struct ReportedHypothesis {
    /// Object to world.
    #[serde(rename = "T_world_obj")]
    pub t_world_obj: [[f64; 4]; 4],
    /// Expected error if it is the right one.
    pub sigma: Sigma,
    /// Probability; all of an object add up to 1.
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ObjectInCamera {
    /// Camera id.
    pub id: String,
    /// Object to camera.
    #[serde(rename = "T_cam_obj")]
    pub t_cam_obj: [[f64; 4]; 4],
    /// Detected box, px, clipped to the image; null if not detected.
    #[serde(rename = "box")]
    pub bbox: Option<BBox>,
    /// Whether there is a box.
    pub detected: bool,
}

/// What the confidence of a pose is made of, see [`crate::scorer`].
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Evidence {
    /// Log-odds of the pose.
    pub log_odds: f64,
    /// The same before refinement.
    pub initial_log_odds: f64,
    /// Terms of the whole pose, by name.
    pub pose: BTreeMap<&'static str, f64>,
    /// Terms of each view that should show the object, by name.
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
            model: prediction.model.clone(),
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
