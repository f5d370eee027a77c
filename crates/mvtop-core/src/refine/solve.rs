//! The step that brings the edges of all views to where they were found.

use nalgebra::{
    Isometry3, Matrix6, Point3, RowVector3, Translation3, UnitQuaternion, Vector2, Vector6,
};

use crate::prediction::Sigma;

/// Neighbouring lines err alike: as many count as one.
const ALIKE: f64 = 4.0;
/// And in what they do not say of themselves, such as a lens or a mesh that is a bit off: how much
/// less exact a pose is expected to be, as a share of its information.
const KNOWN: f64 = 0.25;
/// Mean of a rotation's angle over the standard deviation about each axis.
pub const ANGLE_PER_AXIS: f64 = 1.596;
/// Directions of which the images tell less than this share of what they tell of the best known one
/// are left as they were: about the axis of a round part, the corners of its mesh pretend to.
const UNTOLD: f64 = 0.002;
/// Rounds in which lines that disagree lose their weight.
const ROUNDS: usize = 4;

/// How the distance of an edge from where it was found changes with the pose.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// By a turn of the object about its center (radians) and a shift (metres), world frame; px.
    pub by_pose: Vector6<f64>,
    /// How far outwards it was found, px.
    pub offset: f64,
    /// Variance of that, px².
    pub variance: f64,
}

/// What is known of a pose before the images are looked at.
#[derive(Debug, Clone, Copy)]
pub struct Prior {
    pub world_from_obj: Isometry3<f64>,
    /// Inverse variances of turns and shifts.
    pub information: Vector6<f64>,
}

/// Turn and shift, and how exact they are.
pub struct Step {
    pub motion: Vector6<f64>,
    /// Inverse covariance, of the views and of what was known.
    pub information: Matrix6<f64>,
}

impl Prior {
    /// Of a pose and the errors that are expected of it.
    pub fn new(world_from_obj: Isometry3<f64>, sigma: Sigma) -> Self {
        let turn = (sigma.rot_deg.max(0.1) / ANGLE_PER_AXIS).to_radians();
        let (turn, shift) = (turn.powi(-2), sigma.t_m.max(1e-4).powi(-2));
        Self {
            world_from_obj,
            information: Vector6::new(turn, turn, turn, shift, shift, shift),
        }
    }

    /// The motion that leads back from a pose.
    fn back(&self, pose: &Isometry3<f64>, center: &Point3<f64>) -> Vector6<f64> {
        let turn = (self.world_from_obj.rotation * pose.rotation.inverse()).scaled_axis();
        let shift = self.world_from_obj * center - pose * center;
        Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
    }
}

/// How far a point of the object moves along a line in a close-up, by a motion of the object.
///
/// - `world_from_cam`: the close-up's
/// - `focal`: px
/// - `point`: close-up's frame, metres
/// - `normal`: of the line, px
/// - `center`: about which the object turns, world frame
pub fn by_pose(
    world_from_cam: &Isometry3<f64>,
    focal: f64,
    point: &Point3<f64>,
    normal: &Vector2<f64>,
    center: &Point3<f64>,
) -> Vector6<f64> {
    let (x, y) = (point.x / point.z, point.y / point.z);
    let by_point = RowVector3::new(normal.x, normal.y, -(normal.x * x + normal.y * y));
    let by_point = by_point * (focal / point.z);
    // In the world.
    let shift = world_from_cam.rotation * by_point.transpose();
    let arm = world_from_cam * point - center;
    let turn = arm.cross(&shift);
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// The pose after a motion.
///
/// - `center`: about which the object turns, its own frame
pub fn moved(pose: &Isometry3<f64>, center: &Point3<f64>, motion: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(motion.fixed_rows::<3>(0).into_owned());
    let place = pose * center;
    let rotation = turn * pose.rotation;
    let shifted = place + motion.fixed_rows::<3>(3).into_owned();
    Isometry3::from_parts(Translation3::from(shifted - rotation * center), rotation)
}

/// The motion that the views agree on (iteratively reweighted least squares, Geman-McClure).
///
/// - `rows`: of each view
/// - `radius`: what weighs turns against shifts, metres
/// - `scale`: how far off a line may be to keep a quarter of its weight, px
pub fn step(
    rows: &[&[Row]],
    prior: &Prior,
    pose: &Isometry3<f64>,
    center: &Point3<f64>,
    radius: f64,
    scale: f64,
) -> Option<Step> {
    let back = prior.back(pose, center);
    let known = Matrix6::from_diagonal(&prior.information);
    let mut motion = Vector6::zeros();
    let mut seen = Matrix6::zeros();
    // What each view counts: less where it disagrees with the others.
    let mut weights = vec![1.0; rows.len()];
    for round in 0..ROUNDS {
        seen.fill(0.0);
        let mut pull = Vector6::zeros();
        let mut kept = vec![0.0; rows.len()];
        for ((view, weight), kept) in rows.iter().zip(&weights).zip(&mut kept) {
            let (mut sum, mut all) = (0.0, 0.0);
            for row in *view {
                let off = row.offset - row.by_pose.dot(&motion);
                let certain = 1.0 / row.variance;
                let robust = match round {
                    0 => 1.0,
                    _ => (1.0 + (off / scale).powi(2)).powi(-2),
                };
                sum += robust * certain;
                all += certain;
                let counts = weight * robust * certain / ALIKE;
                seen += row.by_pose * row.by_pose.transpose() * counts;
                pull += row.by_pose * (row.offset * counts);
            }
            *kept = if all > 0.0 { sum / all } else { 0.0 };
        }
        let told = told(&seen, radius)?;
        seen = told * seen * told.transpose();
        pull = told * pull + prior.information.component_mul(&back);
        motion = (seen + known).cholesky()?.solve(&pull);
        let most = kept.iter().copied().fold(1e-9, f64::max);
        for (weight, kept) in weights.iter_mut().zip(&kept) {
            *weight = (kept / most).powi(2);
        }
    }
    motion.iter().all(|x| x.is_finite()).then_some(Step {
        motion,
        information: seen * KNOWN + known,
    })
}

/// What takes away the directions of a motion that the images do not tell.
///
/// - `seen`: what they tell, an inverse covariance
pub fn told(seen: &Matrix6<f64>, radius: f64) -> Option<Matrix6<f64>> {
    // Turns as the way that points at the radius make.
    let unit = Vector6::new(radius, radius, radius, 1.0, 1.0, 1.0);
    let (by_way, by_turn) = (
        Matrix6::from_diagonal(&unit.map(f64::recip)),
        Matrix6::from_diagonal(&unit),
    );
    let scaled = by_way * seen * by_way;
    if !scaled.iter().all(|x| x.is_finite()) {
        return None;
    }
    let eigen = scaled.symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let mut kept = Matrix6::zeros();
    for (value, vector) in eigen
        .eigenvalues
        .iter()
        .zip(eigen.eigenvectors.column_iter())
    {
        if *value > UNTOLD * most {
            kept += vector * vector.transpose();
        }
    }
    Some(by_turn * kept * by_way)
}
