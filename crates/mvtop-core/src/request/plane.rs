//! Objects that stand upright on a plane.

use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::refuse;
use crate::bundle::Class;
use crate::symmetry::Symmetry;
use crate::{Error, Result};

/// A plane on which objects stand upright.
///
/// Objects are given only where an axis of theirs is along the plane's normal, and their lowest surface
/// point in the plane.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(try_from = "Fields", into = "Fields")]
pub struct Plane {
    fields: Fields,
    normal: Unit<Vector3<f64>>,
    axis: Unit<Vector3<f64>>,
}

/// A plane as JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "Plane")
)]
#[serde(deny_unknown_fields)]
struct Fields {
    /// Class that stands on it; all by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    class: Option<String>,
    /// A point of the plane, world frame, metres.
    point_m: [f64; 3],
    /// Upwards, world frame.
    normal: [f64; 3],
    /// Axis of the object that points up, object frame.
    #[serde(default = "z")]
    axis: [f64; 3],
    /// Largest distance of the lowest surface point from the plane, metres.
    within_m: f64,
    /// Largest angle between axis and normal, degrees.
    within_deg: f64,
}

fn z() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// How an object stands on a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stand {
    /// The pose, of those that look alike the most upright one.
    pub world_from_obj: Isometry3<f64>,
    /// Angle between the object's axis and the normal, degrees.
    pub tilt_deg: f64,
    /// Height of its lowest surface point above the plane, metres.
    pub height_m: f64,
}

impl Plane {
    /// - `class`: name of the class that stands on it; `None`: all do
    /// - `point_m`: of the plane, world frame, metres
    /// - `normal`: upwards, world frame, of any length
    /// - `axis`: that of the object which points up, object frame, of any length
    /// - `within_m`: greatest distance of the lowest surface point from the plane, metres
    /// - `within_deg`: greatest angle between axis and normal, degrees
    ///
    /// # Errors
    /// [`Error::Input`] for directions without a length, limits that are not above 0, or numbers that
    /// are not finite.
    ///
    /// ```
    /// use mvtop_core::request::Plane;
    ///
    /// let up = [0.0, 0.0, 1.0];
    /// assert!(Plane::new(None, [0.0; 3], up, up, 0.01, 10.0).is_ok());
    /// assert!(Plane::new(None, [0.0; 3], [0.0; 3], up, 0.01, 10.0).is_err());
    /// ```
    pub fn new(
        class: Option<String>,
        point_m: [f64; 3],
        normal: [f64; 3],
        axis: [f64; 3],
        within_m: f64,
        within_deg: f64,
    ) -> Result<Self> {
        Self::try_from(Fields {
            class,
            point_m,
            normal,
            axis,
            within_m,
            within_deg,
        })
    }

    /// Name of the class that stands on it; `None`: all do.
    pub fn class(&self) -> Option<&str> {
        self.fields.class.as_deref()
    }

    /// Greatest distance of the lowest surface point from the plane, metres.
    pub fn within_m(&self) -> f64 {
        self.fields.within_m
    }

    /// Greatest angle between axis and normal, degrees.
    pub fn within_deg(&self) -> f64 {
        self.fields.within_deg
    }

    /// How an object at a pose, or at one that looks like it, stands on the plane.
    pub(crate) fn stand(&self, class: &Class, pose: &Isometry3<f64>) -> Stand {
        let axis_alone = Symmetry {
            discrete: Vec::new(),
            axis: class.symmetry.axis,
        };
        let tilt = |pose: &Isometry3<f64>| (pose.rotation * self.axis).angle(&self.normal);
        let upright = |pose: Isometry3<f64>| match axis_alone.is_none() {
            true => pose,
            false => {
                let up = pose.rotation * self.axis;
                let turn = UnitQuaternion::rotation_between_axis(&up, &self.normal);
                let target = Isometry3::from_parts(
                    pose.translation,
                    turn.unwrap_or_else(UnitQuaternion::identity) * pose.rotation,
                );
                axis_alone.nearest(&pose, &target, class.diameter_m)
            }
        };
        let others = class.symmetry.discrete.iter().map(|motion| pose * motion);
        let alike = std::iter::once(*pose).chain(others).map(upright);
        let best = alike.min_by(|a, b| tilt(a).total_cmp(&tilt(b)));
        let world_from_obj = best.unwrap_or(*pose);
        let origin = Point3::from(self.fields.point_m);
        let height = |point: Point3<f64>| (world_from_obj * point - origin).dot(&self.normal);
        let points = class.points.iter().map(|one| Point3::from(one.position));
        let lowest = points.map(height).reduce(f64::min);
        Stand {
            world_from_obj,
            tilt_deg: tilt(&world_from_obj).to_degrees(),
            height_m: lowest.unwrap_or_else(|| height(Point3::origin())),
        }
    }
}

impl TryFrom<Fields> for Plane {
    type Error = Error;

    fn try_from(fields: Fields) -> Result<Self> {
        let direction = |name: &str, [x, y, z]: [f64; 3]| {
            let unit = Unit::try_new(Vector3::new(x, y, z), 1e-12);
            unit.filter(|unit| unit.iter().all(|x| x.is_finite()))
                .ok_or_else(|| {
                    refuse(&format!(
                        "plane: {name}: expected three numbers of a direction, not all 0, got {:?}",
                        [x, y, z]
                    ))
                })
        };
        let normal = direction("normal", fields.normal)?;
        let axis = direction("axis", fields.axis)?;
        if !fields.point_m.iter().all(|x| x.is_finite()) {
            return Err(refuse(&format!(
                "plane: point_m: expected three numbers in metres, got {:?}",
                fields.point_m
            )));
        }
        for (name, limit) in [
            ("within_m", fields.within_m),
            ("within_deg", fields.within_deg),
        ] {
            if !(limit.is_finite() && limit > 0.0) {
                return Err(refuse(&format!(
                    "plane: {name}: expected a limit above 0, got {limit}"
                )));
            }
        }
        Ok(Self {
            fields,
            normal,
            axis,
        })
    }
}

impl From<Plane> for Fields {
    fn from(plane: Plane) -> Self {
        plane.fields
    }
}
