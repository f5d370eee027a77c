//! A first guess of where everything is, by what each image alone shows.

use std::collections::BTreeMap;

use nalgebra::Isometry3;

use super::Expected;
use super::adjust::{Object, Scene, Sighting, adjusted};
use crate::estimator::{Estimator, PredictOptions};
use crate::image::{Pyramid, ViewImage};
use crate::refine::View;
use crate::refine::correspondence_lines::CorrespondenceLines;
use crate::{Error, Result, Rig};

/// How far single images may be off an object's distance, as a share of it.
const DISTANCE: f64 = 0.08;
/// How far cameras may be off in this guess, standard deviations.
const OFF: f64 = 5.0;
/// How far edges may be off where cameras are, px.
const FROM_PX: f64 = 100.0;

/// An object as one image alone shows it.
#[derive(Clone)]
pub struct Alone {
    set: usize,
    class: usize,
    sighting: Sighting,
}

/// How many objects two images of a set or more show, by their classes alone.
pub fn shared(alone: &[Alone]) -> usize {
    let mut counts: BTreeMap<(usize, usize), BTreeMap<usize, usize>> = BTreeMap::new();
    for one in alone {
        let of_class = counts.entry((one.set, one.class)).or_default();
        *of_class.entry(one.sighting.camera).or_default() += 1;
    }
    let second = |of_class: &BTreeMap<usize, usize>| {
        let mut counts: Vec<usize> = of_class.values().copied().collect();
        counts.sort_unstable();
        counts.iter().rev().nth(1).copied().unwrap_or(0)
    };
    counts.values().map(second).sum()
}

/// Where cameras stand by what each image alone shows: cam_from_world of each.
pub fn guess(
    estimator: &Estimator,
    rig: &Rig,
    mut alone: Vec<Alone>,
    expected: &Expected,
) -> Vec<Isometry3<f64>> {
    let given = super::cams_from_world(rig);
    let classes = &estimator.bundle().classes;
    let mut scene = Scene {
        cams_from_world: given.clone(),
        objects: Vec::new(),
        outwards: 0.0,
    };
    let mut grouped = Vec::new();
    while let Some(first) = alone.pop() {
        let world_from_cam = |one: &Alone| given[one.sighting.camera].inverse();
        let pose = world_from_cam(&first) * first.sighting.cam_from_obj;
        let class = &classes[first.class];
        let mut group = vec![first.sighting];
        for (camera, cam_from_world) in given.iter().enumerate() {
            let near = |one: &Alone| {
                let there = world_from_cam(one) * one.sighting.cam_from_obj;
                let distance = one.sighting.cam_from_obj.translation.vector.norm();
                let [turn, shift] = [expected.turn_deg.to_radians(), expected.shift_m];
                let most = OFF * (turn * distance + shift) + DISTANCE * distance;
                let apart = (there.translation.vector - pose.translation.vector).norm();
                (apart < most + class.diameter_m / 2.0).then_some(apart)
            };
            let same = alone.iter().enumerate().filter(|(_, one)| {
                let of_set = (one.set, one.class) == (first.set, first.class);
                of_set && one.sighting.camera == camera && group[0].camera != camera
            });
            let nearest = same.filter_map(|(i, one)| Some((i, near(one)?)));
            let nearest = nearest.min_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((index, _)) = nearest {
                let mut other = alone.swap_remove(index).sighting;
                // Of poses that look alike, the one meant.
                let meant = cam_from_world * pose;
                let symmetry = &class.symmetry;
                other.cam_from_obj =
                    symmetry.nearest(&other.cam_from_obj, &meant, class.diameter_m);
                group.push(other);
            }
        }
        let Some(refiner) = &estimator.refiners()[first.class] else {
            continue;
        };
        if group.len() < 2 {
            continue;
        }
        for one in &mut group {
            one.object = scene.objects.len();
        }
        scene.objects.push(Object {
            world_from_obj: pose,
            center: refiner.center(),
        });
        grouped.extend(group);
    }
    let expected = vec![*expected; given.len()];
    let found = adjusted(&given, &expected, scene, &grouped, FROM_PX);
    found.map_or(given, |found| found.scene.cams_from_world)
}

/// What each image by itself shows.
///
/// # Errors
/// Those of [`Estimator::predict`].
pub fn sightings(estimator: &Estimator, rig: &Rig, sets: &[Vec<ViewImage>]) -> Result<Vec<Alone>> {
    let mut all = Vec::new();
    for (set, images) in sets.iter().enumerate() {
        for view in images {
            let Some(camera) = rig.cameras().get(view.camera) else {
                let (index, count) = (view.camera, rig.cameras().len());
                return Err(Error::Input(format!(
                    "camera {index}: the rig has {count}, counted from 0"
                )));
            };
            let camera = camera.moved_to(Isometry3::identity())?;
            let by_itself = Rig::new(vec![camera.clone()], 0)?;
            let image = ViewImage {
                camera: 0,
                image: view.image.clone(),
            };
            let prediction = estimator.predict(&by_itself, &[image], &PredictOptions::default())?;
            for object in prediction.objects {
                let class = estimator.bundle().class_index(&object.class);
                let refiner = class.and_then(|class| estimator.refiners()[class].as_ref());
                let (Some(class), Some(refiner)) = (class, refiner) else {
                    continue;
                };
                let pose = object.world_from_obj;
                let shown = View {
                    camera: &camera,
                    image: &Pyramid::new(&view.image),
                };
                let Some(mut lines) = CorrespondenceLines::new(refiner, &shown, &pose)? else {
                    continue;
                };
                let Some(told) = lines.measure(&pose, 1.0) else {
                    continue;
                };
                all.push(Alone {
                    set,
                    class,
                    sighting: Sighting {
                        camera: view.camera,
                        object: 0,
                        cam_from_obj: pose,
                        edges: told.information,
                    },
                });
            }
        }
    }
    Ok(all)
}
