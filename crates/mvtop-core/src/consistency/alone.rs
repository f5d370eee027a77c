//! What each view tells of an object by itself, and whether one pose can be all of that.
//!
//! A view's own pose is where its image alone shows the mesh's edges ([`crate::refine`]). Each tells
//! six numbers, of which an error of the calibration makes those of two views contradict each other:
//! lines of sight that miss each other, distances that do not belong to the size, and turns.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Rotation3, Vector3, Vector6};

use super::{Sight, agreement};
use crate::bundle::SurfacePoint;
use crate::config::RigConfig;
use crate::prediction::Sigma;
use crate::refine::{self, Refiner};

/// A pose as one view tells it.
#[derive(Debug, Clone)]
pub struct Alone {
    /// Object frame to world frame, metres.
    pub world_from_obj: Isometry3<f64>,
    /// Covariance of a turn about the object's center (radians) and a shift (metres), world frame.
    pub covariance: Matrix6<f64>,
    /// From the world to axes of which the third is the line of sight to the object.
    sight_from_world: Rotation3<f64>,
    /// How far away the object is, metres.
    distance: f64,
    /// Whether the image shows the edges; else the box is believed.
    by_edges: bool,
}

/// How a view's own pose differs from the one on which all agree best.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// In standard deviations.
    pub deviation: f64,
    /// Of the object's center across the line of sight, metres.
    pub across: f64,
    /// Along it, metres.
    pub along: f64,
    /// How far away the object is, metres.
    pub distance: f64,
    /// Radians.
    pub turn: f64,
    /// Whether the image shows the edges; else the view's box was believed, which ends where the
    /// object is hidden.
    pub by_edges: bool,
    /// What of these is most standard deviations.
    pub mostly: Kind,
    /// From the joint pose to the view's own: turn about the object's center (radians) and shift
    /// (metres), world frame.
    pub motion: Vector6<f64>,
    /// Covariance of the view's own pose, likewise.
    pub covariance: Matrix6<f64>,
    /// The object's center at the joint pose, world frame.
    pub center: Point3<f64>,
}

/// In what poses differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Across the line of sight.
    Across,
    /// In the distance, which the size tells.
    Along,
    /// In the rotation.
    Turn,
}

impl Alone {
    /// What a view tells, searched for from the pose that all views have, and from where that would
    /// fill this view's box; `None` where the lens does not image the whole object.
    ///
    /// - `points`: on the object's surface, object frame, metres
    /// - `world_from_obj`: the pose of all views
    pub fn of(
        config: &RigConfig,
        refiner: &Refiner,
        view: &refine::View,
        sight: &Sight,
        points: &[SurfacePoint],
        world_from_obj: &Isometry3<f64>,
    ) -> Option<Self> {
        let shift = agreement(points, &[*sight], world_from_obj, config.box_sigma)?.shift;
        let mut by_box = *world_from_obj;
        by_box.translation.vector += shift;
        let to_object = |pose: &Isometry3<f64>| {
            (pose * refiner.center()).coords - view.camera.world_from_cam().translation.vector
        };
        let distance = to_object(&by_box).norm();
        let sigma = Sigma {
            rot_deg: config.view_prior[0],
            t_m: config.view_prior[1] * distance,
        };
        // Where the box is where the pose has it, as exactly as boxes are, both searches would be one.
        let apart = shift.norm() > config.box_floor[0] * refiner.diameter_m();
        let starts: &[Isometry3<f64>] = match apart {
            true => &[*world_from_obj, by_box],
            false => &[*world_from_obj],
        };
        let enough = config.enough_contour_inliers;
        let best = refiner.refine_in_one_view(view, starts, sigma, enough);
        let best = best.filter(|found| found.contour_inliers > config.min_contour_inliers);
        let best = best.and_then(|best| Some((best.information.cholesky()?.inverse(), best)));
        let by_edges = best.is_some();
        let (pose, told, [across, along_share, turn]) = match best {
            Some((told, best)) => (
                best.world_from_obj,
                told * config.covariance_factor,
                config.contour_floor,
            ),
            None => (by_box, Matrix6::zeros(), config.box_floor),
        };
        let along = to_object(&pose);
        let up = match along.x.abs() < along.y.abs() {
            true => Vector3::x(),
            false => Vector3::y(),
        };
        let sight_from_world = Rotation3::look_at_rh(&-along, &up);
        let across = (across * refiner.diameter_m()).powi(2);
        let place = Vector3::new(across, across, (along_share * distance).powi(2));
        let axes = sight_from_world.matrix();
        let place = axes.transpose() * Matrix3::from_diagonal(&place) * axes;
        let mut covariance = told + Matrix6::from_diagonal_element(turn.powi(2));
        for (row, column) in (0..9).map(|i| (i / 3, i % 3)) {
            let by_turn = if row == column { turn.powi(2) } else { 0.0 };
            covariance[(3 + row, 3 + column)] += place[(row, column)] - by_turn;
        }
        Some(Self {
            world_from_obj: pose,
            covariance,
            sight_from_world,
            distance,
            by_edges,
        })
    }
}

/// How far each view's own pose is from the one on which they agree best; `None` of fewer than two.
///
/// - `refiner`: of the object
/// - `around`: a pose near all of them
pub fn differences(
    refiner: &Refiner,
    alone: &[Alone],
    around: &Isometry3<f64>,
) -> Option<Vec<Difference>> {
    if alone.len() < 2 {
        return None;
    }
    let center = refiner.center();
    let motion = |one: &Alone| {
        let turn = (one.world_from_obj.rotation * around.rotation.inverse()).scaled_axis();
        let shift = one.world_from_obj * center - around * center;
        Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
    };
    let (mut information, mut pull) = (Matrix6::zeros(), Vector6::zeros());
    let mut told = Vec::new();
    for one in alone {
        let (exact, motion) = (one.covariance.cholesky()?.inverse(), motion(one));
        information += exact;
        pull += exact * motion;
        told.push((one, exact, motion));
    }
    let agreed = information.cholesky()?.solve(&pull);
    let differences = told.into_iter().map(|(one, exact, motion)| {
        let off = motion - agreed;
        Difference {
            motion,
            center: around * center,
            ..difference(one, &exact, &off)
        }
    });
    let differences: Vec<Difference> = differences.collect();
    let finite = differences.iter().all(|one| one.deviation.is_finite());
    finite.then_some(differences)
}

/// - `exact`: inverse of the view's covariance
/// - `off`: turn and shift, world frame
fn difference(one: &Alone, exact: &Matrix6<f64>, off: &Vector6<f64>) -> Difference {
    let turn: Vector3<f64> = off.fixed_rows::<3>(0).into_owned();
    let shift = one.sight_from_world * off.fixed_rows::<3>(3).into_owned();
    let axes = one.sight_from_world.matrix();
    let block = |at: usize| one.covariance.fixed_view::<3, 3>(at, at).into_owned();
    let place = axes * block(3) * axes.transpose();
    let across = shift.xy().norm();
    // Of how many standard deviations each is by itself.
    let kinds = [
        (
            Kind::Across,
            across / place.fixed_view::<2, 2>(0, 0).trace().sqrt(),
        ),
        (Kind::Along, shift.z.abs() / place[(2, 2)].sqrt()),
        (Kind::Turn, turn.norm() / block(0).trace().sqrt()),
    ];
    let mostly = kinds.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
    Difference {
        deviation: (off.transpose() * exact * off).x.sqrt(),
        across,
        along: shift.z.abs(),
        distance: one.distance,
        turn: turn.norm(),
        by_edges: one.by_edges,
        mostly: mostly.map_or(Kind::Across, |(kind, _)| kind),
        motion: *off,
        covariance: one.covariance,
        center: Point3::origin(),
    }
}
