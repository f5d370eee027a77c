//! A second look at objects that their close-ups hardly show.
//!
//! The box of what is half hidden often ends where that is hidden, and the close-up of such a box
//! shows the object where it is not. The poses that come of it, refined on the images, tell other
//! boxes, one of them a better one, that a better pose. Of all that was looked at, the pose that the
//! images show best counts; where not even that one looks like what is printed on the object, it is
//! another thing.

use nalgebra::Isometry3;

use super::complete::shown;
use super::pass::{Found, Pass};
use super::pose::DecodedPose;
use super::sightings::Sighting;
use super::view::View;
use super::{Estimator, believed, refined};
use crate::bundle::{Class, CloseUps};
use crate::{BBox, Result};

/// Looks at an object, at most.
const LOOKS: usize = 5;
/// Poses of an object whose boxes are tried, at most, refined and as they were.
const POSES: usize = 3;
/// Support of an object that is seen well enough.
const SEEN_WELL: f64 = 0.25;
/// A box that overlaps with that of the pose by this (intersection over union) shows the same.
const SAME: f64 = 0.9;

/// An object that is looked at again.
struct Looked {
    /// Of those that were found.
    index: usize,
    /// As it was looked at last.
    last: (Sighting, DecodedPose),
    /// Of the one that is shown best so far: whether its pose is supported enough, whether it looks like
    /// its print, and its score.
    shown: (bool, bool, f64),
}

impl Pass<'_> {
    /// The objects, those that are hardly supported with the boxes and poses that the images show best,
    /// and without those of these that do not look like their print.
    pub(super) fn looked_at_again(&self, closeups: &CloseUps, mut found: Found) -> Result<Found> {
        let Estimator {
            bundle, refiners, ..
        } = self.estimator;
        let views = &self.views;
        let least = bundle.detector.support_threshold;
        let least_print = bundle.detector.print_threshold;
        let support = |pose: &DecodedPose| pose.support.unwrap_or(f64::INFINITY);
        let hardly = |pose: &DecodedPose| support(pose) < SEEN_WELL;
        let doubtful = |(object, pose): &(Sighting, DecodedPose)| {
            refiners[object.class].is_some() && object.views() > 1 && hardly(pose)
        };
        let mut looked: Vec<Looked> = (0..found.len())
            .filter(|&index| doubtful(&found[index]))
            .map(|index| Looked {
                index,
                last: found[index].clone(),
                shown: (false, false, f64::NEG_INFINITY),
            })
            .collect();
        let mut best_shown = vec![None; found.len()];
        for look in 0..=LOOKS {
            let mut refined: Vec<_> = looked.iter().map(|one| one.last.clone()).collect();
            let refinements = refined::on_images(refiners, views, bundle, &mut refined);
            for (one, refinement) in looked.iter_mut().zip(&refinements) {
                let score = refinement.map_or(f64::NEG_INFINITY, |refinement| refinement.score());
                let print = refinement.and_then(|refinement| refinement.print);
                let supported = support(&one.last.1) >= least;
                let shown = (supported, !believed::differs(print, least_print), score);
                if shown > one.shown {
                    one.shown = shown;
                    found[one.index] = one.last.clone();
                    best_shown[one.index] = *refinement;
                }
            }
            if look == LOOKS {
                break;
            }
            let (mut places, mut objects) = (Vec::new(), Vec::new());
            for (place, (one, (object, pose))) in looked.iter().zip(&refined).enumerate() {
                if !hardly(&found[one.index].1) {
                    continue;
                }
                let class = &bundle.classes[object.class];
                // Where little is seen of an object, refinement may lead astray.
                let likeliest = [pose, &one.last.1].map(|pose| pose.hypotheses.iter().take(POSES));
                let moved = (likeliest.into_iter().flatten())
                    .filter_map(|pose| at_pose(class, views, object, &pose.world_from_obj));
                objects.extend(moved);
                places.resize(objects.len(), place);
            }
            if objects.is_empty() {
                break;
            }
            let poses = self.decoded(closeups, &objects)?;
            let mut best: Vec<Option<(Sighting, DecodedPose)>> = vec![None; looked.len()];
            for (place, new) in places.into_iter().zip(objects.into_iter().zip(poses)) {
                let better = |best: &(_, DecodedPose)| support(&new.1) > support(&best.1);
                if best[place].as_ref().is_none_or(better) {
                    best[place] = Some(new);
                }
            }
            let again = looked.into_iter().zip(best);
            looked = again
                .filter_map(|(one, best)| Some(Looked { last: best?, ..one }))
                .collect();
        }
        Ok(believed::printed(found, best_shown, least_print).0)
    }
}

/// The object with the boxes of a pose of it; `None` where it has them.
pub(super) fn at_pose(
    class: &Class,
    views: &[View],
    object: &Sighting,
    world_from_obj: &Isometry3<f64>,
) -> Option<Sighting> {
    let each = views.iter().zip(&object.boxes);
    let boxes: Vec<Option<BBox>> = each
        .map(|(view, bbox)| shown(class, view, world_from_obj).or(*bbox))
        .collect();
    let same = |(a, b): (&Option<BBox>, &Option<BBox>)| match (a, b) {
        (Some(a), Some(b)) => a.iou(b) > SAME,
        (a, b) => a.is_none() && b.is_none(),
    };
    let moved = !boxes.iter().zip(&object.boxes).all(same);
    moved.then(|| Sighting {
        boxes,
        ..object.clone()
    })
}
