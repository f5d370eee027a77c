//! Where cameras stand by what their images show: objects of known size, seen by several of them.
//!
//! The edges of the objects' meshes are brought to where all images show them, by moving objects and
//! cameras at once (bundle adjustment). How large the meshes are is what says how far apart cameras
//! stand. A camera is expected to stand near where the rig says, and the edges of one object in one
//! view to err together, by as much as the views are found to contradict each other: so what comes out
//! has a standard deviation that holds on images of which the meshes' colors are not exactly right.

mod adjust;
mod alone;
mod judge;

use nalgebra::{Isometry3, Matrix6, Vector3, Vector6};
use rayon::prelude::*;

pub use self::judge::{Correction, Off, PairResidual, Refined};

use self::adjust::{Adjusted, Object, Scene, Sighting, adjusted};
use self::alone::Alone;
use crate::estimator::{Estimator, PredictOptions};
use crate::image::{Pyramid, ViewImage};
use crate::refine::View;
use crate::refine::correspondence_lines::CorrespondenceLines;
use crate::{Error, Result, Rig};

/// Steps of the lines, px of the close-ups, one after the other.
const STEPS: [f64; 8] = [4.0, 3.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0];
/// A rig that explains no more than this share of the objects that two images show is contradicted;
/// another reading of it that explains more is believed.
const AGREE: f64 = 0.5;
/// How far edges may be off at a step, px for one of it.
const FROM_PX: f64 = 4.0;
/// How far a camera is expected to be off, standard deviations in each direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Of a turn about each axis, degrees.
    pub turn_deg: f64,
    /// Of a shift along each axis, metres.
    pub shift_m: f64,
}

/// What sets of images tell of a rig.
pub struct Observed {
    given: Rig,
    expected: Expected,
    sightings: Vec<Sighting>,
    /// Of each object.
    set_of: Vec<usize>,
    adjusted: Adjusted,
}

impl Default for Expected {
    fn default() -> Self {
        Self {
            turn_deg: 1.0,
            shift_m: 0.01,
        }
    }
}

impl Expected {
    /// Inverse variances of turns, radians, and shifts.
    fn information(&self) -> Vector6<f64> {
        let [turn, shift] = [self.turn_deg.to_radians(), self.shift_m].map(|sd| sd.powi(-2));
        Vector6::new(turn, turn, turn, shift, shift, shift)
    }

    /// Of a covariance, the least known directions.
    fn of(covariance: &Matrix6<f64>) -> Self {
        let most = |at: usize| {
            let block = covariance.fixed_view::<3, 3>(at, at).into_owned();
            block.symmetric_eigenvalues().max().sqrt()
        };
        Self {
            turn_deg: most(0).to_degrees(),
            shift_m: most(3),
        }
    }
}

fn cams_from_world(rig: &Rig) -> Vec<Isometry3<f64>> {
    let cameras = rig.cameras().iter();
    cameras.map(|c| c.world_from_cam().inverse()).collect()
}

/// Refuses a rig of which no image tells anything.
///
/// # Errors
/// [`Error::Input`] for one of a single camera.
pub fn comparable(rig: &Rig) -> Result<()> {
    match rig.cameras().len() {
        2.. => Ok(()),
        _ => Err(Error::Input(
            "rig: expected two cameras or more, got one, which nothing can be compared with".into(),
        )),
    }
}

/// What `sets` of images tell of a rig.
///
/// - `sets`: each of one moment, as for [`Estimator::predict`]; the cameras stand still over all
/// - `expected`: how far its cameras are expected to be off
///
/// # Errors
/// Those of [`Estimator::predict`]; [`Error::Input`] for a rig of one camera, a bundle without meshes, where
/// no two images show objects of a class, and where what they show contradicts the rig altogether.
pub fn observe(
    estimator: &Estimator,
    rig: &Rig,
    sets: &[Vec<ViewImage>],
    expected: Expected,
) -> Result<Observed> {
    comparable(rig)?;
    let refiners = estimator.refiners();
    if refiners.iter().all(Option::is_none) {
        return Err(Error::Input(format!(
            "model: expected a bundle whose classes have meshes, which say how large objects are; {} has \
             none; add them with `mvtop-train mesh`",
            estimator.bundle().dir.display()
        )));
    }
    let alone = alone::sightings(estimator, rig, sets)?;
    let shared = alone::shared(&alone);
    let by = |rig: &Rig| by_rig(estimator, rig, sets, &alone, expected);
    // Images that nothing can be made of were refused above: poses that cannot be are the rig's.
    let found = by(rig).ok().flatten();
    let agree = found.as_ref().map_or(0, Observed::agreeing);
    let enough = |agree: usize| agree as f64 > AGREE * shared as f64;
    if let Some(found) = found.filter(|_| enough(agree)) {
        return Ok(found);
    }
    if shared == 0 {
        return Err(Error::Input(
            "images: expected objects that two cameras see in one set of images, found none; give images of \
             more objects, where cameras share their view"
                .into(),
        ));
    }
    let flip = Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    let readings = [
        ("the other direction", true, Isometry3::identity()),
        ("OpenGL's axes (y up, z backward)", false, flip),
        ("the other direction and OpenGL's axes", true, flip),
    ];
    let fits = readings.iter().find(|(_, inverse, axes)| {
        let read = rig.moved(|_, camera| match inverse {
            true => camera.world_from_cam().inverse() * axes,
            false => camera.world_from_cam() * axes,
        });
        let found = read.ok().and_then(|rig| by(&rig).ok().flatten());
        found.is_some_and(|found| enough(found.agreeing()))
    });
    let hint = match fits {
        Some((name, ..)) => format!("the poses fit the images if read in {name}"),
        None => "check direction, axes and unit of the poses, and that each image is of its camera"
            .into(),
    };
    Err(Error::Input(format!(
        "the images contradict the rig: of {shared} objects that two images of a set show, {agree} are found \
         by the rig in both; {hint}"
    )))
}

/// What is seen by a rig that may be wrong; `None` where nothing is seen by two cameras.
fn by_rig(
    estimator: &Estimator,
    rig: &Rig,
    sets: &[Vec<ViewImage>],
    alone: &[Alone],
    expected: Expected,
) -> Result<Option<Observed>> {
    let refiners = estimator.refiners();
    let guess = alone::guess(estimator, rig, alone.to_vec(), &expected);
    let start = rig.moved(|index, _| guess[index].inverse())?;
    let mut scene = Scene {
        cams_from_world: guess,
        objects: Vec::new(),
        outwards: 0.0,
    };
    let (mut seen, mut set_of) = (Vec::new(), Vec::new());
    for (set, images) in sets.iter().enumerate() {
        let prediction = estimator.predict(&start, images, &PredictOptions::default())?;
        for object in prediction.objects {
            let class = estimator.bundle().class_index(&object.class);
            let Some(refiner) = class.and_then(|class| refiners[class].as_ref()) else {
                continue;
            };
            let mut views = Vec::new();
            for shown in object.cameras.iter().filter(|shown| shown.bbox.is_some()) {
                let Some(view) = images.iter().find(|view| view.camera == shown.camera) else {
                    continue;
                };
                let camera = &start.cameras()[shown.camera];
                let image = &Pyramid::new(&view.image);
                let lines = CorrespondenceLines::new(
                    refiner,
                    &View { camera, image },
                    &shown.cam_from_obj,
                )?;
                views.extend(lines.map(|lines| Seen {
                    camera: shown.camera,
                    object: scene.objects.len(),
                    lines,
                }));
            }
            if views.len() > 1 {
                seen.extend(views);
                set_of.push(set);
                scene.objects.push(Object {
                    world_from_obj: object.world_from_obj,
                    center: refiner.center(),
                });
            }
        }
    }
    let found = on_images(rig, &expected, scene, &mut seen);
    let found = found.filter(|(sightings, _)| !sightings.is_empty());
    Ok(found.map(|(sightings, adjusted)| Observed {
        given: rig.clone(),
        expected,
        sightings,
        set_of,
        adjusted,
    }))
}

/// Brings objects and cameras to where the edges are, from coarse to fine.
fn on_images(
    rig: &Rig,
    expected: &Expected,
    mut scene: Scene,
    seen: &mut [Seen],
) -> Option<(Vec<Sighting>, Adjusted)> {
    let given = cams_from_world(rig);
    let expected = vec![*expected; given.len()];
    let mut found = None;
    for step in STEPS {
        let look = |seen: &mut Seen| seen.look(&scene, step);
        let sightings: Vec<Sighting> = seen.par_iter_mut().filter_map(look).collect();
        let from_px = FROM_PX * step;
        let adjusted = adjusted(&given, &expected, scene, &sightings, from_px)?;
        scene = adjusted.scene.clone();
        found = Some((sightings, adjusted));
    }
    found
}

/// One object in one view, at work.
struct Seen<'a> {
    camera: usize,
    object: usize,
    lines: CorrespondenceLines<'a>,
}

impl Seen<'_> {
    fn look(&mut self, scene: &Scene, step: f64) -> Option<Sighting> {
        let world_from_obj = scene.objects[self.object].world_from_obj;
        let cam_from_obj = scene.cams_from_world[self.camera] * world_from_obj;
        let told = self.lines.measure(&cam_from_obj, step)?;
        Some(Sighting {
            camera: self.camera,
            object: self.object,
            cam_from_obj: told.cam_from_obj,
            edges: told.information,
        })
    }
}

#[cfg(test)]
mod tests;
