//! One robust Gauss-Newton step on the displacements of all correspondence lines.

use nalgebra::{
    Isometry3, Matrix6, Point3, RowVector3, Translation3, UnitQuaternion, Vector2, Vector6,
};

use super::Refiner;
use super::edge_search::EdgeMatch;
use crate::prediction::Sigma;

/// Mean of a rotation's angle over the standard deviation about each axis, sqrt(8 / pi).
pub const ANGLE_PER_AXIS: f64 = 1.596;
/// Rounds of iteratively reweighted least squares.
const ROUNDS: usize = 4;

/// Residual of one correspondence line.
#[derive(Debug, Clone, Copy)]
pub struct Residual {
    /// Derivative of the edge's place along the line by a rotation of the object about its center
    /// (radians) and a translation (metres), world frame; px.
    pub jacobian: Vector6<f64>,
    pub edge: EdgeMatch,
}

/// Gaussian prior of a pose.
#[derive(Debug, Clone, Copy)]
pub struct Prior {
    world_from_obj: Isometry3<f64>,
    /// Inverse variances of rotation and translation.
    information: Vector6<f64>,
}

/// Result of a Gauss-Newton step.
pub struct Step {
    /// Rotation vector (radians) and translation (metres), world frame.
    pub motion: Vector6<f64>,
    /// Pose after the motion.
    pub world_from_obj: Isometry3<f64>,
    /// How far it moves the edges along their lines, mean, px.
    pub moved_px: f64,
    /// Inverse covariance by the views and the prior.
    pub information: Matrix6<f64>,
}

impl Prior {
    pub fn new(world_from_obj: Isometry3<f64>, sigma: Sigma) -> Self {
        let turn = (sigma.rot_deg.max(0.1) / ANGLE_PER_AXIS).to_radians();
        let (turn, shift) = (turn.powi(-2), sigma.t_m.max(1e-4).powi(-2));
        Self {
            world_from_obj,
            information: Vector6::new(turn, turn, turn, shift, shift, shift),
        }
    }

    /// Motion from a pose back to the mean.
    fn back(&self, pose: &Isometry3<f64>, center: &Point3<f64>) -> Vector6<f64> {
        let turn = (self.world_from_obj.rotation * pose.rotation.inverse()).scaled_axis();
        let shift = self.world_from_obj * center - pose * center;
        Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
    }
}

impl Refiner {
    /// Distance from the center at which a rotation weighs as much as a translation, metres.
    fn lever_m(&self) -> f64 {
        self.diameter / 4.0
    }

    /// Motion on which the views agree (iteratively reweighted least squares, Geman-McClure).
    ///
    /// - `residuals`: those of each view
    /// - `step`: px between the samples of the lines
    pub(super) fn gauss_newton(
        &self,
        residuals: &[&[Residual]],
        prior: &Prior,
        pose: &Isometry3<f64>,
        step: f64,
    ) -> Option<Step> {
        let (center, config) = (&self.mesh.center, &self.config);
        let (back, scale) = (prior.back(pose, center), robust_scale(step));
        let known = Matrix6::from_diagonal(&prior.information);
        let mut motion = Vector6::zeros();
        let mut hessian = Matrix6::zeros();
        // Weight of each view, smaller for a view that contradicts the others.
        let mut weights = vec![1.0; residuals.len()];
        for round in 0..ROUNDS {
            hessian.fill(0.0);
            let mut gradient = Vector6::zeros();
            let mut kept = vec![0.0; residuals.len()];
            for ((view, weight), kept) in residuals.iter().zip(&weights).zip(&mut kept) {
                let (mut sum, mut all) = (0.0, 0.0);
                for one in *view {
                    let certain = 1.0 / one.edge.variance;
                    let robust = if round == 0 {
                        1.0
                    } else {
                        one.robust_weight(&motion, scale)
                    };
                    sum += robust * certain;
                    all += certain;
                    let counts = weight * robust * certain / config.correlated_lines;
                    hessian += one.jacobian * one.jacobian.transpose() * counts;
                    gradient += one.jacobian * (one.edge.displacement * counts);
                }
                *kept = if all > 0.0 { sum / all } else { 0.0 };
            }
            let observable = self.observable_projector(&hessian)?;
            hessian = observable * hessian * observable.transpose();
            gradient = observable * gradient + prior.information.component_mul(&back);
            motion = (hessian + known).cholesky()?.solve(&gradient);
            let most = kept.iter().copied().fold(1e-9, f64::max);
            for (weight, kept) in weights.iter_mut().zip(&kept) {
                *weight = (kept / most).powi(2);
            }
        }
        let all = residuals.iter().copied().flatten();
        let count = all.clone().count().max(1) as f64;
        let moved_px = all.map(|one| one.jacobian.dot(&motion).abs()).sum::<f64>() / count;
        motion.iter().all(|x| x.is_finite()).then(|| Step {
            motion,
            moved_px,
            world_from_obj: moved(pose, center, &motion),
            information: hessian * config.information_deflation + known,
        })
    }

    /// Projector onto the motions that the images determine. The corners of a round part's mesh, for
    /// instance, pretend to determine the rotation about its axis.
    pub(super) fn observable_projector(&self, information: &Matrix6<f64>) -> Option<Matrix6<f64>> {
        // Rotations are scaled to the path of a point at the lever.
        let lever = self.lever_m();
        let unit = Vector6::new(lever, lever, lever, 1.0, 1.0, 1.0);
        let (by_way, by_turn) = (
            Matrix6::from_diagonal(&unit.map(f64::recip)),
            Matrix6::from_diagonal(&unit),
        );
        let scaled = by_way * information * by_way;
        if !scaled.iter().all(|x| x.is_finite()) {
            return None;
        }
        let eigen = scaled.symmetric_eigen();
        let least = self.config.observability_floor * eigen.eigenvalues.max();
        let pairs = eigen
            .eigenvalues
            .iter()
            .zip(eigen.eigenvectors.column_iter());
        let kept = pairs.filter(|(value, _)| **value > least);
        let projector = kept.fold(Matrix6::zeros(), |sum, (_, vector)| {
            sum + vector * vector.transpose()
        });
        Some(by_turn * projector * by_way)
    }
}

impl Residual {
    /// Geman-McClure weight after a motion.
    pub fn robust_weight(&self, motion: &Vector6<f64>, scale: f64) -> f64 {
        let off = self.edge.displacement - self.jacobian.dot(motion);
        (1.0 + (off / scale).powi(2)).powi(-2)
    }
}

/// Displacement at which a line keeps a quarter of its weight, px.
pub fn robust_scale(step: f64) -> f64 {
    1.0 + 1.5 * step
}

/// Derivative of a point's place along a line of a crop by a motion of the object.
///
/// - `world_from_cam`: the crop's camera
/// - `focal`: px
/// - `point`: crop's frame, metres
/// - `normal`: direction of the line, px
/// - `center`: center of rotation, world frame
pub fn jacobian(
    world_from_cam: &Isometry3<f64>,
    focal: f64,
    point: &Point3<f64>,
    normal: &Vector2<f64>,
    center: &Point3<f64>,
) -> Vector6<f64> {
    let (x, y) = (point.x / point.z, point.y / point.z);
    let by_point = RowVector3::new(normal.x, normal.y, -(normal.x * x + normal.y * y));
    let by_point = by_point * (focal / point.z);
    // World frame from here on.
    let shift = world_from_cam.rotation * by_point.transpose();
    let arm = world_from_cam * point - center;
    let turn = arm.cross(&shift);
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// Pose after a motion.
///
/// - `center`: center of rotation, object frame
pub fn moved(pose: &Isometry3<f64>, center: &Point3<f64>, motion: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(motion.fixed_rows::<3>(0).into_owned());
    let place = pose * center;
    let rotation = turn * pose.rotation;
    let shifted = place + motion.fixed_rows::<3>(3).into_owned();
    Isometry3::from_parts(Translation3::from(shifted - rotation * center), rotation)
}
