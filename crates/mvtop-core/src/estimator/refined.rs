//! The poses of all objects, refined on the images.

use rayon::prelude::*;

use super::pose::DecodedPose;
use super::sightings::Sighting;
use super::view::View;
use crate::bundle::Bundle;
use crate::consistency::Sight;
use crate::consistency::alone::{Alone, Difference, differences};
use crate::prediction::Refinement;
use crate::refine::{self, Refiner};

/// Refines each pose on the views that have a box of the object; `None` where its class has no mesh
/// or its edges are nowhere to be seen.
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
        let refined = refiner.refine(&seen, &pose.world_from_obj, pose.sigma)?;
        if refined.accepted {
            let class = &bundle.classes[object.class];
            let (symmetry, diameter) = (&class.symmetry, class.diameter_m);
            pose.world_from_obj = match symmetry.is_none() {
                true => refined.world_from_obj,
                false => symmetry.canonical(&refined.world_from_obj, diameter),
            };
            pose.sigma = refined.sigma;
        }
        Some(Refinement {
            accepted: refined.accepted,
            supported: refined.supported,
            residual_px: refined.residual_px,
        })
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
        let seen = views.iter().zip(&object.boxes);
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
        let (cameras, alone): (Vec<usize>, Vec<Alone>) = alone.unzip();
        let differences = differences(refiner, &alone, &pose.world_from_obj)?;
        Some(cameras.into_iter().zip(differences).collect())
    };
    let all = found.par_iter().map(|found| one(found).unwrap_or_default());
    all.collect()
}
