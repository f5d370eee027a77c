//! Bundle adjustment: objects and cameras are moved until the objects' edges lie where images show them.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector6,
};
use rayon::prelude::*;

use super::Found;
use crate::image::ViewImage;
use crate::prediction::Sigma;
use crate::refine::lines::Lines;
use crate::refine::solve::{ALIKE, ANGLE_PER_AXIS, KNOWN, Row};
use crate::refine::{Refiner, View};
use crate::{BBox, Result, Rig};

/// Steps of the lines, px of the close-ups, one after the other.
const STEPS: [f64; 14] = [
    4.0, 4.0, 4.0, 4.0, 3.0, 3.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0,
];
/// Rounds in which lines that disagree lose their weight.
const ROUNDS: usize = 4;
/// What is known of a camera beforehand: turn (rad) and place (m) about each axis.
const CAMERA: [f64; 2] = [0.1, 0.1];
/// What is known of an object's place beforehand, metres: next to nothing, as the rig may be wrong.
const PLACE: f64 = 0.1;
/// And of its turn at least, degrees.
const TURN_DEG: f64 = 3.0;

/// One object in one camera's image.
pub struct Sighting {
    camera: usize,
    lines: Lines,
}

/// Where everything is, and how far that is expected to be off.
pub struct Adjusted {
    /// world_from_cam of each camera.
    pub poses: Vec<Isometry3<f64>>,
    /// Of each camera but the reference and those that nothing links to it.
    pub sigmas: Vec<Option<Sigma>>,
    pub objects: Vec<Found>,
}

/// An object at work.
struct Object<'a> {
    refiner: &'a Refiner,
    sightings: Vec<Sighting>,
    found: Found,
    start: Isometry3<f64>,
    prior: Vector6<f64>,
}

/// What the lines of one sighting say of its pose in the camera's frame.
struct Told {
    camera: usize,
    information: Matrix6<f64>,
    pull: Vector6<f64>,
    /// Motion in the camera's frame by that of the object in the world, and by that of the world in
    /// the camera's frame.
    by_object: Matrix6<f64>,
    by_camera: Matrix6<f64>,
}

impl Sighting {
    /// Of an object in all views that have a box of it.
    ///
    /// # Errors
    /// Those of [`crate::Camera::moved_to`].
    pub fn all(
        refiner: &Refiner,
        rig: &Rig,
        images: &[ViewImage],
        boxes: &[(usize, BBox)],
        world_from_obj: &Isometry3<f64>,
    ) -> Result<Vec<Self>> {
        let mut all = Vec::new();
        for ViewImage { camera, image } in images {
            if !boxes.iter().any(|(index, _)| index == camera) {
                continue;
            }
            let index = *camera;
            let camera = &rig.cameras()[index];
            let cam_from_obj = camera.world_from_cam().inv_mul(world_from_obj);
            if let Some(lines) = Lines::new(refiner, &View { camera, image }, &cam_from_obj)? {
                all.push(Self {
                    camera: index,
                    lines,
                });
            }
        }
        Ok(all)
    }
}

/// - `linked`: cameras that may be moved; the reference camera is not
/// - `found`: objects with their sightings and what is expected of their poses
pub fn adjusted(
    refiners: &[Option<Refiner>],
    rig: &Rig,
    linked: &[bool],
    found: Vec<(Found, Vec<Sighting>, Sigma)>,
) -> Adjusted {
    let start: Vec<Isometry3<f64>> = rig
        .cameras()
        .iter()
        .map(|c| c.world_from_cam().inverse())
        .collect();
    let mut cams_from_world = start.clone();
    let mut objects: Vec<Object> = found
        .into_iter()
        .filter_map(|(found, sightings, sigma)| {
            let refiner = refiners[found.class].as_ref()?;
            let turn = (sigma.rot_deg.max(TURN_DEG) / ANGLE_PER_AXIS).to_radians();
            let (turn, shift) = (turn.powi(-2), PLACE.powi(-2));
            Some(Object {
                refiner,
                sightings,
                start: found.world_from_obj,
                found,
                prior: Vector6::new(turn, turn, turn, shift, shift, shift),
            })
        })
        .collect();
    // Place of each camera that moves in the system of equations.
    let mut places = vec![None; linked.len()];
    let moving = (0..linked.len()).filter(|&i| linked[i] && i != rig.reference());
    for (place, camera) in moving.enumerate() {
        places[camera] = Some(place);
    }
    let mut known = DMatrix::zeros(0, 0);
    for step in STEPS {
        let rows: Vec<Vec<Vec<Row>>> = objects
            .par_iter_mut()
            .map(|object| object.look(&cams_from_world, step))
            .collect();
        let Some((by_camera, by_object, information)) = stepped(
            &objects,
            &rows,
            &cams_from_world,
            &start,
            &places,
            1.0 + 1.5 * step,
        ) else {
            break;
        };
        for (camera, place) in places.iter().enumerate() {
            if let Some(place) = place {
                let motion = Vector6::from_column_slice(&by_camera.as_slice()[6 * place..][..6]);
                cams_from_world[camera] =
                    moved(&motion, &Point3::origin(), &cams_from_world[camera]);
            }
        }
        for (object, motion) in objects.iter_mut().zip(by_object) {
            let pose = &mut object.found.world_from_obj;
            *pose = moved(&motion, &(*pose * object.refiner.center()), pose);
        }
        known = information;
    }
    let covariance = known.cholesky().map(|known| known.inverse());
    let sigma = |place: &Option<usize>| {
        let block = covariance
            .as_ref()?
            .view((6 * (*place)?, 6 * (*place)?), (6, 6));
        let turns = block.fixed_view::<3, 3>(0, 0).into_owned();
        let shifts = block.fixed_view::<3, 3>(3, 3).trace();
        Some(Sigma {
            rot_deg: (turns.symmetric_eigenvalues().max().sqrt() * ANGLE_PER_AXIS).to_degrees(),
            t_m: (shifts / 3.0).sqrt(),
        })
    };
    Adjusted {
        poses: cams_from_world.iter().map(Isometry3::inverse).collect(),
        sigmas: places.iter().map(sigma).collect(),
        objects: objects.into_iter().map(|object| object.found).collect(),
    }
}

impl Object<'_> {
    /// The lines of each sighting.
    fn look(&mut self, cams_from_world: &[Isometry3<f64>], step: f64) -> Vec<Vec<Row>> {
        let look = |sighting: &mut Sighting| {
            let cam_from_obj = cams_from_world[sighting.camera] * self.found.world_from_obj;
            sighting
                .lines
                .look(self.refiner, &cam_from_obj, step)
                .to_vec()
        };
        self.sightings.iter_mut().map(look).collect()
    }

    /// The motion that leads back to where it was found.
    fn back(&self) -> Vector6<f64> {
        let (pose, center) = (&self.found.world_from_obj, self.refiner.center());
        between(&self.start, pose, &(self.start * center - pose * center))
    }
}

/// A turn and a shift.
fn between(
    to: &Isometry3<f64>,
    from: &Isometry3<f64>,
    shift: &nalgebra::Vector3<f64>,
) -> Vector6<f64> {
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// A pose after a turn about a point and a shift.
fn moved(motion: &Vector6<f64>, about: &Point3<f64>, pose: &Isometry3<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(motion.fixed_rows::<3>(0).into_owned());
    let shift = motion.fixed_rows::<3>(3).into_owned();
    let arm = turn * (pose.translation.vector - about.coords);
    let place = about.coords + arm + shift;
    Isometry3::from_parts(Translation3::from(place), turn * pose.rotation)
}

/// Motions of the cameras, one after the other, of the objects, and what is known of the cameras.
type Step = (DVector<f64>, Vec<Vector6<f64>>, DMatrix<f64>);

/// One step of Gauss-Newton (iteratively reweighted least squares, Geman-McClure); the objects are
/// taken out of the system (Schur's complement), as each is tied to the cameras alone.
///
/// - `rows`: by object and sighting
/// - `scale`: how far off a line may be to keep a quarter of its weight, px
fn stepped(
    objects: &[Object],
    rows: &[Vec<Vec<Row>>],
    cams_from_world: &[Isometry3<f64>],
    start: &[Isometry3<f64>],
    places: &[Option<usize>],
    scale: f64,
) -> Option<Step> {
    let size = 6 * places.iter().flatten().count();
    let mut by_camera = DVector::zeros(size);
    let mut by_object = vec![Vector6::zeros(); objects.len()];
    let mut information = DMatrix::zeros(size, size);
    for round in 0..ROUNDS {
        let at = |place: usize, motions: &DVector<f64>| {
            Vector6::from_column_slice(&motions.as_slice()[6 * place..][..6])
        };
        let mut system = DMatrix::zeros(size, size);
        let mut pull = DVector::zeros(size);
        let [turn, shift] = CAMERA.map(|sigma| sigma.powi(-2));
        let prior = Vector6::new(turn, turn, turn, shift, shift, shift);
        for (camera, place) in places.iter().enumerate() {
            let Some(place) = place else { continue };
            let (to, from) = (&start[camera], &cams_from_world[camera]);
            let origin = to.translation.vector
                - (to.rotation * from.rotation.inverse()) * from.translation.vector;
            let back = between(to, from, &origin);
            for i in 0..6 {
                system[(6 * place + i, 6 * place + i)] += prior[i];
                pull[6 * place + i] += prior[i] * back[i];
            }
        }
        // Of each object: what it knows of itself, and how it is tied to the cameras.
        let mut own = Vec::with_capacity(objects.len());
        for (index, object) in objects.iter().enumerate() {
            let told = object.told(&rows[index], cams_from_world, |camera, told| {
                let camera = places[camera].map_or(Vector6::zeros(), |place| at(place, &by_camera));
                match round {
                    0 => None,
                    _ => Some((
                        told.by_object * by_object[index] + told.by_camera * camera,
                        scale,
                    )),
                }
            });
            let mut block = Matrix6::from_diagonal(&object.prior);
            let mut right = object.prior.component_mul(&object.back());
            let mut ties: Vec<(usize, Matrix6<f64>)> = Vec::new();
            for one in &told {
                block += one.by_object.transpose() * one.information * one.by_object;
                right += one.by_object.transpose() * one.pull;
                let Some(place) = places[one.camera] else {
                    continue;
                };
                let of_camera = one.by_camera.transpose() * one.information;
                let mut view = system.fixed_view_mut::<6, 6>(6 * place, 6 * place);
                view += of_camera * one.by_camera;
                let mut view = pull.fixed_rows_mut::<6>(6 * place);
                view += one.by_camera.transpose() * one.pull;
                ties.push((place, of_camera * one.by_object));
            }
            let inverse = block.cholesky()?.inverse();
            for (a, tie) in &ties {
                let through = tie * inverse;
                let mut view = pull.fixed_rows_mut::<6>(6 * a);
                view -= through * right;
                for (b, other) in &ties {
                    let mut view = system.fixed_view_mut::<6, 6>(6 * a, 6 * b);
                    view -= through * other.transpose();
                }
            }
            own.push((inverse, right, ties));
        }
        by_camera = system.clone().cholesky()?.solve(&pull);
        for (motion, (inverse, right, ties)) in by_object.iter_mut().zip(own) {
            let tied: Vector6<f64> = ties
                .iter()
                .map(|(place, tie)| tie.transpose() * at(*place, &by_camera))
                .sum();
            *motion = inverse * (right - tied);
        }
        information = system * KNOWN;
    }
    let finite = by_camera
        .iter()
        .chain(by_object.iter().flatten())
        .all(|x| x.is_finite());
    finite.then_some((by_camera, by_object, information))
}

impl Object<'_> {
    /// What each sighting says, those that disagree with the others counting less.
    ///
    /// - `expected`: by camera, the motion that is expected in its frame and how far off a line may be
    ///   to keep a quarter of its weight, px; `None` where nothing is expected yet
    fn told(
        &self,
        rows: &[Vec<Row>],
        cams_from_world: &[Isometry3<f64>],
        expected: impl Fn(usize, &Told) -> Option<(Vector6<f64>, f64)>,
    ) -> Vec<Told> {
        let mut told = Vec::new();
        let mut kept = Vec::new();
        for (sighting, rows) in self.sightings.iter().zip(rows) {
            let cam_from_world = &cams_from_world[sighting.camera];
            let center = cam_from_world * (self.found.world_from_obj * self.refiner.center());
            let turn = *cam_from_world.rotation.to_rotation_matrix().matrix();
            let mut one = Told {
                camera: sighting.camera,
                information: Matrix6::zeros(),
                pull: Vector6::zeros(),
                by_object: Matrix6::zeros(),
                by_camera: Matrix6::identity(),
            };
            one.by_object.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
            one.by_object.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
            // What lies off the camera is shifted by its turn.
            let arm = -center.coords.cross_matrix();
            one.by_camera.fixed_view_mut::<3, 3>(3, 0).copy_from(&arm);
            let expected = expected(sighting.camera, &one);
            let (mut sum, mut all) = (0.0, 1e-9);
            for row in rows {
                let robust = expected.map_or(1.0, |(motion, scale)| {
                    let off = row.offset - row.by_pose.dot(&motion);
                    (1.0 + (off / scale).powi(2)).powi(-2)
                });
                let weight = robust / (row.variance * ALIKE);
                one.information += row.by_pose * row.by_pose.transpose() * weight;
                one.pull += row.by_pose * (row.offset * weight);
                sum += robust / row.variance;
                all += 1.0 / row.variance;
            }
            told.push(one);
            kept.push(sum / all);
        }
        let most = kept.iter().copied().fold(1e-9, f64::max);
        for (one, kept) in told.iter_mut().zip(kept) {
            let weight = (kept / most).powi(2);
            one.information *= weight;
            one.pull *= weight;
        }
        told
    }
}
