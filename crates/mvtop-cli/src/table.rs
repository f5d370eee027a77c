//! Poses as text for people.

use mvtop_core::annotations::TruePose;
use mvtop_core::bundle::Class;
use mvtop_core::pose::{rotation_error_deg, translation_error, wxyz};
use mvtop_core::prediction::ObjectPose;
use mvtop_core::scorer::Verdict;
use mvtop_core::{Prediction, Rig};
use nalgebra::Isometry3;

use mvtop_eval::matching::matches;

/// The objects, one row each, then the timings.
///
/// - `least`: confidence that is asked for
pub fn objects(prediction: &Prediction, rig: &Rig, least: Option<f64>) -> String {
    let reference = rig.cameras()[prediction.reference].id();
    let mut lines = Vec::new();
    if prediction.objects.is_empty() {
        lines.push("no object detected".to_owned());
    } else {
        let classes = prediction
            .objects
            .iter()
            .map(|object| object.class.chars().count());
        let width = classes.max().unwrap_or(0).max("class".len());
        lines.push(format!("poses in the frame of camera `{reference}`"));
        lines.push(format!(
            "{:width$}  score  {:24}  {:31}  {:16}  confidence  detected in",
            "class", "t (m)", "q_wxyz", "expected error"
        ));
        for object in &prediction.objects {
            lines.push(format!(
                "{:width$}  {:5.2}  {}  {:5.1}° {:6.1} mm  {:10}  {}{}",
                object.class,
                object.score,
                pose(&object.ref_from_obj),
                object.sigma.rot_deg,
                object.sigma.t_m * 1e3,
                confidence(object),
                detected_in(object, rig),
                least.map_or("", |least| verdict(object, least)),
            ));
        }
    }
    let t = &prediction.timings;
    lines.push(String::new());
    lines.push(format!(
        "prepare {:.1} ms, features {:.1} ms, detect {:.1} ms, crops {:.1} ms, propose {:.1} ms, \
         refine {:.1} ms, check {:.1} ms, total {:.1} ms on `{}`",
        t.prepare,
        t.features,
        t.detect,
        t.crop,
        t.propose,
        t.refine,
        t.check,
        t.total,
        prediction.provider
    ));
    lines.join("\n")
}

/// Predicted poses beside the known ones; of those that look like a predicted one, the nearest.
pub fn compared(
    prediction: &Prediction,
    truth: &[TruePose],
    rig: &Rig,
    classes: &[Class],
) -> String {
    let world_from_ref = rig.cameras()[prediction.reference].world_from_cam();
    let mut lines = Vec::new();
    for (known, found) in truth
        .iter()
        .zip(matches(truth, prediction, |_| f64::INFINITY))
    {
        let ref_from_obj = world_from_ref.inv_mul(&known.world_from_obj);
        lines.push(format!("{}  {:24}  q_wxyz", known.seen.class, "t (m)"));
        let class = classes.iter().find(|class| class.name == known.seen.class);
        let found = found.map(|object| {
            class.map_or(object.ref_from_obj, |class| {
                let (symmetry, diameter) = (&class.symmetry, class.diameter_m);
                symmetry.nearest(&object.ref_from_obj, &ref_from_obj, diameter)
            })
        });
        let predicted = found.as_ref().map_or("not found".into(), pose);
        lines.push(format!("  predicted  {predicted}"));
        lines.push(format!("  known      {}", pose(&ref_from_obj)));
        if let Some(found) = &found {
            let rotation = rotation_error_deg(&ref_from_obj.rotation, &found.rotation);
            let translation = 1e3 * translation_error(&ref_from_obj, found);
            lines.push(format!(
                "  error      rotation {rotation:.2} deg, translation {translation:.1} mm"
            ));
        }
    }
    lines.join("\n")
}

fn pose(pose: &Isometry3<f64>) -> String {
    let t = pose.translation.vector;
    let [w, x, y, z] = wxyz(&pose.rotation);
    format!(
        "{:+8.4}{:+8.4}{:+8.4}  {w:+.4} {x:+.4} {y:+.4} {z:+.4}",
        t.x, t.y, t.z
    )
}

fn confidence(object: &ObjectPose) -> String {
    let known = object.confidence.map(|p| format!("{:.1} %", 100.0 * p));
    known.unwrap_or("–".into())
}

fn verdict(object: &ObjectPose, least: f64) -> &'static str {
    match Verdict::of(object, least) {
        Verdict::Accept => ": accept",
        Verdict::NeedAnotherView => ": need another view",
        Verdict::Reject => ": reject",
    }
}

fn detected_in(object: &ObjectPose, rig: &Rig) -> String {
    let seen = object.cameras.iter().filter(|seen| seen.bbox.is_some());
    let ids: Vec<&str> = seen.map(|seen| rig.cameras()[seen.camera].id()).collect();
    ids.join(" ")
}
