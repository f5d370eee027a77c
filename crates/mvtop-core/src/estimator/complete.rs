//! What a view has missed, told by the poses that the other views have settled.

use nalgebra::Isometry3;

use super::pose::DecodedPose;
use super::sightings::Sighting;
use super::view::View;
use crate::BBox;
use crate::bundle::Class;
use crate::closeup::CloseUp;
use crate::consistency::extent;

/// A box shows the object that is projected there if they overlap by this (intersection over union).
const SAME_BOX: f64 = 0.4;

/// Share of the object's extent that must lie in a view's image.
const LEAST_IN_IMAGE: f64 = 0.6;

/// Views that must have seen an object before it is looked for in others.
const WITNESSES: usize = 2;

/// Gives boxes that were taken for objects of their own to the object that is projected there: of
/// each `(object, pose)` that several views have settled, in the views that lack it.
///
/// - returns: what is left, and whether each object gained a box
pub fn merge(
    classes: &[Class],
    views: &[View],
    found: Vec<(Sighting, DecodedPose)>,
) -> Vec<(Sighting, DecodedPose, bool)> {
    let (settled, alone): (Vec<_>, Vec<_>) = found
        .into_iter()
        .map(|(object, pose)| (object, pose, false))
        .partition(|(object, _, _)| object.views() >= WITNESSES);
    let mut settled = settled;
    let mut left = Vec::new();
    for (single, pose, _) in alone {
        let seen = single.boxes.iter().enumerate();
        let Some((view, bbox)) = seen.filter_map(|(v, bbox)| Some((v, (*bbox)?))).next() else {
            continue;
        };
        let owner = settled.iter_mut().find(|(object, pose, _)| {
            object.class == single.class
                && object.boxes[view].is_none()
                && extent(
                    &classes[object.class].points,
                    views[view].camera,
                    &pose.world_from_obj,
                )
                .is_some_and(|expected| expected.iou(&bbox) >= SAME_BOX)
        });
        match owner {
            Some((object, _, gained)) => {
                object.boxes[view] = Some(bbox);
                *gained = true;
            }
            None => left.push((single, pose, false)),
        }
    }
    settled.extend(left);
    settled.sort_by(|(a, ..), (b, ..)| b.score.total_cmp(&a.score));
    settled
}

/// The object with a box in every view that has most of it in its image, seen or not; `None` where
/// that adds none, or too few views have seen it.
pub fn filled_in(
    class: &Class,
    views: &[View],
    object: &Sighting,
    pose: &DecodedPose,
) -> Option<Sighting> {
    if object.views() < WITNESSES {
        return None;
    }
    let boxes: Vec<Option<BBox>> = views
        .iter()
        .zip(&object.boxes)
        .map(|(view, bbox)| bbox.or_else(|| shown(class, view, &pose.world_from_obj)))
        .collect();
    (boxes != object.boxes).then_some(Sighting {
        class: object.class,
        score: object.score,
        boxes,
    })
}

/// Of the views that have most of the object in their image, the share that has a box of it; 1 for
/// objects that several views have seen, as these are looked for in the others.
pub fn share_of_views(class: &Class, views: &[View], object: &Sighting, pose: &DecodedPose) -> f64 {
    let seen = object.views();
    if seen >= WITNESSES {
        return 1.0;
    }
    let missing = views.iter().zip(&object.boxes).filter(|(view, bbox)| {
        bbox.is_none() && shown(class, view, &pose.world_from_obj).is_some()
    });
    seen as f64 / (seen + missing.count()) as f64
}

/// The part in the image of the object's extent there, if it is most of it.
pub fn shown(class: &Class, view: &View, world_from_obj: &Isometry3<f64>) -> Option<BBox> {
    let whole = extent(&class.points, view.camera, world_from_obj)?;
    let bbox = whole.clip(view.camera.width(), view.camera.height())?;
    let share = bbox.width() * bbox.height() / (whole.width() * whole.height());
    (share >= LEAST_IN_IMAGE && CloseUp::is_of(view.camera, bbox)).then_some(bbox)
}
