//! The poses of all objects, refined on the images.

use rayon::prelude::*;

use super::hypotheses;
use super::pose::DecodedPose;
use super::sightings::Sighting;
use super::view::View;
use crate::bundle::Bundle;
use crate::consistency::Sight;
use crate::consistency::alone::{Alone, Difference, differences};
use crate::prediction::{Hypothesis, Refinement};
use crate::refine::{self, Refiner};

/// How much worse the images fit a pose that is a third as probable, bits.
const AS_GOOD: f64 = 0.05;
/// How much less they look like its print (correlation).
const AS_PRINTED: f64 = 0.2;

/// Refines each pose on the views that have a box of the object; `None` where its class has no mesh
/// or its edges are nowhere to be seen.
///
/// Of an object's hypotheses each is refined, and the images tell which is right.
///
/// - `refiners`: of each class
pub fn on_images(
    refiners: &[Option<Refiner>],
    views: &[View],
    bundle: &Bundle,
    found: &mut [(Sighting, DecodedPose)],
) -> Vec<Option<Refinement>> {
    let refined = |(object, pose): &mut (Sighting, DecodedPose)| {
        let refiner = refiners[object.class].as_ref()?;
        let seen: Vec<refine::View> = views
            .iter()
            .zip(&object.boxes)
            .filter(|(_, bbox)| bbox.is_some())
            .map(|(view, _)| refine::View {
                camera: view.camera,
                image: view.image,
            })
            .collect();
        let class = &bundle.classes[object.class];
        let one = |hypothesis: &Hypothesis| {
            let refined = refiner.refine(&seen, &hypothesis.world_from_obj, hypothesis.sigma)?;
            let quality = &refined.quality;
            let printed = quality.print().unwrap_or(0.0) / AS_PRINTED;
            let fits = quality.explained() / AS_GOOD + printed;
            let symmetry = &class.symmetry;
            let hypothesis = Hypothesis {
                world_from_obj: match refined.accepted && !symmetry.is_none() {
                    true => symmetry.canonical(&refined.world_from_obj, class.diameter_m),
                    false => refined.world_from_obj,
                },
                sigma: refined.sigma,
                probability: hypothesis.probability * fits.exp(),
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
        let all: Vec<_> = pose.hypotheses.par_iter().filter_map(one).collect();
        let best = |(hypothesis, _): &&(Hypothesis, Refinement)| hypothesis.probability;
        let (_, refinement) = all.iter().max_by(|a, b| best(a).total_cmp(&best(b)))?;
        let refinement = *refinement;
        let found = all.into_iter().map(|(hypothesis, _)| hypothesis).collect();
        *pose = DecodedPose {
            support: pose.support,
            ..hypotheses::likeliest(found, &class.symmetry, class.diameter_m)
        };
        Some(refinement)
    };
    found.par_iter_mut().map(refined).collect()
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
