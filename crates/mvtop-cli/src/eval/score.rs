//! What BOP's metrics say of one pose, and of many.

use mvtop_core::Camera;
use mvtop_core::bop::Model;
use mvtop_core::known::KnownPose;
use mvtop_core::metrics::{
    MSPD_THRESHOLDS_PX, MSSD_THRESHOLDS, auc_exact, auc_poet, auc_posecnn, average_recall, recall,
    rotation_error_deg, translation_error,
};
use mvtop_core::prediction::ObjectPose;
use serde::{Deserialize, Serialize};

use super::outcome::Outcome;

/// Threshold up to which areas under curves go, as published.
const AUC_MAX_M: f64 = 0.1;
/// Share of the diameter that ADD may be off.
const ADD_SHARE: f64 = 0.1;
/// Width for which BOP's MSPD thresholds are made, px.
const MSPD_WIDTH: f64 = 640.0;

/// One object of the truth. Errors are null where it was not found; rotation and translation errors
/// are the least over the object's symmetries.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Scored {
    #[serde(flatten)]
    pub outcome: Outcome,
    pub obj_id: u32,
    pub diameter_m: f64,
    pub symmetric: bool,
    pub add_s_m: Option<f64>,
    pub mssd_m: Option<f64>,
    /// In the reference image, as if that were 640 px wide.
    pub mspd_px640: Option<f64>,
}

/// One kind of error over many objects; objects that were not found count as wrong.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Areas {
    /// Share below a tenth of the diameter.
    pub recall_01d: Option<f64>,
    pub auc_posecnn: Option<f64>,
    pub auc_exact: Option<f64>,
    /// Over found objects only, as PoET has it.
    pub auc_poet_found: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scores {
    pub objects: usize,
    pub found: usize,
    pub rot_median_deg: Option<f64>,
    pub trans_median_m: Option<f64>,
    pub add: Areas,
    pub add_s: Areas,
    /// ADD-(S): ADD-S of objects that have symmetries in models_info.json, ADD of others.
    pub add_or_add_s: Areas,
    pub ar_mssd: Option<f64>,
    pub ar_mspd: Option<f64>,
}

impl Scored {
    /// - `reference`: camera of the reference image
    pub fn new(
        outcome: Outcome,
        known: &KnownPose,
        found: Option<&ObjectPose>,
        model: &Model,
        reference: &Camera,
    ) -> Self {
        let truth = &known.world_from_obj;
        let cam_from_world = reference.world_from_cam.inverse();
        let estimate = found.map(|found| &found.world_from_obj);
        let Model {
            surface,
            symmetries,
            ..
        } = model;
        Self {
            outcome: Outcome {
                rot_deg: estimate.map(|pose| rotation_error_deg(truth, pose, symmetries)),
                trans_m: estimate.map(|pose| translation_error(truth, pose, symmetries)),
                add_m: estimate.map(|pose| surface.add(truth, pose)),
                ..outcome
            },
            obj_id: model.id,
            diameter_m: model.diameter_m,
            symmetric: symmetries.is_symmetric(),
            add_s_m: estimate.map(|pose| surface.add_s(truth, pose)),
            mssd_m: estimate.map(|pose| surface.mssd(truth, pose, symmetries)),
            // JSON has no infinity; a pose behind the camera is as wrong as none.
            mspd_px640: estimate
                .map(|pose| {
                    let (truth, pose) = (cam_from_world * truth, cam_from_world * pose);
                    let px = surface.mspd(&truth, &pose, symmetries, &reference.lens);
                    px * MSPD_WIDTH / f64::from(reference.width)
                })
                .filter(|px| px.is_finite()),
        }
    }

    pub fn add_or_add_s(&self) -> Option<f64> {
        if self.symmetric {
            self.add_s_m
        } else {
            self.outcome.add_m
        }
    }

    /// ADD-(S) in diameters, infinite where it was not found.
    pub fn badness(&self) -> f64 {
        self.add_or_add_s().unwrap_or(f64::INFINITY) / self.diameter_m
    }
}

impl Scores {
    pub fn new(scored: &[&Scored]) -> Self {
        let in_diameters = |error: &dyn Fn(&Scored) -> Option<f64>| -> Vec<f64> {
            let share = |s: &&Scored| error(s).unwrap_or(f64::INFINITY) / s.diameter_m;
            scored.iter().map(share).collect()
        };
        let areas = |error: &dyn Fn(&Scored) -> Option<f64>| {
            let found: Vec<f64> = scored.iter().filter_map(|s| error(s)).collect();
            let mut all = found.clone();
            all.resize(scored.len(), f64::INFINITY);
            Areas {
                recall_01d: recall(&in_diameters(error), ADD_SHARE),
                auc_posecnn: auc_posecnn(&all, AUC_MAX_M),
                auc_exact: auc_exact(&all, AUC_MAX_M),
                auc_poet_found: auc_poet(&found, AUC_MAX_M),
            }
        };
        let median = |error: &dyn Fn(&Scored) -> Option<f64>| {
            let mut found: Vec<f64> = scored.iter().filter_map(|s| error(s)).collect();
            found.sort_by(f64::total_cmp);
            super::summary::median(&found)
        };
        let pixels: Vec<f64> = scored
            .iter()
            .map(|s| s.mspd_px640.unwrap_or(f64::INFINITY))
            .collect();
        Self {
            objects: scored.len(),
            found: scored.iter().filter(|s| s.outcome.found).count(),
            rot_median_deg: median(&|s| s.outcome.rot_deg),
            trans_median_m: median(&|s| s.outcome.trans_m),
            add: areas(&|s| s.outcome.add_m),
            add_s: areas(&|s| s.add_s_m),
            add_or_add_s: areas(&Scored::add_or_add_s),
            ar_mssd: average_recall(&in_diameters(&|s| s.mssd_m), &MSSD_THRESHOLDS),
            ar_mspd: average_recall(&pixels, &MSPD_THRESHOLDS_PX),
        }
    }
}
