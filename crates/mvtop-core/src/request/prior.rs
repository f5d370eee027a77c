//! Where an object is known to be before the images are seen.

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use super::refuse;
use crate::bundle::Class;
use crate::pose::{rotation_error_deg, translation_error};
use crate::report::rows;
use crate::transform::from_matrix;
use crate::{Error, Result};

/// A rough pose of an object.
///
/// Objects of its class are given only near one of the class's priors: no farther from it than
/// [`Prior::MOST_DEVIATIONS`] in distance and in angle. The pose is a proposal as well: the object is
/// looked for there even where the detector sees nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(try_from = "Fields", into = "Fields")]
pub struct Prior {
    fields: Fields,
    world_from_obj: Isometry3<f64>,
}

/// A prior as JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "Prior")
)]
#[serde(deny_unknown_fields)]
struct Fields {
    /// Class name.
    class: String,
    /// Object to world, rows of a matrix, metres.
    #[serde(rename = "T_world_obj")]
    world_from_obj: [[f64; 4]; 4],
    /// Standard deviation of the position, metres.
    sigma_m: f64,
    /// Standard deviation of the rotation, degrees.
    sigma_deg: f64,
}

impl Prior {
    /// Greatest deviation of an answer from its prior, standard deviations.
    pub const MOST_DEVIATIONS: f64 = 3.0;

    /// Odds of priors and planes: of two poses that the images show equally well, the one that they
    /// exclude is less probable by this factor. A prior that the images contradict gives a pose of low
    /// confidence.
    pub const ODDS: f64 = 20.0;

    /// - `class`: name of the object's class
    /// - `world_from_obj`: object frame to world frame, metres
    /// - `sigma_m`: standard deviation of the position, metres
    /// - `sigma_deg`: standard deviation of the rotation, degrees; from 60 on any rotation will do
    ///
    /// # Errors
    /// [`Error::Input`] for standard deviations that are not above 0.
    ///
    /// ```
    /// use mvtop_core::request::Prior;
    /// use nalgebra::Isometry3;
    ///
    /// let prior = Prior::new("nut", &Isometry3::translation(0.1, 0.0, 0.8), 0.01, 10.0)?;
    /// assert_eq!(prior.world_from_obj().translation.x, 0.1);
    /// assert!(Prior::new("nut", &Isometry3::identity(), 0.0, 10.0).is_err());
    /// # Ok::<(), mvtop_core::Error>(())
    /// ```
    pub fn new(
        class: impl Into<String>,
        world_from_obj: &Isometry3<f64>,
        sigma_m: f64,
        sigma_deg: f64,
    ) -> Result<Self> {
        Self::try_from(Fields {
            class: class.into(),
            world_from_obj: rows(world_from_obj),
            sigma_m,
            sigma_deg,
        })
    }

    /// Name of the object's class.
    pub fn class(&self) -> &str {
        &self.fields.class
    }

    /// Object frame to world frame, metres.
    pub fn world_from_obj(&self) -> &Isometry3<f64> {
        &self.world_from_obj
    }

    /// Standard deviation of the position, metres.
    pub fn sigma_m(&self) -> f64 {
        self.fields.sigma_m
    }

    /// Standard deviation of the rotation, degrees.
    pub fn sigma_deg(&self) -> f64 {
        self.fields.sigma_deg
    }

    /// Of the poses that look like `pose` the one nearest to the prior, and how far it is from it: the
    /// greater of its distance and its angle, standard deviations.
    pub(crate) fn deviation(&self, class: &Class, pose: &Isometry3<f64>) -> (Isometry3<f64>, f64) {
        let prior = &self.world_from_obj;
        let alike = match class.symmetry.is_none() {
            true => *pose,
            false => class.symmetry.nearest(pose, prior, class.diameter_m),
        };
        let shift = translation_error(prior, &alike) / self.sigma_m();
        let turn = rotation_error_deg(&prior.rotation, &alike.rotation) / self.sigma_deg();
        (alike, shift.max(turn))
    }
}

impl TryFrom<Fields> for Prior {
    type Error = Error;

    fn try_from(fields: Fields) -> Result<Self> {
        let refused = |problem: String| refuse(&format!("prior of `{}`: {problem}", fields.class));
        let pose = from_matrix(&fields.world_from_obj);
        let world_from_obj = pose.map_err(|problem| refused(format!("T_world_obj: {problem}")))?;
        for (name, sigma) in [("sigma_m", fields.sigma_m), ("sigma_deg", fields.sigma_deg)] {
            if !(sigma.is_finite() && sigma > 0.0) {
                return Err(refused(format!(
                    "{name}: expected a standard deviation above 0, got {sigma}"
                )));
            }
        }
        Ok(Self {
            fields,
            world_from_obj,
        })
    }
}

impl From<Prior> for Fields {
    fn from(prior: Prior) -> Self {
        prior.fields
    }
}
