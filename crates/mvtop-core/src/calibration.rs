//! Where cameras stand by what their images show: objects of known size, seen by several of them.
//!
//! First each image by itself tells its objects' poses, whatever the rig says, and objects that two
//! cameras have in common tell how these stand to each other. Then all images of a set tell the poses
//! together, and the edges of the objects' meshes are brought to where the images show them, by moving
//! objects and cameras at once (bundle adjustment). The reference camera stays where it is; the size of
//! the meshes is what says how far apart cameras are.

mod adjust;
mod compare;
mod single;

use nalgebra::Isometry3;

pub use compare::{Comparison, Off, PairResidual, Reading};

use self::adjust::Sighting;
use crate::estimator::{Estimator, PredictOptions};
use crate::image::ViewImage;
use crate::prediction::Sigma;
use crate::{BBox, Error, Result, Rig};

/// A camera is not told where its turn (degrees) or place (metres) is less certain than this.
const UNTOLD: Sigma = Sigma {
    rot_deg: 2.0,
    t_m: 0.03,
};

/// An object that two or more cameras show.
#[derive(Debug, Clone)]
pub struct Found {
    /// Index of the class in the bundle.
    pub class: usize,
    /// Object frame to the world of [`Observed::rig`], metres.
    pub world_from_obj: Isometry3<f64>,
    /// Index of each camera that shows it, with its box, px.
    pub boxes: Vec<(usize, BBox)>,
}

/// What sets of images tell of a rig.
#[derive(Debug, Clone)]
pub struct Observed {
    /// The cameras as the images show them. The reference camera, and those that are not told, stand
    /// where they stood.
    pub rig: Rig,
    /// Of each camera, how far its pose is expected to be off to the reference's; `None` where the
    /// images do not tell it. Of the reference camera, nothing.
    pub sigmas: Vec<Option<Sigma>>,
    /// Objects that were seen by two or more cameras.
    pub objects: Vec<Found>,
}

/// What `sets` of images tell of a rig. Its poses are only a first guess and may be wrong altogether.
///
/// - `sets`: each of one moment, as for [`Estimator::predict`]; the cameras stand still over all
///
/// # Errors
/// Those of [`Estimator::predict`]; [`Error::Input`] for a bundle without meshes, and where fewer than
/// two cameras show an object of one class in any set.
pub fn observe(estimator: &Estimator, rig: &Rig, sets: &[Vec<ViewImage>]) -> Result<Observed> {
    let refiners = estimator.refiners();
    if refiners.iter().all(Option::is_none) {
        return Err(Error::Input(format!(
            "model: expected a bundle whose classes have meshes, which say how large objects are; {} has \
             none; add them with `python -m mvtop_train.export.mesh`",
            estimator.bundle().dir.display()
        )));
    }
    let alone = single::sightings(estimator, rig, sets)?;
    let (start, linked) = single::rig(&estimator.bundle().classes, rig, &alone)?;
    let mut found = Vec::new();
    for images in sets {
        let told: Vec<ViewImage> = images
            .iter()
            .filter(|view| linked[view.camera])
            .cloned()
            .collect();
        if told.len() < 2 {
            continue;
        }
        let prediction = estimator.predict(&start, &told, &PredictOptions::default())?;
        for object in prediction.objects {
            let boxes = object.cameras.iter();
            let boxes: Vec<(usize, BBox)> =
                boxes.filter_map(|c| Some((c.camera, c.bbox?))).collect();
            let class = estimator.bundle().class_index(&object.class);
            let (Some(class), true) = (class, boxes.len() > 1) else {
                continue;
            };
            let Some(refiner) = &refiners[class] else {
                continue;
            };
            let world_from_obj = object.world_from_obj;
            found.push((
                Found {
                    class,
                    world_from_obj,
                    boxes: boxes.clone(),
                },
                Sighting::all(refiner, &start, &told, &boxes, &world_from_obj)?,
                object.sigma,
            ));
        }
    }
    if found.is_empty() {
        return Err(Error::Input(
            "images: expected objects that two cameras see in one set of images, found none; give images of \
             more objects, where cameras share their view"
                .into(),
        ));
    }
    let adjusted = adjust::adjusted(refiners, &start, &linked, found);
    let told = |sigma: &Sigma| sigma.rot_deg < UNTOLD.rot_deg && sigma.t_m < UNTOLD.t_m;
    let sigmas: Vec<Option<Sigma>> = adjusted
        .sigmas
        .into_iter()
        .map(|s| s.filter(told))
        .collect();
    let place = |index: usize| match sigmas[index] {
        Some(_) => adjusted.poses[index],
        None => *rig.cameras()[index].world_from_cam(),
    };
    Ok(Observed {
        rig: rig.moved(|index, _| place(index))?,
        sigmas,
        objects: adjusted.objects,
    })
}

#[cfg(test)]
mod tests;
