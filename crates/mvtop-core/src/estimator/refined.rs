//! The poses of all objects, refined on the images.

use nalgebra::Isometry3;
use rayon::prelude::*;

use super::hypotheses;
use super::pose::DecodedPose;
use super::sightings::Sighting;
use super::view::View;
use crate::bundle::{Bundle, Class};
use crate::consistency::Sight;
use crate::consistency::alone::{Alone, Difference, differences};
use crate::prediction::{Hypothesis, Refinement, Sigma};
use crate::refine::{self, Refined, Refiner};

/// Share of its edges that the images show of an object that is seen well, and how well colors tell it
/// from what is next to it.
const SEEN_WELL: [f64; 2] = [0.9, 0.85];
/// How far the poses are turned that are looked at around one that is not, degrees.
const AROUND_DEG: f64 = 10.0;
/// So many of these are refined, at most.
const MOST_AROUND: usize = 3;
/// How probable each is beside the hypothesis that it is found around.
const BESIDE: f64 = 0.5;
/// How far they are expected to be off before they are refined, degrees; metres at least.
const OFF_DEG: f64 = 5.0;
const OFF_M: f64 = 0.002;

/// Refines each pose on the views that have a box of the object; `None` where its class has no mesh
/// or its edges are nowhere to be seen.
///
/// Of an object's hypotheses each is refined, and the images tell which is right. Where several
/// views show even that one badly, and no object coordinates have told poses from all around, others
/// around it are looked at.
///
/// - `refiners`: of each class
pub fn on_images(
    refiners: &[Option<Refiner>],
    views: &[View],
    bundle: &Bundle,
    found: &mut [(Sighting, DecodedPose)],
) -> Vec<Option<Refinement>> {
    let refined = |(object, pose): &mut (Sighting, DecodedPose)| {
        let seen = Seen {
            refiner: refiners[object.class].as_ref()?,
            class: &bundle.classes[object.class],
            views: views
                .iter()
                .zip(&object.boxes)
                .filter(|(_, bbox)| bbox.is_some())
                .map(|(view, _)| refine::View {
                    camera: view.camera,
                    image: view.image,
                })
                .collect(),
        };
        let mut all = seen.refined(&pose.hypotheses, Refiner::refine);
        let (first, refinement) = *best(&all)?;
        let shown = [refinement.supported, refinement.overlap];
        let badly = shown[0] < SEEN_WELL[0] || shown[1] < SEEN_WELL[1];
        // One view alone leaves too much open for images to choose by.
        if badly && pose.support.is_none() && seen.views.len() > 1 {
            let probability = pose.hypotheses.iter().map(|one| one.probability);
            let most = probability.fold(0.0, f64::max);
            let around = seen.around(&first, BESIDE * most);
            all.extend(seen.refined(&around, Refiner::refine_finely));
        }
        let (_, refinement) = *best(&all)?;
        let found = all.into_iter().map(|(hypothesis, _)| hypothesis).collect();
        let class = seen.class;
        *pose = DecodedPose {
            support: pose.support,
            ..hypotheses::likeliest(found, &class.symmetry, class.diameter_m)
        };
        Some(refinement)
    };
    found.par_iter_mut().map(refined).collect()
}

impl Refinement {
    /// As [`refine::Quality::score`].
    pub(super) fn score(&self) -> f64 {
        refine::score(self.explained, self.print, self.supported, self.overlap)
    }
}

/// [`Refiner::refine`], or what is like it.
type Refine = fn(&Refiner, &[refine::View], &Isometry3<f64>, Sigma) -> Option<Refined>;

/// An object, and the views that have a box of it.
struct Seen<'a> {
    refiner: &'a Refiner,
    class: &'a Class,
    views: Vec<refine::View<'a>>,
}

impl Seen<'_> {
    /// Each hypothesis as the images show it best, and as probable as they tell.
    fn refined(&self, hypotheses: &[Hypothesis], by: Refine) -> Vec<(Hypothesis, Refinement)> {
        let class = self.class;
        let one = |hypothesis: &Hypothesis| {
            let start = &hypothesis.world_from_obj;
            let refined = by(self.refiner, &self.views, start, hypothesis.sigma)?;
            let quality = &refined.quality;
            let hypothesis = Hypothesis {
                world_from_obj: match refined.accepted && !class.symmetry.is_none() {
                    true => (class.symmetry).canonical(&refined.world_from_obj, class.diameter_m),
                    false => refined.world_from_obj,
                },
                sigma: refined.sigma,
                probability: hypothesis.probability * quality.score().exp(),
            };
            let refinement = Refinement {
                accepted: refined.accepted,
                supported: refined.supported,
                residual_px: refined.residual_px,
                overlap: quality.overlap(),
                explained: quality.explained(),
                explained_least: quality.worst().map_or(0.0, |view| view.explained),
                print: quality.print(),
            };
            Some((hypothesis, refinement))
        };
        hypotheses.par_iter().filter_map(one).collect()
    }

    /// Those around one that the images show best.
    fn around(&self, hypothesis: &Hypothesis, probability: f64) -> Vec<Hypothesis> {
        let sigma = Sigma {
            rot_deg: OFF_DEG,
            t_m: hypothesis.sigma.t_m.max(OFF_M),
        };
        let center = &hypothesis.world_from_obj;
        let poses = self.refiner.around(&self.views, center, sigma, AROUND_DEG);
        let poses = poses.into_iter().take(MOST_AROUND);
        let one = |world_from_obj| Hypothesis {
            world_from_obj,
            sigma,
            probability,
        };
        poses.map(one).collect()
    }
}

/// The most probable.
fn best(all: &[(Hypothesis, Refinement)]) -> Option<&(Hypothesis, Refinement)> {
    let probability = |(hypothesis, _): &(Hypothesis, Refinement)| hypothesis.probability;
    all.iter()
        .max_by(|a, b| probability(a).total_cmp(&probability(b)))
}

/// How far the pose that each view tells by itself is from the one on which all agree best, by index
/// of the camera; empty for objects without a mesh, or with a box in fewer than two views.
pub fn by_view(
    refiners: &[Option<Refiner>],
    views: &[View],
    bundle: &Bundle,
    found: &[(Sighting, DecodedPose)],
) -> Vec<Vec<(usize, Difference)>> {
    let one = |(object, pose): &(Sighting, DecodedPose)| {
        let refiner = refiners[object.class].as_ref()?;
        let points = &bundle.classes[object.class].points;
        if object.views() < 2 {
            return None;
        }
        let seen = views.par_iter().zip(&object.boxes);
        let alone = seen.filter_map(|(view, bbox)| {
            let (camera, image) = (view.camera, view.image);
            let sight = Sight {
                camera,
                bbox: (*bbox)?,
            };
            let view = (view.index, refine::View { camera, image });
            let alone = Alone::of(refiner, &view.1, &sight, points, &pose.world_from_obj)?;
            Some((view.0, alone))
        });
        let alone: Vec<(usize, Alone)> = alone.collect();
        let (cameras, alone): (Vec<usize>, Vec<Alone>) = alone.into_iter().unzip();
        let differences = differences(refiner, &alone, &pose.world_from_obj)?;
        Some(cameras.into_iter().zip(differences).collect())
    };
    let all = found.par_iter().map(|found| one(found).unwrap_or_default());
    all.collect()
}
