//! What makes poses doubtful: a calibration, or images, that the views of all objects contradict.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::contradiction::{Contradiction, Counts};
use super::instance::Instance;
use super::pipeline::Pipeline;
use super::rig_test::{self, Judgement, Measurement};
use crate::BBox;
use crate::consistency::alone::{Difference, Kind};
use crate::consistency::{Residual, Sight, agreement};
use crate::prediction::{RigConsistency, Warning, WarningCode};

/// What is to be looked at in a rig that does not fit.
const CHECK: &str = "direction, axes and unit of its poses, focal lengths and lens models, and that \
                     each image is of its camera, neither turned nor rescaled";

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
    let contradiction = Contradiction::find(pipeline, instances);
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
    let contradicted = contradiction
        .as_ref()
        .map_or(0.0, |one| one.ratio / config.max_contradiction);
    let deviation = poses.max(contradicted);
    let mut warnings = Vec::new();
    if poses > 1.0 {
        let judgement = judgement.as_ref();
        warnings.extend(disagreement(
            pipeline, instances, compared, &residuals, judgement,
        ));
    }
    if let Some(one) = contradiction.as_ref().filter(|_| contradicted > 1.0) {
        warnings.push(contradicts(pipeline, one));
    }
    let consistency = contradiction.map(|one| RigConsistency {
        deviation,
        camera_deviation: judgement.map_or(0.0, |one| one.cameras),
        scale_deviation: judgement.map_or(0.0, |one| one.scale),
        box_deviation,
        contradiction: one.ratio,
        confirmed: one.counts.confirmed,
        unconfirmed: one.counts.unconfirmed,
        ..consistency(&residuals)
    });
    Checked {
        deviation,
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
        confirmed: 0,
        unconfirmed: 0,
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

/// The warning for two cameras that do not show the same objects.
fn contradicts(pipeline: &Pipeline, one: &Contradiction) -> Warning {
    let [a, b] = one.views.map(|view| pipeline.views[view].camera.id());
    let Counts {
        confirmed,
        unconfirmed,
    } = one.counts;
    Warning {
        code: match confirmed {
            0 => WarningCode::NothingMatches,
            _ => WarningCode::ViewsContradict,
        },
        camera: one.worst.map(|view| pipeline.views[view].index),
        object: None,
        message: format!(
            "cameras `{a}` and `{b}` do not show the same scene: {unconfirmed} objects that one of \
             them shows are not where the other should show them, {confirmed} are; check that each \
             image is of its camera and of the same moment, and the rig: {CHECK}"
        ),
    }
}
