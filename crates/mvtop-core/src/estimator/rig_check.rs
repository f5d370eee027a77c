//! What makes poses doubtful: a calibration, or images, that the views of all objects contradict.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::instance::Instance;
use super::pipeline::Pipeline;
use super::rig_test::{self, Judgement, Measurement};
use crate::consistency::alone::{Difference, Kind};
use crate::consistency::{Residual, Sight, agreement};
use crate::prediction::{RigConsistency, Warning, WarningCode};
use crate::{BBox, Rig};

/// What is to be looked at in a rig that does not fit.
const CHECK: &str = "direction, axes and unit of its poses, focal lengths and lens models, and that \
                     each image is of its camera, neither turned nor rescaled";

/// Log-likelihood ratios of a wrong rig: of an object that one of two views shows and the other should
/// show but does not (expected of 0.7 of the objects of a wrong rig, of 0.2 of a true one), and of one
/// that both show.
const UNCONFIRMED: f64 = 1.25;
const CONFIRMED: f64 = -0.98;

/// How well the rig fits what was found, and what to warn of.
pub struct Checked {
    /// Above 1 the rig is doubted.
    pub deviation: f64,
    pub consistency: Option<RigConsistency>,
    /// How far the views of each instance are from one pose, standard deviations.
    pub deviations: Vec<Option<f64>>,
    pub warnings: Vec<Warning>,
}

/// Compares views with each other, by all instances at once.
///
/// - `compared`: of each instance, by index of the camera; empty where boxes alone can tell
pub fn check(
    pipeline: &Pipeline,
    instances: &[Instance],
    compared: &[Vec<(usize, Difference)>],
) -> Checked {
    let config = &pipeline.config().rig;
    let rig = pipeline.rig;
    let residuals: Vec<Vec<(usize, Residual)>> = instances
        .iter()
        .map(|one| residuals(pipeline, one))
        .collect();
    let deviations = compared.iter().zip(&residuals);
    let deviations: Vec<Option<f64>> = deviations
        .map(|(compared, residuals)| {
            let by_views = compared.iter().map(|(_, one)| one.deviation.powi(2));
            let by_boxes = residuals.iter().map(|(_, one)| one.deviation());
            match (compared.is_empty(), residuals.is_empty()) {
                (false, _) => Some(by_views.sum::<f64>().sqrt()),
                (true, false) => Some(by_boxes.fold(0.0, f64::max)),
                (true, true) => None,
            }
        })
        .collect();
    let judgement = rig_test::judge(config, &measurements(pipeline, instances, compared));
    let contradiction = contradiction(pipeline, instances);
    let box_deviation = match judgement {
        Some(_) => 0.0,
        None => lower_median(&deviations),
    };
    let poses = match judgement {
        Some(Judgement { cameras, scale, .. }) => {
            (cameras / config.max_camera_deviation).max(scale / config.max_scale_deviation)
        }
        None => box_deviation / config.max_box_deviation,
    };
    let ratio = contradiction.as_ref().map_or(0.0, |one| one.ratio);
    let contradicted = ratio / config.max_contradiction;
    let mut warnings = Vec::new();
    if poses > 1.0 {
        let judgement = judgement.as_ref();
        warnings.extend(disagreement(
            pipeline, instances, compared, &residuals, judgement,
        ));
    }
    if let Some(one) = contradiction.filter(|_| contradicted > 1.0) {
        warnings.push(one.warning(rig));
    }
    let consistency = (pipeline.views.len() > 1).then(|| RigConsistency {
        deviation: poses.max(contradicted),
        camera_deviation: judgement.map_or(0.0, |one| one.cameras),
        scale_deviation: judgement.map_or(0.0, |one| one.scale),
        box_deviation,
        contradiction: ratio,
        ..consistency(&residuals)
    });
    Checked {
        deviation: poses.max(contradicted),
        consistency,
        deviations,
        warnings,
    }
}

/// What each view says of each instance by itself.
fn measurements(
    pipeline: &Pipeline,
    instances: &[Instance],
    compared: &[Vec<(usize, Difference)>],
) -> Vec<Measurement> {
    let cameras = pipeline.rig.cameras();
    let of_instance = |(object, (instance, compared)): (usize, (&Instance, &Vec<_>))| {
        let measured = compared
            .iter()
            .map(|(camera, one): &(usize, Difference)| Measurement {
                object,
                class: instance.class,
                camera: *camera,
                motion: one.motion,
                covariance: one.covariance,
                center: one.center,
                camera_center: cameras[*camera].world_from_cam().translation.vector.into(),
                axis: cameras[*camera].world_from_cam().rotation * Vector3::z(),
            });
        measured.collect::<Vec<_>>()
    };
    let each = instances.iter().zip(compared).enumerate();
    each.flat_map(of_instance).collect()
}

/// Of each camera that detected an instance, how far its box is from where all boxes agree best; empty
/// of fewer than two boxes.
fn residuals(pipeline: &Pipeline, instance: &Instance) -> Vec<(usize, Residual)> {
    let config = &pipeline.config().rig;
    let boxes: Vec<(usize, BBox)> = boxes(pipeline, instance);
    let Some(best) = instance.best().filter(|_| boxes.len() > 1) else {
        return Vec::new();
    };
    let cameras = pipeline.rig.cameras();
    let sight = |&(camera, bbox): &(usize, BBox)| Sight {
        camera: &cameras[camera],
        bbox,
    };
    let sights: Vec<Sight> = boxes.iter().map(sight).collect();
    let points = &pipeline.estimator.bundle.classes[instance.class].points;
    let agreed = agreement(points, &sights, &best.world_from_obj, config.box_sigma);
    let nearest = agreed.map_or_else(Vec::new, |agreed| agreed.nearest);
    let cameras = boxes.into_iter().map(|(camera, _)| camera);
    cameras.zip(nearest).collect()
}

/// Index of each camera that detected an instance, with its box.
fn boxes(pipeline: &Pipeline, instance: &Instance) -> Vec<(usize, BBox)> {
    let seen = pipeline.views.iter().zip(&instance.detections);
    let seen = seen.filter_map(|(view, one)| Some((view.index, one.as_ref()?.bbox)));
    seen.collect()
}

/// The lower median of the known deviations; 0 without any. A false detection raises one deviation, a
/// wrong rig raises most.
fn lower_median(all: &[Option<f64>]) -> f64 {
    let mut known: Vec<f64> = all.iter().copied().flatten().collect();
    known.sort_by(f64::total_cmp);
    let middle = known.len().saturating_sub(1) / 2;
    known.get(middle).copied().unwrap_or(0.0)
}

/// The root mean square of the boxes' offsets, of the camera where it is greatest.
fn consistency(residuals: &[Vec<(usize, Residual)>]) -> RigConsistency {
    let mut squares: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
    for (camera, residual) in residuals.iter().flatten() {
        let (sum, count) = squares.entry(*camera).or_default();
        *sum += residual.offset.norm_squared();
        *count += 1.0;
    }
    let several = squares.len() > 2;
    let each = squares.into_iter();
    let each = each.map(|(camera, (sum, count))| (camera, (sum / count).sqrt()));
    let worst = each.max_by(|a, b| a.1.total_cmp(&b.1));
    RigConsistency {
        px: worst.map_or(0.0, |(_, px)| px),
        deviation: 0.0,
        camera_deviation: 0.0,
        scale_deviation: 0.0,
        box_deviation: 0.0,
        contradiction: 0.0,
        worst_camera: worst.filter(|_| several).map(|(camera, _)| camera),
    }
}

/// The warning for views that give different poses of one object.
fn disagreement(
    pipeline: &Pipeline,
    instances: &[Instance],
    compared: &[Vec<(usize, Difference)>],
    residuals: &[Vec<(usize, Residual)>],
    judgement: Option<&Judgement>,
) -> Option<Warning> {
    let (config, rig) = (&pipeline.config().rig, pipeline.rig);
    let name = |object: usize| &pipeline.estimator.bundle.classes[instances[object].class].name;
    let id = |camera: usize| rig.cameras()[camera].id();
    let scaled = judgement.filter(|one| {
        one.scale / config.max_scale_deviation > one.cameras / config.max_camera_deviation
    });
    if let Some(one) = scaled {
        let by = 100.0 * one.by.abs();
        return Some(Warning {
            code: WarningCode::SizesDisagree,
            camera: None,
            object: None,
            message: format!(
                "objects look {by:.1} % larger or smaller than at their distance by the rig; check the \
                 rig: unit and scale of its translations, focal lengths, and the resolution of images"
            ),
        });
    }
    let differences = compared.iter().enumerate();
    let differences =
        differences.flat_map(|(object, all)| all.iter().map(move |one| (object, one)));
    let worst = differences.max_by(|a, b| a.1.1.deviation.total_cmp(&b.1.1.deviation));
    let (object, camera, code, what) = match worst {
        Some((object, (camera, worst))) => {
            let id = id(*camera);
            let (code, what) = match worst.mostly {
                Kind::Across => (
                    WarningCode::LinesMiss,
                    format!(
                        "{:.1} mm beside its place in camera `{id}`",
                        worst.across * 1e3
                    ),
                ),
                Kind::Along => (
                    WarningCode::SizesDisagree,
                    format!(
                        "{:.0} % larger or smaller than at its distance in camera `{id}`",
                        100.0 * worst.along / worst.distance
                    ),
                ),
                Kind::Turn => (
                    WarningCode::TurnsDisagree,
                    format!(
                        "turned by {:.0} degrees in camera `{id}`",
                        worst.turn.to_degrees()
                    ),
                ),
            };
            (object, *camera, code, what)
        }
        None => {
            let all = residuals.iter().enumerate();
            let all = all.flat_map(|(object, all)| all.iter().map(move |one| (object, one)));
            let worst = all.max_by(|a, b| a.1.1.deviation().total_cmp(&b.1.1.deviation()));
            let (object, (camera, worst)) = worst?;
            let id = id(*camera);
            let (code, what) = match worst.is_of_size() {
                true => (
                    WarningCode::SizesDisagree,
                    format!(
                        "{:.0} % larger or smaller than at its distance in camera `{id}`",
                        100.0 * worst.log_size.abs().exp_m1()
                    ),
                ),
                false => (
                    WarningCode::LinesMiss,
                    format!(
                        "{:.1} px beside its place in camera `{id}`",
                        worst.offset.norm()
                    ),
                ),
            };
            (object, *camera, code, what)
        }
    };
    let cameras = compared[object].len().max(residuals[object].len());
    let camera = judgement.map_or(camera, |one| one.worst_camera);
    Some(Warning {
        code,
        // Of two cameras, none is known to be the wrong one.
        camera: (cameras > 2).then_some(camera),
        object: Some(object),
        message: format!(
            "views disagree: by the other views, `{}` is {what}; check the rig: {CHECK}",
            name(object)
        ),
    })
}

/// Two cameras that do not see the same objects.
struct Contradiction {
    /// Log-likelihood ratio of a wrong rig.
    ratio: f64,
    /// Indices of the cameras.
    cameras: [usize; 2],
    /// Objects that one of them shows and the other should show but does not.
    unconfirmed: usize,
    /// Objects that both show.
    confirmed: usize,
    /// Whether a third camera tells which of them is wrong.
    worst: Option<usize>,
}

impl Contradiction {
    fn warning(&self, rig: &Rig) -> Warning {
        let [a, b] = self.cameras.map(|camera| rig.cameras()[camera].id());
        let Self {
            unconfirmed,
            confirmed,
            ..
        } = self;
        let code = match confirmed {
            0 => WarningCode::NothingMatches,
            _ => WarningCode::ViewsContradict,
        };
        Warning {
            code,
            camera: self.worst,
            object: None,
            message: format!(
                "cameras `{a}` and `{b}` do not show the same scene: {unconfirmed} objects that one of \
                 them shows are not where the other should show them, {confirmed} are; check that each \
                 image is of its camera and of the same moment, and the rig: {CHECK}"
            ),
        }
    }
}

/// The two cameras that contradict each other most, by the objects that each of them shows.
fn contradiction(pipeline: &Pipeline, instances: &[Instance]) -> Option<Contradiction> {
    let config = pipeline.config();
    let faintest = f64::from(pipeline.estimator.bundle.detector.faintest());
    let threshold = f64::from(pipeline.estimator.bundle.detector.score_threshold);
    let count = pipeline.views.len();
    let scorer = pipeline.estimator.scorer();
    let mut unconfirmed = vec![vec![0_usize; count]; count];
    let mut confirmed = vec![vec![0_usize; count]; count];
    for instance in instances {
        let Some(best) = instance.best() else {
            continue;
        };
        // Of a bundle that was not calibrated it is no probability: what two views show counts.
        let confidence = match pipeline.estimator.bundle.scorer {
            Some(_) => instance.confidence(),
            None => 1.0,
        };
        let refined = best.refinement.is_some();
        let detected = |view: usize| instance.detections[view].map_or(0.0, |one| one.score);
        for a in 0..count {
            for b in (0..count).filter(|b| *b != a) {
                let in_b = best.evidence.iter().find(|one| one.view == b);
                // Both count an object that both have detected once.
                match (detected(a) > 0.0, detected(b) > 0.0) {
                    (true, true) if a < b && confidence >= config.rig.agree_confidence => {
                        confirmed[a][b] += 1;
                    }
                    (true, true) if a < b && confidence < config.search.min_confidence => {
                        unconfirmed[a][b] += 1;
                    }
                    (true, false) if detected(a) >= threshold => {
                        let expected = in_b.is_some_and(|one| one.visible > 0.9);
                        let shown = in_b.is_some_and(|one| {
                            one.detector >= faintest || scorer.view_log_odds(refined, one) > 0.0
                        });
                        if expected && !shown {
                            unconfirmed[a.min(b)][a.max(b)] += 1;
                        }
                    }
                    _ => {}
                }
            }
        }
    }
    // Nothing is seen by two cameras: what each of two finds alone of one class is unconfirmed.
    if confirmed.iter().flatten().all(|count| *count == 0) {
        for (a, row) in unconfirmed.iter_mut().enumerate() {
            for (b, number) in row.iter_mut().enumerate().skip(a + 1) {
                *number = (*number).max(alone_of_class(instances, a, b, threshold));
            }
        }
    }
    let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
    let ratio = |a: usize, b: usize| {
        UNCONFIRMED * unconfirmed[a][b] as f64 + CONFIRMED * confirmed[a][b] as f64
    };
    let (a, b) = pairs.max_by(|p, q| ratio(p.0, p.1).total_cmp(&ratio(q.0, q.1)))?;
    let of_camera = |view: usize| {
        let others = (0..count).filter(|other| *other != view);
        others
            .map(|other| ratio(view.min(other), view.max(other)))
            .sum::<f64>()
    };
    let worst = if of_camera(a) > of_camera(b) { a } else { b };
    let index = |view: usize| pipeline.views[view].index;
    Some(Contradiction {
        ratio: ratio(a, b),
        cameras: [index(a), index(b)],
        unconfirmed: unconfirmed[a][b],
        confirmed: confirmed[a][b],
        worst: (count > 2).then_some(index(worst)),
    })
}

/// Number of objects of classes that two views both find, each alone.
///
/// - `threshold`: score of a detection that counts
fn alone_of_class(instances: &[Instance], a: usize, b: usize, threshold: f64) -> usize {
    let mut counts: BTreeMap<usize, [usize; 2]> = BTreeMap::new();
    for instance in instances.iter().filter(|one| one.views() == 1) {
        for (side, view) in [a, b].into_iter().enumerate() {
            if instance.detections[view].is_some_and(|one| one.score >= threshold) {
                counts.entry(instance.class).or_default()[side] += 1;
            }
        }
    }
    counts.values().map(|[in_a, in_b]| 2 * in_a.min(in_b)).sum()
}
