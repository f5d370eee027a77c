//! What makes poses doubtful: a calibration that the boxes contradict.

use std::collections::BTreeMap;

use nalgebra::Isometry3;

use crate::bundle::{Bundle, Class};
use crate::consistency::{OFFSET_SIGMA, Residual, Sight, agreement, extent, miss};
use crate::prediction::{CameraPose, ObjectPose, RigConsistency, Warning, WarningCode};
use crate::{BBox, Camera, Rig};

/// Residuals of more standard deviations than this are warned of; chosen on samples of seed 21
/// (`docs/warnings.md`).
const MOST_DEVIATION: f64 = 4.1;
/// What is to be looked at in a rig that does not fit.
const CHECK: &str = "direction, axes and unit of its poses, focal lengths and lens models, and that \
                     each image is of its camera, neither turned nor rescaled";

/// An object as the boxes see it.
struct Judged {
    /// Index of the object.
    object: usize,
    /// Of each camera that shows it, where all its boxes agree best.
    residuals: Vec<(usize, Residual)>,
    /// The greatest of them.
    worst: (usize, Residual),
}

/// How well the rig fits what was found, and what to warn of. Expected errors grow to what lines of
/// sight miss each other by.
pub fn of(
    bundle: &Bundle,
    rig: &Rig,
    objects: &mut [ObjectPose],
) -> (Option<RigConsistency>, Vec<Warning>) {
    let cameras = rig.cameras();
    // Other detectors' boxes err alike, but by another measure.
    let most = MOST_DEVIATION * bundle.detector.box_error / OFFSET_SIGMA;
    let judged: Vec<Judged> = objects
        .iter_mut()
        .enumerate()
        .filter_map(|(index, object)| judge(bundle, cameras, index, object))
        .collect();
    let mut warnings = Vec::from_iter(disagreement(most, cameras, objects, &judged));
    warnings.extend(contradiction(bundle, cameras, objects));
    let matched = objects.iter().any(|object| boxes(object).count() > 1);
    if !matched && warnings.is_empty() {
        warnings.extend(mismatch(cameras, objects));
    }
    (consistency(&judged), warnings)
}

/// `None` for objects that fewer than two cameras show, or one of them not as a whole.
fn judge(
    bundle: &Bundle,
    cameras: &[Camera],
    index: usize,
    object: &mut ObjectPose,
) -> Option<Judged> {
    let class = class_of(bundle, object)?;
    let seen: Vec<(usize, BBox)> = boxes(object).collect();
    if seen.len() < 2 {
        return None;
    }
    let sight = |&(camera, bbox): &(usize, BBox)| Sight {
        camera: &cameras[camera],
        bbox,
    };
    let sights: Vec<Sight> = seen.iter().map(sight).collect();
    let nearest = agreement(&class.points, &sights, &object.world_from_obj)?.nearest;
    for (sight, residual) in sights.iter().zip(&nearest) {
        if let Some(miss) = miss(sight, residual, &object.world_from_obj) {
            object.sigma.t_m = object.sigma.t_m.max(miss);
        }
    }
    let numbers = seen.iter().map(|(camera, _)| *camera);
    let residuals: Vec<(usize, Residual)> = numbers.zip(nearest).collect();
    let by_deviation = |a: &&(usize, Residual), b: &&(usize, Residual)| {
        a.1.deviation().total_cmp(&b.1.deviation())
    };
    Some(Judged {
        object: index,
        worst: *residuals.iter().max_by(by_deviation)?,
        residuals,
    })
}

/// The root mean square over the objects, of the camera where it is greatest.
fn consistency(judged: &[Judged]) -> Option<RigConsistency> {
    let mut squares: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
    for (camera, residual) in judged.iter().flat_map(|object| &object.residuals) {
        let (sum, count) = squares.entry(*camera).or_default();
        *sum += residual.offset.norm_squared();
        *count += 1.0;
    }
    let several = squares.len() > 2;
    let each = squares.into_iter();
    let each = each.map(|(camera, (sum, count))| (camera, (sum / count).sqrt()));
    let (camera, px) = each.max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(RigConsistency {
        px,
        worst_camera: several.then_some(camera),
    })
}

/// One warning for all objects whose boxes disagree.
///
/// - `most`: standard deviations of the shipped detector's boxes
fn disagreement(
    most: f64,
    cameras: &[Camera],
    objects: &[ObjectPose],
    judged: &[Judged],
) -> Option<Warning> {
    let doubted: Vec<&Judged> = judged
        .iter()
        .filter(|object| object.worst.1.deviation() > most)
        .collect();
    let by_deviation = |a: &&&Judged, b: &&&Judged| {
        let [a, b] = [a, b].map(|object| object.worst.1.deviation());
        a.total_cmp(&b)
    };
    let most = doubted.iter().max_by(by_deviation)?;
    let (camera, residual) = most.worst;
    let name = &objects[most.object].class;
    let (code, what) = match residual.is_of_size() {
        true => (
            WarningCode::SizesDisagree,
            format!(
                "has another size than its distance by the rig gives it, by {:.0} % in camera `{}`",
                100.0 * residual.log_size.abs().exp_m1(),
                cameras[camera].id()
            ),
        ),
        false => (
            WarningCode::LinesMiss,
            format!(
                "is seen along lines that miss each other, by {:.1} px in camera `{}`",
                residual.offset.norm(),
                cameras[camera].id()
            ),
        ),
    };
    let of = match judged.len() {
        1 => String::new(),
        all => format!(" ({} of {all} objects)", doubted.len()),
    };
    Some(Warning {
        code,
        // Of two cameras, none is known to be the wrong one.
        camera: (most.residuals.len() > 2).then_some(camera),
        object: Some(most.object),
        message: format!("`{name}` {what}{of}; check the rig: {CHECK}"),
    })
}

/// Two cameras that each find an object of a class where the other finds none.
fn contradiction(bundle: &Bundle, cameras: &[Camera], objects: &[ObjectPose]) -> Option<Warning> {
    let alone: Vec<(usize, usize)> = objects
        .iter()
        .enumerate()
        .filter_map(|(index, object)| Some((index, only(object)?)))
        .collect();
    let (a, in_a, in_b) = alone.iter().find_map(|&(a, in_a)| {
        let class = class_of(bundle, &objects[a])?;
        let other = |&&(b, in_b): &&(usize, usize)| {
            in_b != in_a
                && objects[b].class == objects[a].class
                && is_inside(class, &cameras[in_b], &objects[a].world_from_obj)
        };
        let (_, in_b) = alone.iter().find(other)?;
        Some((a, in_a, *in_b))
    })?;
    Some(Warning {
        code: WarningCode::ViewsContradict,
        camera: None,
        object: Some(a),
        message: format!(
            "camera `{in_a}` alone finds `{name}` at a place in view of camera `{in_b}`, which finds \
             its own elsewhere; check the rig: {CHECK}",
            in_a = cameras[in_a].id(),
            in_b = cameras[in_b].id(),
            name = objects[a].class,
        ),
    })
}

/// Two cameras that each find objects of a class, of which none is found by both.
fn mismatch(cameras: &[Camera], objects: &[ObjectPose]) -> Option<Warning> {
    let alone: Vec<(&ObjectPose, usize)> = objects
        .iter()
        .filter_map(|object| Some((object, only(object)?)))
        .collect();
    let (object, in_a, in_b) = alone.iter().find_map(|&(a, in_a)| {
        let other = |&&(b, in_b): &&(&ObjectPose, usize)| in_b != in_a && b.class == a.class;
        Some((a, in_a, alone.iter().find(other)?.1))
    })?;
    Some(Warning {
        code: WarningCode::NothingMatches,
        camera: None,
        object: None,
        message: format!(
            "cameras `{}` and `{}` both find `{}`, but at no place is it seen by two cameras, so each \
             pose is of one view; unless these are different ones, check the rig: {CHECK}",
            cameras[in_a].id(),
            cameras[in_b].id(),
            object.class,
        ),
    })
}

/// Whether the whole object is in a camera's image.
fn is_inside(class: &Class, camera: &Camera, world_from_obj: &Isometry3<f64>) -> bool {
    let whole = extent(&class.points, camera, world_from_obj);
    whole.is_some_and(|bbox| bbox.clip(camera.width(), camera.height()) == Some(bbox))
}

fn class_of<'a>(bundle: &'a Bundle, object: &ObjectPose) -> Option<&'a Class> {
    bundle
        .class_index(&object.class)
        .map(|class| &bundle.classes[class])
}

/// Index of each camera that shows the object, with its box.
fn boxes(object: &ObjectPose) -> impl Iterator<Item = (usize, BBox)> + '_ {
    let in_camera = |seen: &CameraPose| Some((seen.camera, seen.bbox?));
    object.cameras.iter().filter_map(in_camera)
}

/// The camera that shows the object, where it is one alone.
fn only(object: &ObjectPose) -> Option<usize> {
    let mut all = boxes(object);
    let (camera, _) = all.next()?;
    all.next().is_none().then_some(camera)
}
