//! BOP's average precision: how well an object is detected, whatever number of it an image shows.

use std::collections::BTreeMap;

use crate::bop::{Estimate, Instance, Model, match_targets};
use crate::metrics::{MSPD_THRESHOLDS_PX, MSSD_THRESHOLDS, MSSD_THRESHOLDS_MM, average_precision};
use crate::statistics::mean;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use super::view::View;
use crate::Result;

/// Instances of which less is visible are no targets, and estimates of them do not count.
const LEAST_VISIBLE: f64 = 0.1;

/// Whether each estimate is right, null where it does not count: by threshold, then by estimate.
type Verdicts = Vec<Vec<Option<bool>>>;

/// Estimates of one object in one image that shows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detections {
    /// Number of the object.
    pub obj_id: u32,
    /// Instances that are visible enough.
    pub targets: usize,
    /// Of the estimates, surest first.
    pub scores: Vec<f64>,
    /// At shares of the diameter.
    pub mssd: Verdicts,
    /// At millimetres.
    pub mssd_mm: Verdicts,
    /// At pixels.
    pub mspd: Verdicts,
}

/// BOP's average precisions of many images: means over the thresholds, then over the objects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Precisions {
    pub mssd: Option<f64>,
    pub mssd_mm: Option<f64>,
    pub mspd: Option<f64>,
}

impl Detections {
    /// - `truth`: all instances of the object in the image
    /// - `estimates`: of the object, surest first
    pub(super) fn new(
        truth: &[&Instance],
        estimates: &[&Estimate],
        model: &Model,
        view: &View,
    ) -> Result<Self> {
        let poses = estimates.iter().map(|estimate| estimate.cam_from_obj());
        let poses: Vec<Isometry3<f64>> = poses.collect::<Result<_>>()?;
        let errors = |error: &dyn Fn(&Isometry3<f64>, &Isometry3<f64>) -> f64| -> Vec<Vec<f64>> {
            let of_pose = |pose| truth.iter().map(|t| error(&t.cam_from_obj, pose)).collect();
            poses.iter().map(of_pose).collect()
        };
        let mssd = errors(&|truth, pose| {
            // As in the toolkit: poses a diameter apart are wrong, however small the object is.
            let apart = (truth.translation.vector - pose.translation.vector).norm();
            match apart < model.diameter_m {
                true => model.surface.mssd(truth, pose, &model.symmetries),
                false => f64::INFINITY,
            }
        });
        let mspd = errors(&|truth, pose| view.mspd_px640(model, truth, pose));
        let counts = |instance: &Instance| instance.visible.unwrap_or(1.0) >= LEAST_VISIBLE;
        let verdicts = |errors: &[Vec<f64>], thresholds: &[f64], unit: f64| -> Verdicts {
            let verdict = |target: Option<usize>| match target {
                Some(target) => counts(truth[target]).then_some(true),
                None => Some(false),
            };
            let at = |&at: &f64| {
                let matched = match_targets(errors, at * unit).into_iter();
                matched.map(verdict).collect()
            };
            thresholds.iter().map(at).collect()
        };
        Ok(Self {
            obj_id: model.id,
            targets: truth.iter().filter(|instance| counts(instance)).count(),
            scores: estimates.iter().map(|estimate| estimate.score).collect(),
            mssd: verdicts(&mssd, &MSSD_THRESHOLDS, model.diameter_m),
            mssd_mm: verdicts(&mssd, &MSSD_THRESHOLDS_MM, 1e-3),
            mspd: verdicts(&mspd, &MSPD_THRESHOLDS_PX, 1.0),
        })
    }
}

impl Precisions {
    pub fn new(detections: &[&Detections]) -> Self {
        let mut objects: BTreeMap<u32, Vec<&Detections>> = BTreeMap::new();
        for &detections in detections {
            let of_object = objects.entry(detections.obj_id).or_default();
            of_object.push(detections);
        }
        let of = |kind: fn(&Detections) -> &Verdicts| {
            let objects = objects.values();
            let precisions = objects.filter_map(|of_object| precision(of_object, kind));
            mean(&precisions.collect::<Vec<_>>())
        };
        Self {
            mssd: of(|detections| &detections.mssd),
            mssd_mm: of(|detections| &detections.mssd_mm),
            mspd: of(|detections| &detections.mspd),
        }
    }
}

/// Mean over the thresholds of one object's average precision; `None` where it is no target.
fn precision(of_object: &[&Detections], kind: fn(&Detections) -> &Verdicts) -> Option<f64> {
    let targets = of_object.iter().map(|detections| detections.targets).sum();
    let thresholds = 0..kind(of_object.first()?).len();
    let at = |threshold: usize| {
        let of_image = |detections: &&Detections| {
            let verdicts = kind(detections)[threshold].clone();
            detections.scores.clone().into_iter().zip(verdicts)
        };
        let mut estimates: Vec<(f64, Option<bool>)> = of_object.iter().flat_map(of_image).collect();
        // Equal ones stay in the order of the images.
        estimates.sort_by(|a, b| b.0.total_cmp(&a.0));
        let right: Vec<bool> = estimates.iter().filter_map(|estimate| estimate.1).collect();
        average_precision(&right, targets)
    };
    let precisions: Option<Vec<f64>> = thresholds.map(at).collect();
    mean(&precisions?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runner::bop::score::tests::{camera, plate};
    use serde_json::Map;

    /// The plate 1 m before the camera and this far to the right, metres.
    fn pose(x: f64) -> Isometry3<f64> {
        Isometry3::translation(x, 0.0, 1.0)
    }

    /// - `truth`: places and visible shares
    /// - `estimates`: places and scores
    fn detections(truth: &[(f64, f64)], estimates: &[(f64, f64)]) -> Detections {
        let instance = |&(x, visible): &(f64, f64)| Instance {
            object: 3,
            cam_from_obj: pose(x),
            bbox: None,
            visible_bbox: None,
            visible: Some(visible),
            more: Map::new(),
        };
        let truth: Vec<Instance> = truth.iter().map(instance).collect();
        let estimate = |&(x, score): &(f64, f64)| Estimate::new(3, score, &pose(x));
        let estimates: Vec<Estimate> = estimates.iter().map(estimate).collect();
        let view = View {
            camera: &camera(),
            depth: None,
            vsd_delta: 0.015,
        };
        let truth: Vec<&Instance> = truth.iter().collect();
        let estimates: Vec<&Estimate> = estimates.iter().collect();
        Detections::new(&truth, &estimates, &plate(), &view).unwrap()
    }

    #[test]
    fn thresholds_are_millimetres_shares_and_pixels() {
        // 11 mm off are 0.039 diameters and 11 px.
        let precisions = Precisions::new(&[&detections(&[(0.0, 1.0)], &[(0.011, 0.9)])]);
        assert!((precisions.mssd_mm.unwrap() - 0.5).abs() < 1e-12);
        assert!((precisions.mssd.unwrap() - 1.0).abs() < 1e-12);
        assert!((precisions.mspd.unwrap() - 0.8).abs() < 1e-12);
    }

    #[test]
    fn estimates_of_hardly_visible_instances_do_not_count() {
        let of = |visible| {
            let truth = [(0.0, 1.0), (0.3, visible)];
            let found = detections(&truth, &[(0.3, 0.9), (0.0, 0.8), (0.6, 0.7)]);
            let precision = Precisions::new(&[&found]).mssd_mm.unwrap();
            (found.targets, found.mssd_mm[0].clone(), precision)
        };
        let (right, wrong) = (Some(true), Some(false));
        assert_eq!(of(0.1), (2, vec![right, right, wrong], 1.0));
        assert_eq!(of(0.09), (1, vec![None, right, wrong], 1.0));
    }

    #[test]
    fn images_are_put_together_by_score_and_objects_count_alike() {
        let right = detections(&[(0.0, 1.0)], &[(0.0, 0.5)]);
        let wrong = detections(&[(0.0, 1.0)], &[(0.5, 0.9)]);
        let both = |a: &Detections, b: &Detections| Precisions::new(&[a, b]).mssd_mm.unwrap();
        // Wrong, then right: half the precision up to half the recall, 51 of 101 steps.
        assert!((both(&right, &wrong) - 0.5 * 51.0 / 101.0).abs() < 1e-12);
        let other = Detections { obj_id: 4, ..wrong };
        assert_eq!(both(&right, &other), 0.5);
        let hidden = detections(&[(0.0, 0.0)], &[]);
        assert_eq!(Precisions::new(&[&hidden]).mssd_mm, None);
    }
}
