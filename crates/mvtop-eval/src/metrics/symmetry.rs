//! Motions of an object that do not change how it looks.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::{Error, Result};

/// BOP's step for continuous symmetries: the farthest point travels at most this share of the
/// diameter from one turn to the next.
pub const BOP_MAX_STEP: f64 = 0.01;
/// Below this the turns would be more than anything could use.
const LEAST_STEP: f64 = 1e-5;

/// A body of revolution: every turn about an axis looks the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContinuousSymmetry {
    /// Direction of the axis, object frame.
    pub axis: Unit<Vector3<f64>>,
    /// A point on the axis, object frame.
    pub offset: Point3<f64>,
}

/// Symmetry motions of an object in its own frame (`obj_from_obj`); the identity is one of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Symmetries(Vec<Isometry3<f64>>);

impl Default for Symmetries {
    /// Only the identity.
    fn default() -> Self {
        Self(vec![Isometry3::identity()])
    }
}

impl Symmetries {
    /// The identity and the discrete symmetries, each followed by every turn about each axis.
    ///
    /// A turn is repeated `ceil(π / max_step)` times in equal steps. Turns about different axes are
    /// not combined with each other. All this as in `get_symmetry_transformations` of bop_toolkit.
    ///
    /// - `discrete`: without the identity, in the unit of the points they will be applied to
    /// - `max_step`: [`BOP_MAX_STEP`], or another share of the diameter
    ///
    /// # Errors
    /// [`Error::Input`] where `max_step` is not between 0.00001 and π.
    pub fn new(
        discrete: &[Isometry3<f64>],
        continuous: &[ContinuousSymmetry],
        max_step: f64,
    ) -> Result<Self> {
        if !(LEAST_STEP..=PI).contains(&max_step) {
            return Err(Error::Input(format!(
                "symmetries: expected a largest step from {LEAST_STEP} to π, got {max_step}; BOP's \
                 is {BOP_MAX_STEP}"
            )));
        }
        let steps = (PI / max_step).ceil() as usize;
        let turns: Vec<Isometry3<f64>> = continuous
            .iter()
            .flat_map(|symmetry| (0..steps).map(|i| symmetry.turn(TAU * i as f64 / steps as f64)))
            .collect();
        let discrete = std::iter::once(Isometry3::identity()).chain(discrete.iter().copied());
        if turns.is_empty() {
            return Ok(Self(discrete.collect()));
        }
        let all = discrete.flat_map(|motion| turns.iter().map(move |turn| turn * motion));
        Ok(Self(all.collect()))
    }

    /// All motions, the identity first.
    pub fn motions(&self) -> &[Isometry3<f64>] {
        &self.0
    }

    /// Whether there is any but the identity.
    pub fn is_symmetric(&self) -> bool {
        self.0.len() > 1
    }
}

impl ContinuousSymmetry {
    fn turn(&self, angle: f64) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_axis_angle(&self.axis, angle);
        let offset = self.offset.coords;
        Isometry3::from_parts(Translation3::from(offset - rotation * offset), rotation)
    }
}
