//! A second look at objects that their close-ups hardly show.
//!
//! The box of what is half hidden often ends where that is hidden, and the close-up of such a box
//! shows the object where it is not. The poses that come of it, refined on the images, tell other
//! boxes, one of them a better one, that a better pose. The two that are supported most are followed,
//! as the first steps may lead astray, as long as one of them shows something better. Of all that was
//! looked at, the pose that the images show best counts; where not even that one looks like what is
//! printed on the object, it is another thing. Its pose is the mean of that look and of some through
//! rolled close-ups, which err otherwise.

use nalgebra::Isometry3;

use super::complete::shown;
use super::pass::{Found, Pass};
use super::pose::{DecodedPose, mean_pose};
use super::sightings::Sighting;
use super::view::View;
use super::{Estimator, believed, hypotheses, refined};
use crate::bundle::{Class, CloseUps};
use crate::prediction::{Hypothesis, Refinement};
use crate::{BBox, Result};

/// Looks at an object, at most.
const LOOKS: usize = 4;
/// Boxes of an object that are followed at once.
const PATHS: usize = 2;
/// Poses that a look tells whose boxes are tried, at most, besides the refined one.
const POSES: usize = 3;
/// Support of an object that is seen well enough.
const SEEN_WELL: f64 = 0.25;
/// A box that overlaps with that of the pose by this (intersection over union) shows the same.
const SAME: f64 = 0.9;
/// Refined poses that are turned less from each other are one: it is then as well shown by either.
const SAME_DEG: f64 = 5.0;

/// An object's box in each view that shows it.
type Boxes = Vec<Option<BBox>>;

/// An object that is looked at again.
struct Looked {
    /// Of those that were found.
    index: usize,
    /// As it was looked at last, with other boxes each.
    last: Found,
    /// All boxes that it was looked at with.
    tried: Vec<Boxes>,
    best: Option<Best>,
}

/// What is shown best so far.
struct Best {
    seen: (Sighting, DecodedPose),
    /// Where refinement leads.
    end: Isometry3<f64>,
    /// Whether its pose is supported enough, and whether it looks like its print.
    believed: [bool; 2],
    refinement: Option<Refinement>,
}

impl Best {
    fn score(&self) -> f64 {
        let score = self.refinement.map(|refinement| refinement.score());
        score.unwrap_or(f64::NEG_INFINITY)
    }

    /// Whether it is shown better than the other one; where both end at the same pose, whether it is
    /// supported more.
    fn is_better(&self, other: &Self, class: &Class) -> bool {
        if self.believed != other.believed {
            return self.believed > other.believed;
        }
        let apart = (class.symmetry).apart_deg(&self.end, &other.end, class.diameter_m);
        match apart < SAME_DEG {
            true => support(&self.seen.1) > support(&other.seen.1),
            false => self.score() > other.score(),
        }
    }
}

impl Pass<'_> {
    /// The objects, those that are hardly supported with the boxes and poses that the images show best,
    /// and without those of these that do not look like their print.
    pub(super) fn looked_at_again(&self, closeups: &CloseUps, mut found: Found) -> Result<Found> {
        let Estimator {
            bundle, refiners, ..
        } = self.estimator;
        let doubtful = |(object, pose): &(Sighting, DecodedPose)| {
            refiners[object.class].is_some() && object.views() > 1 && support(pose) < SEEN_WELL
        };
        let looked = |index: usize| Looked {
            index,
            last: vec![found[index].clone()],
            tried: vec![found[index].0.boxes.clone()],
            best: None,
        };
        let mut looked: Vec<Looked> = (0..found.len())
            .filter(|&index| doubtful(&found[index]))
            .map(looked)
            .collect();
        for look in 0..=LOOKS {
            let mut moved = self.told(&mut looked)?;
            for (one, moved) in looked.iter().zip(&mut moved) {
                let seen_well = |best: &Best| support(&best.seen.1) >= SEEN_WELL;
                if look == LOOKS || one.best.as_ref().is_some_and(seen_well) {
                    moved.clear();
                }
            }
            let objects = moved.concat();
            if objects.is_empty() {
                break;
            }
            let poses = self.decoded(closeups, &objects)?;
            let mut decoded = objects.into_iter().zip(poses);
            for (one, moved) in looked.iter_mut().zip(&moved) {
                one.last = most_supported(decoded.by_ref().take(moved.len()).collect());
            }
        }
        let mut refinements = vec![None; found.len()];
        let best = looked.into_iter().map(|one| Some((one.index, one.best?)));
        let best: Vec<(usize, Best)> = best.flatten().collect();
        let place = |best: &Best| best.seen.1.world_from_obj;
        let places: Vec<_> = best
            .iter()
            .map(|one| (&one.1.seen.0, place(&one.1)))
            .collect();
        let looks = self.rolled_looks(closeups, &places)?;
        for ((index, mut best), looks) in best.into_iter().zip(looks) {
            let (object, pose) = &mut best.seen;
            average(pose, &looks, &bundle.classes[object.class]);
            refinements[index] = best.refinement;
            found[index] = best.seen;
        }
        let least = bundle.detector.print_threshold;
        Ok(believed::printed(found, refinements, least).0)
    }

    /// Refines the likeliest pose of what was looked at last, keeps what is shown best of each object,
    /// and gives the boxes that the poses tell: new ones, and none once a look has shown nothing better.
    fn told(&self, looked: &mut [Looked]) -> Result<Vec<Vec<Sighting>>> {
        let Estimator {
            bundle, refiners, ..
        } = self.estimator;
        let (views, detector) = (&self.views, &bundle.detector);
        let mut refined: Found = looked.iter().flat_map(|one| one.last.clone()).collect();
        for (_, pose) in &mut refined {
            pose.hypotheses.truncate(1);
        }
        let refinements = refined::on_images(refiners, views, bundle, &mut refined, None)?;
        let mut refined = refined.into_iter().zip(refinements);
        let mut told = Vec::new();
        for one in looked {
            let (mut moved, mut is_better) = (Vec::new(), false);
            for ((object, was), ((_, pose), refinement)) in one.last.drain(..).zip(&mut refined) {
                let class = &bundle.classes[object.class];
                // Where little is seen of an object, refinement may lead astray.
                let likeliest = [&pose, &was].map(|pose| pose.hypotheses.iter().take(POSES));
                let likeliest = likeliest.into_iter().flatten();
                moved.extend(likeliest.filter_map(|hypothesis| {
                    at_pose(class, views, &object, &hypothesis.world_from_obj)
                }));
                let print = refinement.and_then(|refinement| refinement.print);
                let new = Best {
                    believed: [
                        support(&was) >= detector.support_threshold,
                        !believed::differs(print, detector.print_threshold),
                    ],
                    seen: (object, was),
                    end: pose.world_from_obj,
                    refinement,
                };
                if one
                    .best
                    .as_ref()
                    .is_none_or(|best| new.is_better(best, class))
                {
                    one.best = Some(new);
                    is_better = true;
                }
            }
            told.push(match is_better {
                true => untried(moved, &mut one.tried),
                false => Vec::new(),
            });
        }
        Ok(told)
    }
}

/// Makes a pose the mean of itself and of those of more looks near it, each by its support.
fn average(pose: &mut DecodedPose, looks: &[DecodedPose], class: &Class) {
    let Class {
        symmetry,
        diameter_m,
        ..
    } = class;
    let each = std::iter::once(&*pose).chain(looks);
    let firsts = each.filter_map(|look| {
        Some(Hypothesis {
            probability: look.support?,
            ..*look.hypotheses.first()?
        })
    });
    let near = |one: &Hypothesis| {
        let away = symmetry.apart_deg(&pose.world_from_obj, &one.world_from_obj, *diameter_m);
        away < hypotheses::NEAR_DEG
    };
    let near: Vec<Hypothesis> = firsts.filter(near).collect();
    if near.iter().any(|one| one.probability > 0.0) {
        let mean = mean_pose(&near, symmetry, *diameter_m).world_from_obj;
        pose.world_from_obj = mean;
        pose.hypotheses[0].world_from_obj = mean;
    }
}

fn support(pose: &DecodedPose) -> f64 {
    pose.support.unwrap_or(f64::INFINITY)
}

/// The [`PATHS`] that are supported most.
fn most_supported(mut all: Found) -> Found {
    all.sort_by(|(_, a), (_, b)| support(b).total_cmp(&support(a)));
    all.truncate(PATHS);
    all
}

/// Those whose boxes show something else each than any that were tried, which they then are as well.
pub(super) fn untried(mut objects: Vec<Sighting>, tried: &mut Vec<Boxes>) -> Vec<Sighting> {
    objects.retain(|object| {
        let is_new = !tried.iter().any(|boxes| same(boxes, &object.boxes));
        if is_new {
            tried.push(object.boxes.clone());
        }
        is_new
    });
    objects
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
    (!same(&boxes, &object.boxes)).then(|| Sighting {
        boxes,
        ..object.clone()
    })
}

/// Whether boxes in all views show about the same.
fn same(a: &[Option<BBox>], b: &[Option<BBox>]) -> bool {
    a.iter().zip(b).all(|pair| match pair {
        (Some(a), Some(b)) => a.iou(b) > SAME,
        (a, b) => a.is_none() && b.is_none(),
    })
}
