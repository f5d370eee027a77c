//! How cameras stand to each other by the poses that each image alone tells.

use nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, Vector3};

use crate::bundle::Class;
use crate::estimator::{Estimator, PredictOptions};
use crate::image::ViewImage;
use crate::pose::rotation_error_deg;
use crate::{Error, Result, Rig};

/// How far two cameras' places of an object may be apart to count a quarter, in diameters, and its
/// rotations, degrees: of poses of one view each.
const APART: f64 = 0.3;
const TURNED_DEG: f64 = 20.0;
/// A rig as it is given is kept where it fits nearly as well as the best that was found.
const AS_GIVEN: f64 = 0.8;
/// Rounds in which objects that disagree lose their weight.
const ROUNDS: usize = 6;

/// An object as one image alone shows it.
#[derive(Debug, Clone)]
pub struct Alone {
    pub set: usize,
    pub class: usize,
    pub diameter: f64,
    pub cam_from_obj: Isometry3<f64>,
    /// Middle of the object, camera frame.
    pub middle: Point3<f64>,
}

/// What each camera sees by itself, by camera.
pub fn sightings(
    estimator: &Estimator,
    rig: &Rig,
    sets: &[Vec<ViewImage>],
) -> Result<Vec<Vec<Alone>>> {
    let mut all = vec![Vec::new(); rig.cameras().len()];
    let classes = &estimator.bundle().classes;
    for (set, images) in sets.iter().enumerate() {
        for view in images {
            let Some(camera) = rig.cameras().get(view.camera) else {
                let count = rig.cameras().len();
                let problem = format!(
                    "camera {}: the rig has {count}, counted from 0",
                    view.camera
                );
                return Err(Error::Input(problem));
            };
            let by_itself = Rig::new(vec![camera.moved_to(Isometry3::identity())?], 0)?;
            let image = ViewImage {
                camera: 0,
                image: view.image.clone(),
            };
            let prediction = estimator.predict(&by_itself, &[image], &PredictOptions::default())?;
            for object in prediction.objects {
                let Some(class) = estimator.bundle().class_index(&object.class) else {
                    continue;
                };
                let pose = object.world_from_obj;
                all[view.camera].push(Alone {
                    set,
                    class,
                    diameter: classes[class].diameter_m,
                    cam_from_obj: pose,
                    middle: pose * middle(&classes[class]),
                });
            }
        }
    }
    Ok(all)
}

/// Middle of the class's points, object frame.
fn middle(class: &Class) -> Point3<f64> {
    let places = class
        .points
        .iter()
        .map(|point| Vector3::from(point.position));
    Point3::from(places.sum::<Vector3<f64>>() / class.points.len().max(1) as f64)
}

/// The rig as single images show it, from the reference camera on, and which of its cameras are linked
/// to that one by objects in common.
///
/// # Errors
/// [`Error::Camera`] for poses that are none.
pub fn rig(classes: &[Class], rig: &Rig, alone: &[Vec<Alone>]) -> Result<(Rig, Vec<bool>)> {
    let given: Vec<Isometry3<f64>> = rig.cameras().iter().map(|c| *c.world_from_cam()).collect();
    let (mut poses, mut linked) = (given.clone(), vec![false; given.len()]);
    linked[rig.reference()] = true;
    // Always the camera that is best linked to one whose place is known (Prim's spanning tree).
    loop {
        let mut best: Option<(f64, usize, Isometry3<f64>)> = None;
        for b in (0..given.len()).filter(|b| !linked[*b]) {
            for a in (0..given.len()).filter(|a| linked[*a]) {
                let guess = given[a].inv_mul(&given[b]);
                let Some((score, a_from_b)) = between(classes, &alone[a], &alone[b], &guess) else {
                    continue;
                };
                if best.is_none_or(|(most, ..)| score > most) {
                    best = Some((score, b, poses[a] * a_from_b));
                }
            }
        }
        let Some((_, b, world_from_b)) = best else {
            break;
        };
        (poses[b], linked[b]) = (world_from_b, true);
    }
    Ok((rig.moved(|index, _| poses[index])?, linked))
}

/// Where camera `b` stands as seen from `a`, and how much agrees with it; `None` where the two have
/// seen nothing in common.
fn between(
    classes: &[Class],
    a: &[Alone],
    b: &[Alone],
    guess: &Isometry3<f64>,
) -> Option<(f64, Isometry3<f64>)> {
    let same = |one: &Alone, other: &Alone| one.set == other.set && one.class == other.class;
    let mut best: Option<(f64, Isometry3<f64>)> = None;
    for one in a {
        for other in b.iter().filter(|other| same(one, other)) {
            // Of poses that look alike, those nearest to the guess, and single ones.
            let symmetry = &classes[one.class].symmetry;
            let guessed = guess.inv_mul(&one.cam_from_obj);
            let nearest = symmetry.nearest(&other.cam_from_obj, &guessed, one.diameter);
            let alike = symmetry.discrete.iter().map(|turn| nearest * turn);
            for cam_from_obj in alike.chain([nearest]) {
                let candidate = one.cam_from_obj * cam_from_obj.inverse();
                let score = agreement(classes, a, b, &candidate);
                if best.is_none_or(|(most, _)| score > most) {
                    best = Some((score, candidate));
                }
            }
        }
    }
    let (mut score, mut pose) = best?;
    let as_given = agreement(classes, a, b, guess);
    if as_given > AS_GIVEN * score {
        return Some((as_given, *guess));
    }
    for _ in 0..ROUNDS {
        let Some(next) = aligned(classes, a, b, &pose) else {
            break;
        };
        let agrees = agreement(classes, a, b, &next);
        if agrees <= score {
            break;
        }
        (score, pose) = (agrees, next);
    }
    Some((score, pose))
}

/// A pair of sightings of one object, by the pose between the cameras.
struct Pair<'a> {
    one: &'a Alone,
    other: &'a Alone,
    /// By the other sighting, of all poses that look alike the nearest, its camera's frame.
    cam_from_obj: Isometry3<f64>,
    by_place: f64,
    by_turn: f64,
}

fn pairs<'a>(
    classes: &'a [Class],
    a: &'a [Alone],
    b: &'a [Alone],
    a_from_b: &'a Isometry3<f64>,
) -> impl Iterator<Item = Pair<'a>> {
    a.iter().filter_map(move |one| {
        let alike = b.iter();
        let alike = alike.filter(|other| other.set == one.set && other.class == one.class);
        alike
            .map(|other| {
                let apart = (a_from_b * other.middle - one.middle).norm() / (APART * one.diameter);
                let symmetry = &classes[one.class].symmetry;
                let seen = a_from_b * other.cam_from_obj;
                let seen = symmetry.nearest(&seen, &one.cam_from_obj, one.diameter);
                let turned = rotation_error_deg(&seen.rotation, &one.cam_from_obj.rotation);
                Pair {
                    one,
                    other,
                    cam_from_obj: a_from_b.inv_mul(&seen),
                    by_place: (1.0 + apart * apart).powi(-2),
                    by_turn: (1.0 + (turned / TURNED_DEG).powi(2)).powi(-2),
                }
            })
            .max_by(|a, b| a.by_place.total_cmp(&b.by_place))
    })
}

/// How many objects agree, those whose rotation does so too counting twice.
fn agreement(classes: &[Class], a: &[Alone], b: &[Alone], a_from_b: &Isometry3<f64>) -> f64 {
    let pairs = pairs(classes, a, b, a_from_b);
    pairs.map(|pair| pair.by_place * (1.0 + pair.by_turn)).sum()
}

/// The pose that brings places and rotations together (Kabsch 1976, weighted).
fn aligned(
    classes: &[Class],
    a: &[Alone],
    b: &[Alone],
    a_from_b: &Isometry3<f64>,
) -> Option<Isometry3<f64>> {
    let pairs: Vec<Pair> = pairs(classes, a, b, a_from_b).collect();
    let place = |pair: &Pair| pair.by_place / (APART * pair.one.diameter).powi(2);
    let total: f64 = pairs.iter().map(place).sum();
    let mean = |of: fn(&Pair) -> Point3<f64>| {
        let sum: Vector3<f64> = pairs.iter().map(|p| of(p).coords * place(p)).sum();
        sum / total
    };
    let (to, from) = (mean(|pair| pair.one.middle), mean(|pair| pair.other.middle));
    let mut product = Matrix3::zeros();
    for pair in &pairs {
        let (one, other) = (pair.one.middle.coords - to, pair.other.middle.coords - from);
        product += one * other.transpose() * place(pair);
        let turn = pair.one.cam_from_obj.rotation * pair.cam_from_obj.rotation.inverse();
        let weight = pair.by_place * pair.by_turn / TURNED_DEG.to_radians().powi(2);
        product += turn.to_rotation_matrix().matrix() * (weight / 2.0);
    }
    let svd = product.try_svd(true, true, f64::EPSILON, 100)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mirrored = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirrored)) * v_t;
    let rotation = UnitQuaternion::from_matrix(&rotation);
    let pose = Isometry3::from_parts((to - rotation * from).into(), rotation);
    pose.translation
        .vector
        .iter()
        .all(|x| x.is_finite())
        .then_some(pose)
}
