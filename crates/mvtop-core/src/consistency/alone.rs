//! What each view tells of an object by itself, and whether one pose can be all of that.
//!
//! A view's own pose is where its image alone shows the mesh's edges ([`crate::refine`]). Each tells
//! six numbers, of which an error of the calibration makes those of two views contradict each other:
//! lines of sight that miss each other, distances that do not belong to the size, and turns.

use nalgebra::{Isometry3, Matrix3, Matrix6, Rotation3, Vector3, Vector6};

use super::{Sight, agreement};
use crate::bundle::SurfacePoint;
use crate::prediction::Sigma;
use crate::refine::{self, Refiner};

/// How far the pose that a view is searched from is expected to be off: turns, degrees, and the
/// position as a share of the distance.
const START: (f64, f64) = (10.0, 0.03);
/// Starts that are nearer to each other are one, as a share of the diameter.
const SAME_START: f64 = 0.05;
/// Of an image that shows a smaller share of the edges, the box is believed instead.
const LEAST_SUPPORTED: f64 = 0.5;
/// Edges of one view err together: how much larger the covariance is than they say.
const TOGETHER: f64 = 3.0;
/// What the best images and meshes err by.
const BY_EDGES: Error = Error {
    across: 0.004,
    along: 0.006,
    turn: 0.02,
};
/// What boxes of hidden or blurred objects err by. They tell nothing of the rotation.
const BY_BOX: Error = Error {
    across: 0.03,
    along: 0.05,
    turn: 1.0,
};

/// Standard deviations of a view's own pose.
struct Error {
    /// Across the line of sight, as a share of the diameter.
    across: f64,
    /// Along it, as a share of the distance.
    along: f64,
    /// About each axis, radians.
    turn: f64,
}

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
        refiner: &Refiner,
        view: &refine::View,
        sight: &Sight,
        points: &[SurfacePoint],
        world_from_obj: &Isometry3<f64>,
    ) -> Option<Self> {
        let shift = agreement(points, &[*sight], world_from_obj)?.shift;
        let mut by_box = *world_from_obj;
        by_box.translation.vector += shift;
        let to_object = |pose: &Isometry3<f64>| {
            (pose * refiner.center()).coords - view.camera.world_from_cam().translation.vector
        };
        let distance = to_object(&by_box).norm();
        let sigma = Sigma {
            rot_deg: START.0,
            t_m: START.1 * distance,
        };
        let from = |start| refiner.refine_coarsely(std::slice::from_ref(view), start, sigma);
        // Where the box is where the pose has it, both searches would be one.
        let apart = shift.norm() > SAME_START * refiner.diameter_m();
        let (joint, boxed) = rayon::join(
            || from(world_from_obj),
            || apart.then(|| from(&by_box)).flatten(),
        );
        let best = [boxed, joint]
            .into_iter()
            .flatten()
            .filter(|found| found.supported > LEAST_SUPPORTED)
            .reduce(|a, b| if b.supported > a.supported { b } else { a });
        let best = best.and_then(|best| Some((best.information.cholesky()?.inverse(), best)));
        let by_edges = best.is_some();
        let (pose, told, error) = match best {
            Some((told, best)) => (best.world_from_obj, told * TOGETHER, BY_EDGES),
            None => (by_box, Matrix6::zeros(), BY_BOX),
        };
        let along = to_object(&pose);
        let up = match along.x.abs() < along.y.abs() {
            true => Vector3::x(),
            false => Vector3::y(),
        };
        let sight_from_world = Rotation3::look_at_rh(&-along, &up);
        let across = (error.across * refiner.diameter_m()).powi(2);
        let place = Vector3::new(across, across, (error.along * distance).powi(2));
        let axes = sight_from_world.matrix();
        let place = axes.transpose() * Matrix3::from_diagonal(&place) * axes;
        let mut covariance = told + Matrix6::from_diagonal_element(error.turn.powi(2));
        for (row, column) in (0..9).map(|i| (i / 3, i % 3)) {
            let by_turn = if row == column {
                error.turn.powi(2)
            } else {
                0.0
            };
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
        difference(one, &exact, &off)
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
    }
}
