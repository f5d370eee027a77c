//! What the core's estimator answered, as values of Python's; `python/mvtop/_report.py` makes its
//! classes of them.

use std::collections::BTreeMap;
use std::sync::Arc;

use mvtop_core::prediction::{self, Timings};
use mvtop_core::report::{self, Report};
use mvtop_core::request::{Answer, LeftOut};
use ndarray::arr2;
use pyo3::prelude::*;
use serde_json::Value;

use crate::convert::{F64, vector};
use crate::error::value;

/// What the core's estimator answered.
#[pyclass(frozen, module = "mvtop._mvtop")]
pub struct NativePrediction {
    pub prediction: mvtop_core::Prediction,
    pub rig: Arc<mvtop_core::Rig>,
    report: Report,
}

/// Keywords of `mvtop.Prediction`.
#[derive(IntoPyObject)]
pub struct PredictionValues {
    reference: String,
    objects: Vec<ObjectValues>,
    rig_consistency: Option<ConsistencyValues>,
    timings_ms: TimingsValues,
    model: String,
    provider: String,
    warnings: Vec<WarningValues>,
    frame: Option<String>,
    left_out: Option<LeftOutValues>,
    why: Option<Vec<NearMissValues>>,
}

#[derive(IntoPyObject)]
struct NearMissValues {
    class_name: String,
    reason: String,
    camera: Option<String>,
    r#box: Option<F64>,
    world_from_obj: Option<F64>,
    value: Option<f64>,
    threshold: Option<f64>,
    message: String,
}

#[derive(IntoPyObject)]
struct LeftOutValues {
    classes: usize,
    region: usize,
    polygons: usize,
    most: usize,
}

#[derive(IntoPyObject)]
struct ObjectValues {
    class_name: String,
    class_id: i64,
    score: f64,
    ref_from_obj: F64,
    world_from_obj: F64,
    quat_wxyz: F64,
    sigma: SigmaValues,
    coordinate_inliers: Option<f64>,
    refinement: Option<RefinementValues>,
    confidence: Option<f64>,
    evidence: Option<EvidenceValues>,
    hypotheses: Vec<HypothesisValues>,
    next_view: Option<String>,
    symmetry: Option<UndeterminedValues>,
    cameras: Vec<CameraValues>,
    track_id: Option<u64>,
    verdict: Option<String>,
    frame_from_obj: Option<F64>,
    grasps: Option<Vec<GraspValues>>,
}

#[derive(IntoPyObject)]
struct GraspValues {
    name: String,
    frame_from_tool: F64,
    opening_m: f64,
    collides: Option<bool>,
    collides_with: Option<Vec<usize>>,
}

#[derive(IntoPyObject)]
struct SigmaValues {
    rot_deg: f64,
    t_m: f64,
}

#[derive(IntoPyObject)]
struct RefinementValues {
    accepted: bool,
    contour_inliers: f64,
    contour_residual_px: f64,
    color_separation: f64,
    mutual_information: f64,
    mutual_information_min: f64,
    texture_correlation: Option<f64>,
    initial_sigma: SigmaValues,
}

#[derive(IntoPyObject)]
struct EvidenceValues {
    log_odds: f64,
    initial_log_odds: f64,
    pose: BTreeMap<&'static str, f64>,
    views: Vec<BTreeMap<&'static str, f64>>,
}

#[derive(IntoPyObject)]
struct HypothesisValues {
    world_from_obj: F64,
    sigma: SigmaValues,
    probability: f64,
}

#[derive(IntoPyObject)]
struct UndeterminedValues {
    poses: usize,
    axis: Option<F64>,
}

#[derive(IntoPyObject)]
struct CameraValues {
    id: String,
    cam_from_obj: F64,
    r#box: Option<F64>,
}

#[derive(IntoPyObject)]
struct ConsistencyValues {
    px: f64,
    deviation: f64,
    camera_deviation: f64,
    scale_deviation: f64,
    box_deviation: f64,
    contradiction: f64,
    confirmed: usize,
    unconfirmed: usize,
    worst_camera: Option<String>,
}

#[derive(IntoPyObject)]
struct WarningValues {
    code: String,
    camera: Option<String>,
    object: Option<usize>,
    message: String,
}

#[derive(IntoPyObject)]
struct TimingsValues {
    prepare: f64,
    features: f64,
    detect: f64,
    crop: f64,
    propose: f64,
    refine: f64,
    check: f64,
    total: f64,
}

impl From<prediction::Sigma> for SigmaValues {
    fn from(sigma: prediction::Sigma) -> Self {
        Self {
            rot_deg: sigma.rot_deg,
            t_m: sigma.t_m,
        }
    }
}

impl From<prediction::Refinement> for RefinementValues {
    fn from(of: prediction::Refinement) -> Self {
        Self {
            accepted: of.accepted,
            contour_inliers: of.contour_inliers,
            contour_residual_px: of.contour_residual_px,
            color_separation: of.color_separation,
            mutual_information: of.mutual_information,
            mutual_information_min: of.mutual_information_min,
            texture_correlation: of.texture_correlation,
            initial_sigma: of.initial_sigma.into(),
        }
    }
}

impl From<report::Evidence> for EvidenceValues {
    fn from(of: report::Evidence) -> Self {
        Self {
            log_odds: of.log_odds,
            initial_log_odds: of.initial_log_odds,
            pose: of.pose,
            views: of.views,
        }
    }
}

impl From<report::Undetermined> for UndeterminedValues {
    fn from(of: report::Undetermined) -> Self {
        let rows = |axis: mvtop_core::symmetry::Axis| {
            let (direction, point) = (axis.direction.into_inner(), axis.point.coords);
            F64(arr2::<f64, 3>(&[direction.into(), point.into()]).into_dyn())
        };
        Self {
            poses: of.poses,
            axis: of.axis.map(rows),
        }
    }
}

impl From<Timings> for TimingsValues {
    fn from(of: Timings) -> Self {
        Self {
            prepare: of.prepare,
            features: of.features,
            detect: of.detect,
            crop: of.crop,
            propose: of.propose,
            refine: of.refine,
            check: of.check,
            total: of.total,
        }
    }
}

impl From<report::ReportedConsistency> for ConsistencyValues {
    fn from(of: report::ReportedConsistency) -> Self {
        Self {
            px: of.px,
            deviation: of.deviation,
            camera_deviation: of.camera_deviation,
            scale_deviation: of.scale_deviation,
            box_deviation: of.box_deviation,
            contradiction: of.contradiction,
            confirmed: of.confirmed,
            unconfirmed: of.unconfirmed,
            worst_camera: of.worst_camera,
        }
    }
}

impl From<LeftOut> for LeftOutValues {
    fn from(of: LeftOut) -> Self {
        Self {
            classes: of.classes,
            region: of.region,
            polygons: of.polygons,
            most: of.most,
        }
    }
}

impl From<report::ReportedGrasp> for GraspValues {
    fn from(of: report::ReportedGrasp) -> Self {
        Self {
            name: of.name,
            frame_from_tool: rows(&of.t_frame_tool),
            opening_m: of.opening_m,
            collides: of.collides,
            collides_with: of.collides_with,
        }
    }
}

impl NearMissValues {
    fn of(of: report::ReportedNearMiss) -> PyResult<Self> {
        Ok(Self {
            class_name: of.class,
            reason: named(serde_json::to_value(of.reason))?,
            camera: of.camera,
            r#box: of.bbox.map(|bbox| vector(<[f64; 4]>::from(bbox))),
            world_from_obj: of.t_world_obj.as_ref().map(rows),
            value: of.value,
            threshold: of.threshold,
            message: of.message,
        })
    }
}

impl ObjectValues {
    fn of(of: report::Object) -> PyResult<Self> {
        let hypothesis = |one: report::ReportedHypothesis| HypothesisValues {
            world_from_obj: rows(&one.t_world_obj),
            sigma: one.sigma.into(),
            probability: one.probability,
        };
        let camera = |seen: report::ObjectInCamera| CameraValues {
            id: seen.id,
            cam_from_obj: rows(&seen.t_cam_obj),
            r#box: seen.bbox.map(|bbox| vector(<[f64; 4]>::from(bbox))),
        };
        let grasps = |all: Vec<report::ReportedGrasp>| all.into_iter().map(Into::into).collect();
        Ok(Self {
            class_name: of.class,
            class_id: of.class_id,
            score: of.score,
            ref_from_obj: rows(&of.t_ref_obj),
            world_from_obj: rows(&of.t_world_obj),
            quat_wxyz: vector(of.q_wxyz),
            sigma: of.sigma.into(),
            coordinate_inliers: of.coordinate_inliers,
            refinement: of.refinement.map(Into::into),
            confidence: of.confidence,
            evidence: of.evidence.map(Into::into),
            hypotheses: of.hypotheses.into_iter().map(hypothesis).collect(),
            next_view: of.next_view,
            symmetry: of.symmetry.map(Into::into),
            cameras: of.cameras.into_iter().map(camera).collect(),
            track_id: of.track_id,
            verdict: of
                .verdict
                .map(|verdict| named(serde_json::to_value(verdict)))
                .transpose()?,
            frame_from_obj: of.t_frame_obj.as_ref().map(rows),
            grasps: of.grasps.map(grasps),
        })
    }
}

#[pymethods]
impl NativePrediction {
    /// What `mvtop.Prediction` is made of.
    fn values(&self) -> PyResult<PredictionValues> {
        let report = self.report.clone();
        let warning = |of: report::ReportedWarning| {
            Ok(WarningValues {
                code: named(serde_json::to_value(of.code))?,
                camera: of.camera,
                object: of.object,
                message: of.message,
            })
        };
        Ok(PredictionValues {
            reference: report.reference,
            objects: report
                .objects
                .into_iter()
                .map(ObjectValues::of)
                .collect::<PyResult<_>>()?,
            rig_consistency: report.rig_consistency.map(Into::into),
            timings_ms: report.timings_ms.into(),
            model: report.model,
            provider: report.provider,
            warnings: report
                .warnings
                .into_iter()
                .map(warning)
                .collect::<PyResult<_>>()?,
            frame: report.frame,
            left_out: report.left_out.map(Into::into),
            why: report
                .why
                .map(|all| all.into_iter().map(NearMissValues::of).collect())
                .transpose()?,
        })
    }

    /// The same of some of its objects alone, by their indices.
    fn only(&self, objects: Vec<usize>) -> PyResult<Self> {
        Ok(Self {
            prediction: mvtop_core::Prediction {
                objects: picked(&self.prediction.objects, &objects)?,
                ..self.prediction.clone()
            },
            rig: self.rig.clone(),
            report: Report {
                objects: picked(&self.report.objects, &objects)?,
                ..self.report.clone()
            },
        })
    }

    fn __repr__(&self) -> String {
        let count = self.prediction.objects.len();
        format!("NativePrediction({count} objects)")
    }
}

impl NativePrediction {
    pub fn new(answer: Answer, rig: Arc<mvtop_core::Rig>) -> Self {
        Self {
            prediction: answer.prediction,
            rig,
            report: answer.report,
        }
    }
}

fn picked<T: Clone>(all: &[T], indices: &[usize]) -> PyResult<Vec<T>> {
    let of = |&index: &usize| {
        let one = all.get(index).cloned();
        one.ok_or_else(|| value(format!("object {index}: none such")))
    };
    indices.iter().map(of).collect()
}

fn rows(matrix: &[[f64; 4]; 4]) -> F64 {
    F64(arr2(matrix).into_dyn())
}

/// The name in JSON of a code, a verdict or a reason.
fn named(code: serde_json::Result<Value>) -> PyResult<String> {
    match code {
        Ok(Value::String(name)) => Ok(name),
        other => Err(value(format!("name: {other:?}"))),
    }
}
