//! What BOP's metrics say of one pose, and of many.

use crate::bop::Model;
use crate::metrics::{auc_exact, auc_poet, auc_posecnn, recall};
use crate::statistics::median;
use mvtop_core::annotations::TruePose;
use mvtop_core::pose::{rotation_error_deg, translation_error};
use mvtop_core::prediction::ObjectPose;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use super::detection::{Detections, Precisions};
use super::tally::{Recalls, Tally};
use super::view::View;
use crate::Result;
use crate::runner::bounds::Bounds;
use crate::runner::outcome::{Errors, Outcome};
use crate::runner::right::Right;

/// Threshold up to which areas under curves go, as published.
const AUC_MAX_M: f64 = 0.1;
/// Share of the diameter that ADD may be off.
const ADD_SHARE: f64 = 0.1;
/// Translations that differ by less count as one: symmetries are rounded.
const SAME_M: f64 = 1e-6;

/// One object of the truth. Errors are null where it was not found; rotation and translation errors
/// are the least over the object's symmetries.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Scored {
    /// The errors.
    #[serde(flatten)]
    pub outcome: Outcome,
    /// Number of the object.
    pub obj_id: u32,
    /// Of the object.
    pub diameter_m: f64,
    /// Whether models_info.json names symmetries.
    pub symmetric: bool,
    /// ADD-S.
    pub add_s_m: Option<f64>,
    /// Maximum symmetry-aware surface distance.
    pub mssd_m: Option<f64>,
    /// In the reference image, as if that were 640 px wide.
    pub mspd_px640: Option<f64>,
    /// For BOP's ten tolerances, 1 where it was not found; null without a depth image or faces of
    /// the model, or where the lens has distortion.
    pub vsd: Option<Vec<f64>>,
    /// Views in which at least half of it is visible; null where the data set does not say.
    #[serde(default)]
    pub views_in_sight: Option<usize>,
}

/// One kind of error over many objects; objects that were not found count as wrong.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Areas {
    /// Share below a tenth of the diameter.
    pub recall_01d: Option<f64>,
    /// Area under the recall curve up to 0.1 m, as PoseCNN's evaluation has it.
    pub auc_posecnn: Option<f64>,
    /// The same without its approximations.
    pub auc_exact: Option<f64>,
    /// Over found objects only, as PoET has it.
    pub auc_poet_found: Option<f64>,
}

/// What BOP's metrics say of many objects.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scores {
    /// Targets.
    pub objects: usize,
    /// Of these, those with a pose.
    pub found: usize,
    /// Rotation error, median of the found.
    pub rot_median_deg: Option<f64>,
    /// Translation error, median of the found.
    pub trans_median_m: Option<f64>,
    /// ADD.
    pub add: Areas,
    /// ADD-S.
    pub add_s: Areas,
    /// ADD-(S): ADD-S of objects that have symmetries in models_info.json, ADD of others.
    pub add_or_add_s: Areas,
    /// Average recalls of BOP, whose matching of estimates and targets is another one for each
    /// threshold: see [`Tally`].
    pub ar_mssd: Option<f64>,
    /// The same of MSPD.
    pub ar_mspd: Option<f64>,
    /// Over the objects in images with depth.
    pub ar_vsd: Option<f64>,
    /// BOP's average recall: the mean of the three, where there is VSD of all objects.
    pub ar: Option<f64>,
    /// Average precision of BOP's detection tasks, at the thresholds of `ar_mssd`.
    pub ap_mssd: Option<f64>,
    /// The same at those of `ar_mspd`.
    pub ap_mspd: Option<f64>,
    /// The mean of the two: AP of BOP 2024.
    pub ap: Option<f64>,
    /// Average precision of MSSD below 2, 4, ..., 20 mm: AP-mm of BOP-Industrial.
    pub ap_mm: Option<f64>,
    /// How many are right.
    #[serde(flatten)]
    pub right: Right,
}

/// Rotation and translation errors are the least over the object's symmetries.
pub fn errors(truth: &Isometry3<f64>, pose: &Isometry3<f64>, model: &Model) -> Errors {
    let motions = model.symmetries.motions().iter();
    // Turns about an axis come in steps; the nearest one lies between two of these.
    let nearest = model.symmetry.nearest(truth, pose, model.diameter_m);
    let alike = motions.map(|motion| truth * motion).chain([nearest]);
    let errors = alike.map(|truth| {
        let rot_deg = rotation_error_deg(&truth.rotation, &pose.rotation);
        [rot_deg, translation_error(&truth, pose)]
    });
    let errors: Vec<[f64; 2]> = errors.collect();
    let least = |i: usize| errors.iter().map(|of| of[i]).fold(f64::INFINITY, f64::min);
    Errors {
        rot_deg: least(0),
        trans_m: least(1),
        add_m: Some(model.surface.add(truth, pose)),
        by_symmetry: none_better(errors),
    }
}

/// The pairs of errors than which no other is better in both; none where one is the best in both.
fn none_better(mut errors: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    errors.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut least = f64::INFINITY;
    errors.retain(|&[_, trans_m]| {
        let better = trans_m < least - SAME_M;
        least = if better { trans_m } else { least };
        better
    });
    match errors.len() {
        1 => Vec::new(),
        _ => errors,
    }
}

impl Scored {
    /// - `outcome`: with the [`errors`] of `found`
    /// - `views_in_sight`: as the field
    pub(super) fn new(
        outcome: Outcome,
        known: &TruePose,
        views_in_sight: Option<usize>,
        found: Option<&ObjectPose>,
        model: &Model,
        view: &View,
    ) -> Result<Self> {
        let truth = &known.world_from_obj;
        let estimate = found.map(|found| &found.world_from_obj);
        let camera = view.camera;
        let cam_from_world = camera.world_from_cam().inverse();
        let seen = |pose: &Isometry3<f64>| cam_from_world * pose;
        let (surface, symmetries) = (&model.surface, &model.symmetries);
        let mspd = estimate.map(|pose| view.mspd_px640(model, &seen(truth), &seen(pose)));
        let estimates: Vec<Isometry3<f64>> = estimate.map(seen).into_iter().collect();
        let vsd = view.vsd_of_all(model, &[seen(truth)], &estimates)?;
        let vsd = vsd.map(|by_tau| {
            let error = |errors: &Vec<Vec<f64>>| errors.first().map_or(1.0, |of| of[0]);
            by_tau.iter().map(error).collect()
        });
        Ok(Self {
            outcome,
            obj_id: model.id,
            diameter_m: model.diameter_m,
            symmetric: symmetries.is_symmetric(),
            add_s_m: estimate.map(|pose| surface.add_s(truth, pose)),
            mssd_m: estimate.map(|pose| surface.mssd(truth, pose, symmetries)),
            // JSON has no infinity; a pose behind the camera is as wrong as none.
            mspd_px640: mspd.filter(|px| px.is_finite()),
            vsd,
            views_in_sight,
        })
    }

    /// ADD-S of a symmetric object, ADD of another one, metres.
    pub fn add_or_add_s(&self) -> Option<f64> {
        match self.symmetric {
            true => self.add_s_m,
            false => self.outcome.add_m,
        }
    }

    /// ADD-(S) in diameters, infinite where it was not found.
    pub fn badness(&self) -> f64 {
        self.add_or_add_s().unwrap_or(f64::INFINITY) / self.diameter_m
    }
}

impl Scores {
    /// The scores of some objects.
    ///
    /// - `tallies`, `detections`: of the same objects
    pub fn new(
        scored: &[&Scored],
        tallies: &[&Tally],
        detections: &[&Detections],
        bounds: &Bounds,
    ) -> Self {
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
        let median_of = |error: &dyn Fn(&Scored) -> Option<f64>| {
            median(&scored.iter().filter_map(|s| error(s)).collect::<Vec<_>>())
        };
        let recalls = Recalls::new(tallies);
        let precisions = Precisions::new(detections);
        let both = precisions.mssd.zip(precisions.mspd);
        let predicted = tallies.iter().map(|tally| tally.estimates).sum();
        Self {
            objects: scored.len(),
            found: scored.iter().filter(|s| s.outcome.found).count(),
            rot_median_deg: median_of(&|s| s.outcome.rot_deg),
            trans_median_m: median_of(&|s| s.outcome.trans_m),
            add: areas(&|s| s.outcome.add_m),
            add_s: areas(&|s| s.add_s_m),
            add_or_add_s: areas(&Scored::add_or_add_s),
            ar_mssd: recalls.mssd,
            ar_mspd: recalls.mspd,
            ar_vsd: recalls.vsd,
            ar: recalls.all,
            ap_mssd: precisions.mssd,
            ap_mspd: precisions.mspd,
            ap: both.map(|(mssd, mspd)| (mssd + mspd) / 2.0),
            ap_mm: precisions.mssd_mm,
            right: Right::new(scored.iter().map(|s| s.outcome.errors()), predicted, bounds),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::matching::tests::found;
    use crate::metrics::{BOP_MAX_STEP, ContinuousSymmetry, DepthImage, Surface, Symmetries};
    use mvtop_core::annotations::GivenBoxes;
    use mvtop_core::mesh::Mesh;
    use mvtop_core::prediction::Timings;
    use mvtop_core::symmetry::{Axis, Symmetry};
    use mvtop_core::{Camera, Intrinsics, Projection};
    use nalgebra::{Point3, Vector3};
    use std::f64::consts::PI;

    /// A square plate of 0.2 m that faces the camera 1 m before it: 100 px wide.
    pub fn plate() -> Model {
        let corner = |x: f64, y: f64| Point3::new(0.1 * x, 0.1 * y, 0.0);
        let corners = [(-1., -1.), (1., -1.), (1., 1.), (-1., 1.)].map(|(x, y)| corner(x, y));
        let mesh = Mesh::new(corners.to_vec(), vec![], vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        Model {
            id: 3,
            name: None,
            diameter_m: 0.1 * 8f64.sqrt(),
            symmetries: Symmetries::default(),
            symmetry: Symmetry::default(),
            surface: Surface::new(mesh.vertices()).unwrap(),
            path: "plate.ply".into(),
            mesh,
        }
    }

    fn bounds() -> Bounds {
        Bounds {
            resolved_deg: 15.0,
            right_deg: 5.0,
            right_mm: 5.0,
        }
    }

    pub fn camera() -> Camera {
        Camera::new(
            "cam",
            [320, 240],
            Intrinsics::new(500.0, 500.0, 160.0, 120.0, Projection::Pinhole).unwrap(),
            Isometry3::rotation(nalgebra::Vector3::new(0.3, -0.2, 1.0)),
        )
        .unwrap()
    }

    /// - `shift`: of the estimate, camera frame, metres; not found without it
    /// - `depth`: everywhere, metres
    pub fn scored(shift: Option<[f64; 3]>, depth: Option<f32>) -> (Scored, Tally) {
        let camera = camera();
        let pose =
            |[x, y, z]: [f64; 3]| camera.world_from_cam() * Isometry3::translation(x, y, 1.0 + z);
        let found = shift.map(|shift| found("plate", 3, pose(shift)));
        let known = TruePose {
            seen: GivenBoxes {
                class: "plate".into(),
                boxes: Default::default(),
            },
            world_from_obj: pose([0.0; 3]),
        };
        let plate = plate();
        let errors = found
            .as_ref()
            .map(|found| errors(&known.world_from_obj, &found.world_from_obj, &plate));
        let outcome = Outcome {
            sample: "sample".into(),
            object: 0,
            class: "plate".into(),
            views: 1,
            found: found.is_some(),
            rot_deg: errors.as_ref().map(|errors| errors.rot_deg),
            trans_m: errors.as_ref().map(|errors| errors.trans_m),
            add_m: errors.as_ref().and_then(|errors| errors.add_m),
            by_symmetry: errors.map_or(Vec::new(), |errors| errors.by_symmetry),
            score: None,
            sigma: None,
            confidence: None,
            cameras: Vec::new(),
            t_world_obj: None,
            timings_ms: Timings::default(),
        };
        let depth = depth.map(|depth| DepthImage::from_elem((240, 320), depth));
        let view = View {
            camera: &camera,
            depth: depth.as_ref(),
            vsd_delta: 0.015,
        };
        let estimates: Vec<_> = found.iter().map(|found| found.world_from_obj).collect();
        let tally = Tally::new(&[known.world_from_obj], &estimates, &plate, &view).unwrap();
        let scored = Scored::new(outcome, &known, None, found.as_ref(), &plate, &view).unwrap();
        (scored, tally)
    }

    fn scores(of: &[&(Scored, Tally)]) -> Scores {
        let scored: Vec<&Scored> = of.iter().map(|(scored, _)| scored).collect();
        let tallies: Vec<&Tally> = of.iter().map(|(_, tally)| tally).collect();
        Scores::new(&scored, &tallies, &[], &bounds())
    }

    #[test]
    fn errors_of_a_shifted_plate_are_those_worked_by_hand() {
        // 22 mm to the right: 11 of 100 px are shown by one pose only, on either side, so that 22
        // of 111 differ, whatever the tolerance.
        let both = scored(Some([0.022, 0.0, 0.0]), Some(0.0));
        let off = &both.0;
        assert!(off.outcome.rot_deg.unwrap() < 1e-6);
        assert!((off.outcome.trans_m.unwrap() - 0.022).abs() < 1e-12);
        assert!((off.outcome.add_m.unwrap() - 0.022).abs() < 1e-12);
        assert!((off.mssd_m.unwrap() - 0.022).abs() < 1e-12);
        assert!((off.mspd_px640.unwrap() - 22.0).abs() < 1e-9);
        for error in off.vsd.as_ref().unwrap() {
            assert!((error - 22.0 / 111.0).abs() < 1e-9, "{error}");
        }
        let scores = scores(&[&both]);
        // 0.0778 diameters: below 0.1, 0.15, ..., 0.5.
        assert_eq!(scores.ar_mssd, Some(0.9));
        // 22 px: below 25, 30, ..., 50.
        assert_eq!(scores.ar_mspd, Some(0.6));
        // 0.198: below 0.2, 0.25, ..., 0.5.
        assert_eq!(scores.ar_vsd, Some(0.7));
        assert!((scores.ar.unwrap() - (0.9 + 0.6 + 0.7) / 3.0).abs() < 1e-12);
    }

    /// A turn about an axis that is parallel to z and 20 mm off.
    fn turn(angle: f64) -> Isometry3<f64> {
        let offset = Isometry3::translation(0.02, 0.0, 0.0);
        offset * Isometry3::rotation(angle * Vector3::z()) * offset.inverse()
    }

    #[test]
    fn right_is_what_one_symmetry_makes_so_in_turn_and_place() {
        let mut plate = plate();
        plate.symmetries = Symmetries::new(&[turn(PI)], &[], BOP_MAX_STEP).unwrap();
        plate.symmetry.discrete = vec![turn(PI)];
        let truth = Isometry3::translation(0.0, 0.0, 1.0);
        let of = |pose: Isometry3<f64>| errors(&truth, &pose, &plate);
        assert!(of(truth).within(&bounds()) && of(truth * turn(PI)).within(&bounds()));
        // Turned in place: after the half turn it is 40 mm off.
        let mixed = of(truth * Isometry3::rotation(PI * Vector3::z()));
        assert!(mixed.rot_deg < 1e-6 && mixed.trans_m < 1e-12);
        assert!(!mixed.within(&bounds()));
        for ([deg, m], [rot_deg, trans_m]) in
            [[0.0, 0.04], [180.0, 0.0]].iter().zip(&mixed.by_symmetry)
        {
            assert!((deg - rot_deg).abs() < 1e-6 && (m - trans_m).abs() < 1e-12);
        }
        assert_eq!(mixed.by_symmetry.len(), 2);
        let right_mm = 41.0;
        assert!(mixed.within(&Bounds {
            right_mm,
            ..bounds()
        }));
    }

    #[test]
    fn turns_about_an_axis_are_no_errors_however_small() {
        let (axis, offset) = (Vector3::z_axis(), Point3::new(0.02, 0.0, 0.0));
        let continuous = ContinuousSymmetry { axis, offset };
        let mut shaft = plate();
        shaft.symmetries = Symmetries::new(&[], &[continuous], BOP_MAX_STEP).unwrap();
        shaft.symmetry.axis = Some(Axis {
            direction: axis,
            point: offset,
        });
        let truth = Isometry3::translation(0.1, 0.2, 1.0);
        let off = errors(&truth, &(truth * turn(0.01)), &shaft);
        assert!(off.rot_deg < 1e-6 && off.trans_m < 1e-9, "{off:?}");
        assert!(off.by_symmetry.is_empty());
    }

    #[test]
    fn hidden_plates_and_those_not_found_count_as_wrong() {
        let hidden = scored(Some([0.0; 3]), Some(0.9));
        assert_eq!(hidden.0.vsd, Some(vec![1.0; 10]));
        let missed = scored(None, Some(1.0));
        assert_eq!(missed.0.vsd, Some(vec![1.0; 10]));
        let right = scored(Some([0.0; 3]), Some(1.0));
        assert_eq!(right.0.vsd, Some(vec![0.0; 10]));
        let scores = scores(&[&hidden, &missed, &right]);
        assert!((scores.ar_vsd.unwrap() - 1.0 / 3.0).abs() < 1e-12);
        assert!((scores.ar_mssd.unwrap() - 2.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn without_depth_there_is_no_vsd() {
        let without = scored(Some([0.0; 3]), None);
        assert_eq!(without.0.vsd, None);
        let alone = scores(&[&without]);
        assert_eq!((alone.ar_vsd, alone.ar), (None, None));
        let with = scored(Some([0.0; 3]), Some(1.0));
        let scores = scores(&[&without, &with]);
        assert_eq!((scores.ar_vsd, scores.ar), (Some(1.0), None));
    }
}
