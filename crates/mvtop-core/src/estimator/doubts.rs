//! What makes poses doubtful: a calibration that the boxes contradict.

use std::collections::BTreeMap;

use nalgebra::Isometry3;

use crate::bundle::{Bundle, Class};
use crate::consistency::alone::{Difference, Kind};
use crate::consistency::{Residual, Sight, agreement, extent, miss};
use crate::prediction::{CameraPose, ObjectPose, RigConsistency, Warning, WarningCode};
use crate::{BBox, Camera, Rig};

/// What is to be looked at in a rig that does not fit.
const CHECK: &str = "direction, axes and unit of its poses, focal lengths and lens models, and that \
                     each image is of its camera, neither turned nor rescaled";

/// An object as the views see it.
struct Judged {
    /// Index of the object.
    object: usize,
    /// Of each camera that shows it, where all its boxes agree best.
    residuals: Vec<(usize, Residual)>,
    /// By how much the line of sight through one of these boxes then misses it, at most, metres.
    missed: f64,
    /// How far the views are from one pose, in standard deviations.
    deviation: f64,
    /// Index of the camera that is off most.
    camera: usize,
    /// In what it is off.
    kind: Kind,
    /// A half sentence on that.
    told: String,
}

/// How well the rig fits what was found, and what to warn of. Expected errors grow to what lines of
/// sight miss each other by, and where the rig is doubted, to all that views are apart.
///
/// - `differences`: of each object, by index of the camera; empty where boxes alone can tell
pub fn of(
    bundle: &Bundle,
    rig: &Rig,
    objects: &mut [ObjectPose],
    differences: Vec<Vec<(usize, Difference)>>,
) -> (Option<RigConsistency>, Vec<Warning>) {
    let cameras = rig.cameras();
    let most = bundle.detector.most_deviation;
    let judged: Vec<Judged> = (objects.iter().zip(&differences).enumerate())
        .filter_map(|(index, (object, apart))| judge(bundle, cameras, index, object, apart))
        .collect();
    let overall = overall(&judged);
    let doubted = overall.is_some_and(|deviation| deviation > most);
    for one in &judged {
        let object = &mut objects[one.object];
        let missed = missed(&differences[one.object], one.missed, doubted);
        object.sigma.t_m = object.sigma.t_m.max(missed);
        object.deviation = Some(one.deviation);
    }
    let mut warnings = Vec::new();
    if doubted {
        warnings.extend(disagreement(most, objects, &judged));
    }
    // Where views agree on an object, the rig fits, and what one finds alone is no object or hidden.
    if doubted || overall.is_none() {
        warnings.extend(contradiction(bundle, cameras, objects));
    }
    let matched = objects.iter().any(|object| boxes(object).count() > 1);
    if !matched && warnings.is_empty() {
        warnings.extend(mismatch(cameras, objects));
    }
    let consistency = overall.and_then(|deviation| consistency(&judged, deviation));
    (consistency, warnings)
}

/// `None` for objects that fewer than two cameras show, or one of them not as a whole.
///
/// - `apart`: how far its views are from one pose; empty where they do not tell
fn judge(
    bundle: &Bundle,
    cameras: &[Camera],
    index: usize,
    object: &ObjectPose,
    apart: &[(usize, Difference)],
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
    let missed = (sights.iter().zip(&nearest))
        .filter_map(|(sight, residual)| miss(sight, residual, &object.world_from_obj))
        .fold(0.0, f64::max);
    let numbers = seen.iter().map(|(camera, _)| *camera);
    let residuals: Vec<(usize, Residual)> = numbers.zip(nearest).collect();
    let judged = match by_edges(cameras, index, apart) {
        Some(judged) => Judged {
            residuals,
            ..judged
        },
        None => by_boxes(cameras, index, residuals)?,
    };
    Some(Judged { missed, ..judged })
}

/// By how much lines of sight miss an object, at most, metres: as two views or more tell by the edges
/// that they show, else by boxes, which miss more where something hides the object.
///
/// A view in which it is hidden may tell anything by itself: only where the calibration is doubted does
/// that count.
///
/// - `apart`: how far its views are from one pose; empty where they do not tell
/// - `by_boxes`: by how much the lines of sight through its boxes do
fn missed(apart: &[(usize, Difference)], by_boxes: f64, doubted: bool) -> f64 {
    let all = apart.iter().map(|(_, off)| off);
    let by_edges = all.clone().filter(|off| off.by_edges);
    match (doubted, by_edges.clone().count()) {
        (true, _) if !apart.is_empty() => all
            .map(|off| off.across.hypot(off.along))
            .fold(0.0, f64::max),
        (false, 2..) => by_edges.map(|off| off.across).fold(0.0, f64::max),
        _ => by_boxes,
    }
}

/// By the pose that each view tells; `None` where they do not tell any.
fn by_edges(cameras: &[Camera], object: usize, apart: &[(usize, Difference)]) -> Option<Judged> {
    let by_deviation = |a: &&(usize, Difference), b: &&(usize, Difference)| {
        a.1.deviation.total_cmp(&b.1.deviation)
    };
    let (camera, worst) = *apart.iter().max_by(by_deviation)?;
    let id = cameras[camera].id();
    let told = match worst.mostly {
        Kind::Across => {
            let by = worst.across * 1e3;
            format!("is seen along lines that miss each other, by {by:.1} mm in camera `{id}`")
        }
        Kind::Along => told_size(worst.along / worst.distance, id),
        Kind::Turn => {
            let by = worst.turn.to_degrees();
            format!("is turned otherwise than in other views, by {by:.0} degrees in camera `{id}`")
        }
    };
    let squares = apart.iter().map(|(_, one)| one.deviation.powi(2));
    Some(Judged {
        object,
        residuals: Vec::new(),
        missed: 0.0,
        deviation: squares.sum::<f64>().sqrt(),
        camera,
        kind: worst.mostly,
        told,
    })
}

/// By boxes alone.
fn by_boxes(
    cameras: &[Camera],
    object: usize,
    residuals: Vec<(usize, Residual)>,
) -> Option<Judged> {
    let by_deviation = |a: &&(usize, Residual), b: &&(usize, Residual)| {
        a.1.deviation().total_cmp(&b.1.deviation())
    };
    let (camera, worst) = *residuals.iter().max_by(by_deviation)?;
    let id = cameras[camera].id();
    let (kind, told) = match worst.is_of_size() {
        true => (Kind::Along, told_size(worst.log_size.abs().exp_m1(), id)),
        false => {
            let by = worst.offset.norm();
            let told =
                format!("is seen along lines that miss each other, by {by:.1} px in camera `{id}`");
            (Kind::Across, told)
        }
    };
    Some(Judged {
        object,
        residuals,
        missed: 0.0,
        deviation: worst.deviation(),
        camera,
        kind,
        told,
    })
}

fn told_size(by: f64, camera: &str) -> String {
    let by = 100.0 * by;
    format!(
        "has another size than its distance by the rig gives it, by {by:.0} % in camera `{camera}`"
    )
}

/// The root mean square over the objects, of the camera where it is greatest.
///
/// - `deviation`: of all objects
fn consistency(judged: &[Judged], deviation: f64) -> Option<RigConsistency> {
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
        deviation,
        worst_camera: several.then_some(camera),
    })
}

/// How far the views are from one pose of an object, in standard deviations: of several objects, the
/// lower median. A wrong calibration shows in all of them, one that was taken for another thing alone.
fn overall(judged: &[Judged]) -> Option<f64> {
    let mut all: Vec<f64> = judged.iter().map(|object| object.deviation).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len().checked_sub(1)? / 2).copied()
}

/// One warning for all objects on which the views disagree; `None` where there are none.
///
/// - `most`: standard deviations that are not warned of
fn disagreement(most: f64, objects: &[ObjectPose], judged: &[Judged]) -> Option<Warning> {
    let doubted: Vec<&Judged> = judged
        .iter()
        .filter(|object| object.deviation > most)
        .collect();
    let worst = doubted
        .iter()
        .max_by(|a, b| a.deviation.total_cmp(&b.deviation))?;
    let name = &objects[worst.object].class;
    let of = match judged.len() {
        1 => String::new(),
        all => format!(" ({} of {all} objects)", doubted.len()),
    };
    Some(Warning {
        code: match worst.kind {
            Kind::Across => WarningCode::LinesMiss,
            Kind::Along => WarningCode::SizesDisagree,
            Kind::Turn => WarningCode::TurnsDisagree,
        },
        // Of two cameras, none is known to be the wrong one.
        camera: (worst.residuals.len() > 2).then_some(worst.camera),
        object: Some(worst.object),
        message: format!("`{name}` {}{of}; check the rig: {CHECK}", worst.told),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_hidden_views_tell_counts_where_the_rig_is_doubted() {
        let off = |by_edges, across, along| Difference {
            deviation: 1.0,
            across,
            along,
            distance: 1.0,
            turn: 0.0,
            by_edges,
            mostly: Kind::Across,
        };
        let apart = [
            (0, off(true, 0.001, 0.02)),
            (1, off(true, 0.002, 0.0)),
            (2, off(false, 0.03, 0.04)),
        ];
        assert_eq!(missed(&apart, 0.01, false), 0.002);
        assert_eq!(missed(&apart, 0.01, true), 0.05);
        // Boxes count where edges do not tell.
        assert_eq!(missed(&apart[1..], 0.01, false), 0.01);
        assert_eq!(missed(&[], 0.01, true), 0.01);
    }
}
