//! Turns after which an object looks the same: no image tells which of them it has made.

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use serde::Serialize;

use crate::pose::rotation_error_deg;

/// How far points move by a turn of a radian, as a share of the diameter: weighs turns against
/// shifts where a symmetry does both.
const REACH: f64 = 1.0 / 6.0;

/// The symmetries of an object; none by default.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Symmetry {
    /// Single motions that leave it looking the same, without the identity, metres.
    pub discrete: Vec<Isometry3<f64>>,
    /// An axis about which any turn does.
    pub axis: Option<Axis>,
}

/// An axis in the object's frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Axis {
    /// Unit vector.
    #[cfg_attr(feature = "schema", schemars(with = "[f64; 3]"))]
    pub direction: Unit<Vector3<f64>>,
    /// A point on it, metres.
    #[cfg_attr(feature = "schema", schemars(with = "[f64; 3]"))]
    pub point: Point3<f64>,
}

impl Symmetry {
    /// Whether no other pose looks the same.
    pub fn is_none(&self) -> bool {
        self.discrete.is_empty() && self.axis.is_none()
    }

    /// Of all poses that look like `pose` the one nearest to `target`.
    ///
    /// One motion is chosen for rotation and translation together, for an axis beside the origin
    /// couples them.
    ///
    /// - `diameter_m`: of the object
    pub fn nearest(
        &self,
        pose: &Isometry3<f64>,
        target: &Isometry3<f64>,
        diameter_m: f64,
    ) -> Isometry3<f64> {
        let away = |candidate: &Isometry3<f64>| {
            let turn = candidate.rotation.angle_to(&target.rotation) * REACH * diameter_m;
            let shift = candidate.translation.vector - target.translation.vector;
            turn * turn + shift.norm_squared()
        };
        self.alike(pose, &target.rotation, away)
    }

    /// Of all poses that look like `pose` the one that is least away; of turns about the axis the one
    /// whose rotation is nearest to `target`.
    fn alike(
        &self,
        pose: &Isometry3<f64>,
        target: &UnitQuaternion<f64>,
        away: impl Fn(&Isometry3<f64>) -> f64,
    ) -> Isometry3<f64> {
        let turned = |motion: &Isometry3<f64>| {
            let pose = pose * motion;
            self.axis.map_or(pose, |axis| axis.turned(&pose, target))
        };
        let first = turned(&Isometry3::identity());
        let others = self.discrete.iter().map(turned);
        let each = std::iter::once(first).chain(others);
        let each = each.map(|candidate| (away(&candidate), candidate));
        each.min_by(|a, b| a.0.total_cmp(&b.0))
            .map_or(first, |(_, nearest)| nearest)
    }

    /// Angle between two poses, degrees, but for turns after which the object looks the same.
    ///
    /// - `diameter_m`: of the object
    pub fn apart_deg(&self, a: &Isometry3<f64>, b: &Isometry3<f64>, diameter_m: f64) -> f64 {
        let alike = self.nearest(b, a, diameter_m);
        rotation_error_deg(&a.rotation, &alike.rotation)
    }

    /// The one of all poses that look like `pose` that is always given: whose axes are nearest to
    /// those of the frame that it is in.
    pub fn canonical(&self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        let upright = UnitQuaternion::identity();
        self.alike(pose, &upright, |candidate| candidate.rotation.angle())
    }

    /// The covariance of a turn, but for what is about the axis: that is no error.
    ///
    /// - `turn`: radians², in the object's frame
    pub fn covariance_of_errors(&self, turn: &Matrix3<f64>) -> Matrix3<f64> {
        self.axis.map_or(*turn, |Axis { direction, .. }| {
            let across = Matrix3::identity() - *direction * direction.transpose();
            across * turn * across
        })
    }
}

impl Axis {
    /// `pose`, turned about the axis so that its rotation is nearest to the target.
    fn turned(&self, pose: &Isometry3<f64>, target: &UnitQuaternion<f64>) -> Isometry3<f64> {
        // The part of the rotation from one to the other that is about the axis (swing and twist).
        let between = pose.rotation.inverse() * target;
        let angle = 2.0 * between.imag().dot(&self.direction).atan2(between.w);
        let rotation = UnitQuaternion::from_axis_angle(&self.direction, angle);
        let moved = self.point - rotation * self.point;
        pose * Isometry3::from_parts(Translation3::from(moved), rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI, TAU};

    const DIAMETER: f64 = 0.1;

    fn about(axis: Vector3<f64>, point: Point3<f64>, angle: f64) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), angle);
        Isometry3::from_parts((point - rotation * point).into(), rotation)
    }

    fn pose(numbers: [f64; 6]) -> Isometry3<f64> {
        let [x, y, z, a, b, c] = numbers;
        Isometry3::new(Vector3::new(x, y, z), Vector3::new(a, b, c))
    }

    fn any_pose() -> impl Strategy<Value = Isometry3<f64>> {
        prop::array::uniform6(-1.5..1.5f64).prop_map(pose)
    }

    fn shaft() -> Symmetry {
        Symmetry {
            discrete: Vec::new(),
            axis: Some(Axis {
                direction: Unit::new_normalize(Vector3::new(1.0, 2.0, -0.5)),
                point: Point3::new(0.02, -0.01, 0.03),
            }),
        }
    }

    #[test]
    fn of_a_nut_the_nearest_sixth_is_taken() {
        let sixth = |n: i32| about(Vector3::z(), Point3::origin(), f64::from(n) * TAU / 6.0);
        let nut = Symmetry {
            discrete: (1..6).map(sixth).collect(),
            axis: None,
        };
        let seen = pose([0.1, 0.2, 0.9, 0.3, -0.4, 1.0]);
        for n in 0..6 {
            let target = seen * sixth(n) * pose([0.0, 0.0, 0.0, 0.1, -0.1, 0.2]);
            assert_relative_eq!(
                nut.nearest(&seen, &target, DIAMETER),
                seen * sixth(n),
                epsilon = 1e-12
            );
        }
        let apart = |degrees: f64| {
            let turned = seen * about(Vector3::z(), Point3::origin(), degrees.to_radians());
            nut.apart_deg(&seen, &turned, DIAMETER)
        };
        assert_relative_eq!(apart(200.0), 20.0, epsilon = 1e-9);
        assert_relative_eq!(apart(-40.0), 20.0, epsilon = 1e-9);
        assert!(!nut.is_none() && Symmetry::default().is_none());
    }

    #[test]
    fn rotation_and_translation_are_of_one_motion() {
        // A half turn about an axis 20 mm off: by rotation alone it would be the nearer one.
        let half = about(Vector3::z(), Point3::new(0.02, 0.0, 0.0), PI);
        let symmetry = Symmetry {
            discrete: vec![half],
            axis: None,
        };
        let truth = Isometry3::identity();
        let target = about(Vector3::z(), Point3::origin(), FRAC_PI_2 + 0.02);
        assert_relative_eq!(symmetry.nearest(&truth, &target, DIAMETER), truth);
    }

    #[test]
    fn poses_a_half_turn_beside_the_origin_apart_are_given_as_one() {
        let half = about(Vector3::z(), Point3::new(0.04, 0.0, 0.0), PI);
        let symmetry = Symmetry {
            discrete: vec![half],
            axis: None,
        };
        let seen = pose([0.1, 0.2, 0.9, 0.0, 0.0, 3.0]);
        let given = symmetry.canonical(&seen);
        assert_relative_eq!(given, seen * half, epsilon = 1e-12);
        assert_relative_eq!(symmetry.canonical(&(seen * half)), given, epsilon = 1e-12);
    }

    #[test]
    fn turns_about_the_axis_are_no_errors() {
        let about_z = |axis: Option<Axis>| Symmetry {
            discrete: Vec::new(),
            axis,
        };
        let z = Axis {
            direction: Vector3::z_axis(),
            point: Point3::origin(),
        };
        let turn = Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 100.0));
        let left = about_z(Some(z)).covariance_of_errors(&turn);
        assert_relative_eq!(left, Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 0.0)));
        assert_relative_eq!(about_z(None).covariance_of_errors(&turn), turn);
    }

    proptest! {
        #[test]
        fn about_an_axis_no_turn_is_nearer(seen in any_pose(), target in any_pose()) {
            let shaft = shaft();
            let Axis { direction, point } = shaft.axis.unwrap();
            let found = shaft.nearest(&seen, &target, DIAMETER);
            let turned = |n: u32| {
                let angle = f64::from(n) * TAU / 720.0;
                seen * about(direction.into_inner(), point, angle)
            };
            let least = (0..720)
                .map(|n| turned(n).rotation.angle_to(&target.rotation))
                .fold(f64::INFINITY, f64::min);
            prop_assert!(found.rotation.angle_to(&target.rotation) <= least + 1e-9);
            // The axis stays where it was.
            prop_assert!((found * point - seen * point).norm() < 1e-9);
            let tip = point + direction.into_inner();
            prop_assert!((found * tip - seen * tip).norm() < 1e-9);
        }

        #[test]
        fn poses_that_look_alike_are_given_as_one(seen in any_pose(), angle in 0.0..TAU) {
            let shaft = shaft();
            let Axis { direction, point } = shaft.axis.unwrap();
            let alike = seen * about(direction.into_inner(), point, angle);
            let (a, b) = (shaft.canonical(&seen), shaft.canonical(&alike));
            // Where two turns are equally near, rounding decides: none of these is.
            prop_assert!(a.rotation.angle_to(&b.rotation) < 1e-6);
            prop_assert!((a.translation.vector - b.translation.vector).norm() < 1e-6);
        }
    }
}
