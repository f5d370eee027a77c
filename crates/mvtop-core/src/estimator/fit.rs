//! The pose on which the object coordinates of all views agree.
//!
//! Where the bundle's network says which place of the object each cell of a close-up shows, a pose
//! is one at which these places lie on their lines of sight, in all views at once (a generalised
//! perspective-n-point problem). Many cells are wrong: they show something else, or a side that the
//! network takes for another. So the pose is searched for from all around, and cells lose their
//! weight as they disagree with it (iteratively reweighted least squares, Geman-McClure).

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Quaternion, UnitQuaternion, Vector3, Vector6};
use rayon::prelude::*;

use self::cells::{Evidence, Seen};
use self::position::position;
use super::hypotheses::{self, NEAR_DEG};
use super::picture::{Group, Picture, Pictures, cell_at};
use super::pose::{DecodedPose, FARTHEST};
use crate::bundle::{Bundle, SurfacePoint};
use crate::prediction::{Hypothesis, Sigma};

mod cells;
mod position;

/// Rotations from which a pose is searched for: neighbours are about 50 degrees apart.
const STARTS: usize = 64;
/// Cells that the search looks at; the best poses are then settled on all.
const SEARCHED: usize = 192;
/// Poses of the search that are settled, all turned otherwise.
const SETTLED: usize = 5;
/// How much less of the cells agree with a pose that is a third as probable.
const AS_GOOD: f64 = 0.1;
/// How far off a place may be to keep a quarter of its weight, in diameters, step by step: first by
/// turning and shifting the places onto their lines of sight, then by Gauss-Newton.
const COARSE: [f64; 6] = [0.3, 0.25, 0.2, 0.15, 0.12, 0.1];
const MIDDLE: [f64; 2] = [0.1, 0.08];
const FINE: [f64; 8] = [0.08, 0.07, 0.06, 0.06, 0.05, 0.05, 0.05, 0.05];
/// Fewest cells that settle a pose.
const FEWEST: usize = 12;
/// A pose that is so many times nearer or farther than where the object is about, is of things that
/// are no such object: one view leaves the distance open.
const FARTHER: f64 = 3.0;
/// Neighbouring cells err alike: as many count as one when the error is estimated.
const ALIKE: f64 = 50.0;

/// The poses, settled by the object coordinates where there are some.
///
/// - `poses`: of each object, by its index
pub fn settled(
    bundle: &Bundle,
    pictures: &Pictures,
    groups: &[Group],
    mut poses: Vec<DecodedPose>,
) -> Vec<DecodedPose> {
    let Some(coordinates) = &pictures.coordinates else {
        return poses;
    };
    for group in groups {
        for query in &group.objects {
            let class = &bundle.classes[query.class];
            let pose = &mut poses[query.object];
            let Some(extent) = class.coordinates_extent_m else {
                continue;
            };
            let (codes, symmetry) = (coordinates.view(), &class.symmetry);
            let mut evidence =
                Evidence::new(pictures, codes, group, extent, symmetry, class.diameter_m);
            if let Some(found) = fit(&mut evidence, &pose.world_from_obj) {
                *pose = found;
            }
            let (list, columns) = (&pictures.list[group.pictures.clone()], codes.dim().3);
            let now = &pose.world_from_obj;
            pose.support = Some(support(&evidence, list, columns, &class.points, now));
        }
    }
    poses
}

/// The pose that most cells agree with, and those that others do; `None` where too few do.
///
/// - `start`: a guess, which is tried as well
fn fit(evidence: &mut Evidence, start: &Isometry3<f64>) -> Option<DecodedPose> {
    if evidence.cells.len() < FEWEST {
        return None;
    }
    let position = position(evidence)?;
    for one in &mut evidence.cells {
        one.distance = (position - one.origin.coords).norm();
    }
    if !(evidence.cells.iter()).all(|one| one.distance < FARTHEST * evidence.diameter) {
        return None; // nor where it is not finite
    }
    let (all, some) = (&*evidence, evidence.thinned(SEARCHED));
    let diameter = all.diameter;
    let rotations = (0..STARTS).map(|n| spread_rotation(n, STARTS));
    let there = rotations
        .chain([start.rotation])
        .map(|rotation| Isometry3::from_parts(position.into(), rotation));
    let starts: Vec<Isometry3<f64>> = there.chain([*start]).collect();
    let mut found: Vec<(f64, Isometry3<f64>)> = starts
        .into_par_iter()
        .filter_map(|mut pose| {
            for scale in COARSE {
                pose = aligned(&some, &pose, scale * diameter)?;
            }
            for scale in MIDDLE {
                pose = stepped(&some, &pose, scale * diameter)?.0;
            }
            Some((agreement(&some, &pose, FINE[0] * diameter), pose))
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut apart: Vec<Isometry3<f64>> = Vec::new();
    for (_, pose) in found {
        let near = |other: &Isometry3<f64>| {
            let alike = all.symmetry.nearest(other, &pose, diameter);
            pose.rotation.angle_to(&alike.rotation).to_degrees() < NEAR_DEG
        };
        if apart.len() < SETTLED && !apart.iter().any(near) {
            apart.push(pose);
        }
    }
    let last = FINE[FINE.len() - 1] * diameter;
    let settled = apart.into_par_iter().filter_map(|mut pose| {
        let mut information = Matrix6::zeros();
        for scale in FINE {
            (pose, information) = stepped(all, &pose, scale * diameter)?;
        }
        let turns = all.turns(&pose);
        let in_front = all.cells.iter().all(|one| {
            let place = pose * Evidence::place(&turns, one);
            (place - one.origin).dot(&one.direction) > 0.0
        });
        let near = all.cells.iter().all(|one| {
            let away = (pose.translation.vector - one.origin.coords).norm() / one.distance;
            (1.0 / FARTHER..FARTHER).contains(&away)
        });
        (in_front && near).then_some(Hypothesis {
            world_from_obj: all.symmetry.canonical(&pose),
            sigma: expected(all, &pose, &information, last)?,
            probability: (agreement(all, &pose, last) / AS_GOOD).exp(),
        })
    });
    let settled: Vec<Hypothesis> = settled.collect();
    (!settled.is_empty()).then(|| hypotheses::likeliest(settled, all.symmetry, diameter))
}

/// What a pose leaves over of one cell: how far the place is beside its line of sight as seen from
/// the camera, at the object's distance, metres; and the change of that by the place's position.
///
/// - `place`: the cell's, object frame
fn left_over(
    seen: &Seen,
    place: &Point3<f64>,
    pose: &Isometry3<f64>,
) -> (Vector3<f64>, Matrix3<f64>) {
    let Seen {
        direction,
        distance,
        ..
    } = seen;
    let offset = pose * place - seen.origin;
    // Not behind the camera, whatever the search tries.
    let depth = offset.dot(direction).max(0.05 * distance);
    let beside = offset / depth - direction;
    let change = Matrix3::identity() - (direction + beside) * direction.transpose();
    (beside * *distance, change * (distance / depth))
}

/// Weight of a cell that leaves this over.
fn weight(seen: &Seen, left: &Vector3<f64>, scale: f64) -> f64 {
    seen.weight / (1.0 + left.norm_squared() / (scale * scale)).powi(2)
}

/// Share of what can be trusted that agrees with a pose, 0 to 1.
fn agreement(evidence: &Evidence, pose: &Isometry3<f64>, scale: f64) -> f64 {
    let turns = evidence.turns(pose);
    let agrees = evidence
        .cells
        .iter()
        .map(|one| agrees(one, &turns, pose, scale));
    agrees.sum::<f64>() / evidence.cells.iter().map(|one| one.weight).sum::<f64>()
}

/// How far a cell can be trusted and agrees with a pose, 0 to 1.
fn agrees(seen: &Seen, turns: &[Isometry3<f64>], pose: &Isometry3<f64>, scale: f64) -> f64 {
    let (left, _) = left_over(seen, &Evidence::place(turns, seen), pose);
    seen.weight / (1.0 + left.norm_squared() / (scale * scale))
}

/// Of what the object would cover at this pose in the views that have a picture of it, the share
/// that can be trusted and agrees: what is hidden lowers it, and what is no such object at all.
///
/// - `pictures`: of the evidence's views
/// - `columns`: cells of a row
fn support(
    evidence: &Evidence,
    pictures: &[Picture],
    columns: usize,
    points: &[SurfacePoint],
    pose: &Isometry3<f64>,
) -> f64 {
    let (turns, scale) = (
        evidence.turns(pose),
        FINE[FINE.len() - 1] * evidence.diameter,
    );
    let mut agreeing = vec![0.0; pictures.len() * columns * columns];
    for one in &evidence.cells {
        agreeing[one.view * columns * columns + one.cell] = agrees(one, &turns, pose, scale);
    }
    let of_view = |(picture, agreeing): (&Picture, &[f64])| {
        let cam_from_obj = picture.camera.world_from_cam().inv_mul(pose);
        let mut covered = vec![false; agreeing.len()];
        for point in points {
            let in_cam = cam_from_obj * Point3::from(point.position);
            let Some(pixel) = picture.camera.intrinsics().project(&in_cam) else {
                continue;
            };
            let cell = |pixel| cell_at(pixel, columns, picture.camera.width());
            if let (Some(column), Some(row)) = (cell(pixel.x), cell(pixel.y)) {
                covered[row * columns + column] = true;
            }
        }
        let of = |(covered, agrees): (&bool, &f64)| covered.then_some(*agrees);
        let count = covered.iter().filter(|covered| **covered).count().max(1);
        covered.iter().zip(agreeing).filter_map(of).sum::<f64>() / count as f64
    };
    let views = pictures.iter().zip(agreeing.chunks(columns * columns));
    views.map(of_view).sum::<f64>() / pictures.len() as f64
}

/// A place, and where it should be.
struct Pair {
    weight: f64,
    /// Object frame.
    place: Point3<f64>,
    /// The point of its line of sight that is nearest to where a pose puts it, world frame.
    on_line: Point3<f64>,
}

impl Pair {
    fn new(seen: &Seen, place: Point3<f64>, pose: &Isometry3<f64>, scale: f64) -> Self {
        let now = pose * place;
        let on_line = seen.origin + seen.direction * (now - seen.origin).dot(&seen.direction);
        Self {
            weight: weight(seen, &(now - on_line), scale),
            place,
            on_line,
        }
    }
}

/// The pose turned and shifted so that the places come nearest to where they are now beside them on
/// their lines of sight (Kabsch 1976, weighted).
fn aligned(evidence: &Evidence, pose: &Isometry3<f64>, scale: f64) -> Option<Isometry3<f64>> {
    let turns = evidence.turns(pose);
    let pair = |one: &Seen| Pair::new(one, Evidence::place(&turns, one), pose, scale);
    let pairs: Vec<Pair> = evidence.cells.iter().map(pair).collect();
    let total: f64 = pairs.iter().map(|pair| pair.weight).sum();
    let mean = |of: fn(&Pair) -> Point3<f64>| {
        let sum: Vector3<f64> = pairs.iter().map(|pair| of(pair).coords * pair.weight).sum();
        sum / total
    };
    let (from, to) = (mean(|pair| pair.place), mean(|pair| pair.on_line));
    let product = |pair: &Pair| {
        (pair.on_line.coords - to) * (pair.place.coords - from).transpose() * pair.weight
    };
    let between: Matrix3<f64> = pairs.iter().map(product).sum();
    let svd = between.try_svd(true, true, f64::EPSILON, 100)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mirrored = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirrored)) * v_t;
    let rotation = UnitQuaternion::from_matrix(&rotation);
    let translation = to - rotation * from;
    finite(Isometry3::from_parts(translation.into(), rotation))
}

/// The pose after a step of Gauss-Newton, and the information (inverse covariance, for errors of a
/// metre) about its rotation in its own frame, rad, and its position, m.
fn stepped(
    evidence: &Evidence,
    pose: &Isometry3<f64>,
    scale: f64,
) -> Option<(Isometry3<f64>, Matrix6<f64>)> {
    let turns = evidence.turns(pose);
    let rotation = pose.rotation.to_rotation_matrix();
    let (mut information, mut slope) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros());
    for one in &evidence.cells {
        let place = Evidence::place(&turns, one);
        let (left, change) = left_over(one, &place, pose);
        let weight = weight(one, &left, scale);
        let by_turn = -change * rotation.matrix() * place.coords.cross_matrix();
        let mut by_pose = nalgebra::Matrix3x6::<f64>::zeros();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&by_turn);
        by_pose.fixed_columns_mut::<3>(3).copy_from(&change);
        information += by_pose.transpose() * by_pose * weight;
        slope += by_pose.transpose() * left * weight;
    }
    // A whiff of damping: one view may leave the distance all but open.
    let damped = information + Matrix6::identity() * (1e-9 * information.trace());
    let step = -damped.cholesky()?.solve(&slope);
    let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
    let moved = pose.translation.vector + step.fixed_rows::<3>(3);
    let pose = finite(Isometry3::from_parts(moved.into(), pose.rotation * turn))?;
    Some((pose, information))
}

/// How far off the pose may be, by what it leaves over.
fn expected(
    evidence: &Evidence,
    pose: &Isometry3<f64>,
    information: &Matrix6<f64>,
    scale: f64,
) -> Option<Sigma> {
    let turns = evidence.turns(pose);
    let (mut squares, mut total) = (0.0, 0.0);
    for one in &evidence.cells {
        let (left, _) = left_over(one, &Evidence::place(&turns, one), pose);
        let weight = weight(one, &left, scale);
        squares += weight * left.norm_squared();
        total += weight;
    }
    let covariance = information.try_inverse()? * (ALIKE * squares / total / 2.0);
    let turn = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let rotation = evidence.symmetry.covariance_of_errors(&turn).trace().sqrt();
    let position = (covariance.fixed_view::<3, 3>(3, 3).trace() / 3.0).sqrt();
    (rotation.is_finite() && position.is_finite()).then_some(Sigma {
        rot_deg: rotation.to_degrees().min(180.0),
        t_m: position,
    })
}

fn finite(pose: Isometry3<f64>) -> Option<Isometry3<f64>> {
    let finite = pose
        .translation
        .vector
        .iter()
        .chain(pose.rotation.coords.iter());
    finite.copied().all(f64::is_finite).then_some(pose)
}

/// Rotation `n` of `count` that cover all rotations evenly (super-Fibonacci spirals, Alexa 2022).
fn spread_rotation(n: usize, count: usize) -> UnitQuaternion<f64> {
    const PSI: f64 = 1.533_751_168_755_204_3;
    let s = n as f64 + 0.5;
    let t = s / count as f64;
    let d = std::f64::consts::TAU * s;
    let (r, big_r) = (t.sqrt(), (1.0 - t).sqrt());
    let (alpha, beta) = (d / std::f64::consts::SQRT_2, d / PSI);
    let (x, y) = (r * alpha.sin(), r * alpha.cos());
    let (z, w) = (big_r * beta.sin(), big_r * beta.cos());
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

#[cfg(test)]
mod tests;
