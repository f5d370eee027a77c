//! The poses on which the object coordinates of all views agree: a generalised PnP problem.
//!
//! The network says which point of the object each cell of a crop shows. A pose is right if these points
//! lie on the rays of their cells, in all views at once. Many are outliers: other things, or a side of
//! the object taken for another. So the search starts from rotations all around, and correspondences
//! lose weight with their residual (iteratively reweighted least squares, Geman-McClure).

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Quaternion, UnitQuaternion, Vector3, Vector6};
use rayon::prelude::*;

use self::position::position;
use super::grouping::distinct;
use crate::config::{InferenceConfig, PnpConfig};
use crate::prediction::{Hypothesis, Sigma};

/// Objects farther away, in diameters, are less than a pixel wide in any image.
pub const MAX_DIAMETERS: f64 = 1e4;

mod correspondences;
mod position;

pub use self::correspondences::{Correspondence, Correspondences};

/// The poses that most correspondences agree with, the most probable first, with probabilities up to a
/// factor; none where there are too few, or none of them can be.
pub fn solve(config: &InferenceConfig, all: &mut Correspondences) -> Vec<Hypothesis> {
    let InferenceConfig {
        pnp: config,
        search,
        ..
    } = config;
    let merge_deg = search.merge_deg;
    if all.list.len() < config.min_correspondences {
        return Vec::new();
    }
    let Some(position) = position(config, all) else {
        return Vec::new();
    };
    for one in &mut all.list {
        one.distance = (position - one.origin.coords).norm();
    }
    let ratio = config.max_distance_ratio;
    // Nor where the distance is not finite.
    if !(all.list.iter()).all(|one| one.distance < MAX_DIAMETERS * all.diameter) {
        return Vec::new();
    }
    let (all, some) = (&*all, all.thinned(config.search_correspondences));
    let diameter = all.diameter;
    let first_scale = config.newton_scales[0] * diameter;
    let mut found: Vec<(f64, Isometry3<f64>)> = (0..config.starts)
        .into_par_iter()
        .filter_map(|n| {
            let rotation = spread_rotation(n, config.starts);
            let mut pose = Isometry3::from_parts(position.into(), rotation);
            for scale in &config.align_scales {
                pose = aligned(&some, &pose, scale * diameter)?;
            }
            for scale in config.newton_scales.iter().take(2) {
                pose = stepped(&some, &pose, scale * diameter)?.0;
            }
            Some((inlier_share(&some, &pose, first_scale), pose))
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let last = config.inlier_scale() * diameter;
    let poses = found.into_iter().map(|(_, pose)| pose);
    let (symmetry, most) = (&all.symmetry, search.max_candidates);
    let starts = distinct(poses, |pose| *pose, symmetry, diameter, merge_deg, most);
    let solved = starts.into_par_iter().filter_map(|mut pose| {
        let mut information = Matrix6::zeros();
        for scale in config.newton_scales.iter().skip(2) {
            (pose, information) = stepped(all, &pose, scale * diameter)?;
        }
        let equivalents = all.equivalents(&pose);
        let in_front = all.list.iter().all(|one| {
            let point = pose * Correspondences::point(&equivalents, one);
            (point - one.origin).dot(&one.direction) > 0.0
        });
        let near = all.list.iter().all(|one| {
            let apart = (pose.translation.vector - one.origin.coords).norm() / one.distance;
            (1.0 / ratio..ratio).contains(&apart)
        });
        (in_front && near).then_some(Hypothesis {
            world_from_obj: all.symmetry.canonical(&pose),
            sigma: expected(config, all, &pose, &information, last)?,
            probability: (inlier_share(all, &pose, last) / config.temperature).exp(),
        })
    });
    let mut solved: Vec<Hypothesis> = solved.collect();
    solved.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let pose = |one: &Hypothesis| one.world_from_obj;
    distinct(solved, pose, symmetry, diameter, merge_deg, most)
}

impl PnpConfig {
    /// Residual of an inlier, in diameters.
    pub(super) fn inlier_scale(&self) -> f64 {
        self.newton_scales.last().copied().unwrap_or(0.05)
    }
}

/// The residual of a correspondence: how far its point is beside its ray as seen from the camera, at
/// the object's distance, metres; and its derivative by the point's position.
///
/// - `point`: object frame
fn residual(
    one: &Correspondence,
    point: &Point3<f64>,
    pose: &Isometry3<f64>,
) -> (Vector3<f64>, Matrix3<f64>) {
    let Correspondence {
        direction,
        distance,
        ..
    } = one;
    let offset = pose * point - one.origin;
    // Never behind the camera, whatever the search tries.
    let depth = offset.dot(direction).max(0.05 * distance);
    let beside = offset / depth - direction;
    let change = Matrix3::identity() - (direction + beside) * direction.transpose();
    (beside * *distance, change * (distance / depth))
}

/// Weight of a correspondence with a residual.
fn weight(one: &Correspondence, residual: &Vector3<f64>, scale: f64) -> f64 {
    one.weight / (1.0 + residual.norm_squared() / (scale * scale)).powi(2)
}

/// Share of the trusted correspondences that agree with a pose, 0 to 1.
fn inlier_share(all: &Correspondences, pose: &Isometry3<f64>, scale: f64) -> f64 {
    let equivalents = all.equivalents(pose);
    let inliers = all
        .list
        .iter()
        .map(|one| inlier(one, &equivalents, pose, scale));
    inliers.sum::<f64>() / all.list.iter().map(|one| one.weight).sum::<f64>()
}

/// How far a correspondence is an inlier of a pose, times its trust, 0 to 1.
fn inlier(
    one: &Correspondence,
    equivalents: &[Isometry3<f64>],
    pose: &Isometry3<f64>,
    scale: f64,
) -> f64 {
    let (left, _) = residual(one, &Correspondences::point(equivalents, one), pose);
    one.weight / (1.0 + left.norm_squared() / (scale * scale))
}

/// A correspondence's point, and the nearest point of its ray.
struct Pair {
    weight: f64,
    /// Object frame.
    point: Point3<f64>,
    /// World frame.
    on_ray: Point3<f64>,
}

impl Pair {
    fn new(one: &Correspondence, point: Point3<f64>, pose: &Isometry3<f64>, scale: f64) -> Self {
        let now = pose * point;
        let on_ray = one.origin + one.direction * (now - one.origin).dot(&one.direction);
        Self {
            weight: weight(one, &(now - on_ray), scale),
            point,
            on_ray,
        }
    }
}

/// The pose that brings the points nearest to where their rays pass them now (Kabsch 1976, weighted).
fn aligned(all: &Correspondences, pose: &Isometry3<f64>, scale: f64) -> Option<Isometry3<f64>> {
    let equivalents = all.equivalents(pose);
    let pair = |one: &Correspondence| {
        Pair::new(one, Correspondences::point(&equivalents, one), pose, scale)
    };
    let pairs: Vec<Pair> = all.list.iter().map(pair).collect();
    let total: f64 = pairs.iter().map(|pair| pair.weight).sum();
    let mean = |of: fn(&Pair) -> Point3<f64>| {
        let sum: Vector3<f64> = pairs.iter().map(|pair| of(pair).coords * pair.weight).sum();
        sum / total
    };
    let (from, to) = (mean(|pair| pair.point), mean(|pair| pair.on_ray));
    let product = |pair: &Pair| {
        (pair.on_ray.coords - to) * (pair.point.coords - from).transpose() * pair.weight
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

/// The pose after a step of Gauss-Newton, and its information (inverse covariance, for residuals of a
/// metre): of its rotation in its own frame, rad, and its position, m.
fn stepped(
    all: &Correspondences,
    pose: &Isometry3<f64>,
    scale: f64,
) -> Option<(Isometry3<f64>, Matrix6<f64>)> {
    let equivalents = all.equivalents(pose);
    let rotation = pose.rotation.to_rotation_matrix();
    let (mut information, mut slope) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros());
    for one in &all.list {
        let point = Correspondences::point(&equivalents, one);
        let (left, change) = residual(one, &point, pose);
        let weight = weight(one, &left, scale);
        let by_turn = -change * rotation.matrix() * point.coords.cross_matrix();
        let mut by_pose = nalgebra::Matrix3x6::<f64>::zeros();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&by_turn);
        by_pose.fixed_columns_mut::<3>(3).copy_from(&change);
        information += by_pose.transpose() * by_pose * weight;
        slope += by_pose.transpose() * left * weight;
    }
    // Damping: one view may leave the distance nearly undetermined.
    let damped = information + Matrix6::identity() * (1e-9 * information.trace());
    let step = -damped.cholesky()?.solve(&slope);
    let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
    let moved = pose.translation.vector + step.fixed_rows::<3>(3);
    let pose = finite(Isometry3::from_parts(moved.into(), pose.rotation * turn))?;
    Some((pose, information))
}

/// The expected error of a pose, by its residuals.
fn expected(
    config: &PnpConfig,
    all: &Correspondences,
    pose: &Isometry3<f64>,
    information: &Matrix6<f64>,
    scale: f64,
) -> Option<Sigma> {
    let equivalents = all.equivalents(pose);
    let (mut squares, mut total) = (0.0, 0.0);
    for one in &all.list {
        let (left, _) = residual(one, &Correspondences::point(&equivalents, one), pose);
        let weight = weight(one, &left, scale);
        squares += weight * left.norm_squared();
        total += weight;
    }
    let covariance = information.try_inverse()? * (config.correlated * squares / total / 2.0);
    let turn = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let rotation = all.symmetry.covariance_of_errors(&turn).trace().sqrt();
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

/// Rotation `n` of `count` of a set that covers all rotations evenly (super-Fibonacci spirals, Alexa 2022).
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
