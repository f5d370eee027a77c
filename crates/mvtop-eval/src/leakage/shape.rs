//! How far two poses of an object are apart, measured on its points.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;

use super::Pose;
use crate::bop::{load_ply, read_json};
use crate::{Error, Result};

/// Points that ADD is measured on, at most; of a mesh with more vertices, every n-th.
const POINTS: usize = 1000;

/// An object's points, with what bounds ADD without visiting them.
#[derive(Debug, Clone)]
pub struct Model {
    points: Vec<Vector3<f64>>,
    pub diameter_mm: f64,
    mean: Vector3<f64>,
    /// Mean of `q qᵀ`, where q is a point relative to the mean.
    spread: Matrix3<f64>,
    /// Largest distance of a point from the mean.
    radius: f64,
}

impl Model {
    /// - `points_mm`: in the object's frame, millimetres, at least one
    pub fn new(points_mm: &[Vector3<f64>], diameter_mm: f64) -> Self {
        let stride = points_mm.len().div_ceil(POINTS).max(1);
        let points: Vec<_> = points_mm.iter().step_by(stride).copied().collect();
        let share = 1.0 / points.len() as f64;
        let mean = points.iter().sum::<Vector3<f64>>() * share;
        let relative = || points.iter().map(|point| point - mean);
        Self {
            diameter_mm,
            mean,
            spread: relative().map(|q| q * q.transpose()).sum::<Matrix3<f64>>() * share,
            radius: relative().map(|q| q.norm()).fold(0.0, f64::max),
            points,
        }
    }

    /// Where a pose puts the mean of the points, millimetres. ADD is never less than the distance
    /// of these places.
    pub fn center(&self, pose: &Pose) -> Vector3<f64> {
        pose.rotation * self.mean + pose.translation_mm
    }

    /// Mean distance of the points under two poses (ADD), millimetres; `None` where it is more than
    /// `limit_mm`.
    ///
    /// With distances d_i, ADD = mean d ≥ mean d² / max d, which needs no visit of the points and
    /// sorts out nearly every pose that is another one.
    pub fn add_mm(&self, a: &Pose, b: &Pose, limit_mm: f64) -> Option<f64> {
        let turn = a.rotation - b.rotation;
        let shift = a.translation_mm - b.translation_mm;
        let between = (turn * self.mean + shift).norm();
        let mean_squared = between * between + (turn * self.spread).dot(&turn);
        let largest = between + turn.norm() * self.radius;
        // A little more than the limit, for rounding.
        let limit = limit_mm * (1.0 + 1e-9) + 1e-9;
        if between > limit || mean_squared > limit * largest {
            return None;
        }
        let sum: f64 = self.points.iter().map(|p| (turn * p + shift).norm()).sum();
        let add = sum / self.points.len() as f64;
        (add <= limit_mm).then_some(add)
    }
}

/// Angle between two poses' rotations, degrees. From the difference of the matrices, as the arc
/// cosine of the trace cannot tell small angles from zero.
pub fn rotation_deg(a: &Pose, b: &Pose) -> f64 {
    let sine_of_half = (a.rotation - b.rotation).norm() / 8f64.sqrt();
    2.0 * sine_of_half.min(1.0).asin().to_degrees()
}

/// Reads the models of some objects from a BOP folder of models: `models_info.json` for the
/// diameters, `obj_NNNNNN.ply` for the points.
///
/// # Errors
/// [`Error::Read`] where a file cannot be read, [`Error::Input`] where it does not hold a model.
pub fn load(folder: &Path, objects: impl Iterator<Item = u32>) -> Result<BTreeMap<u32, Model>> {
    #[derive(Deserialize)]
    struct Info {
        diameter: f64,
    }
    let path = folder.join("models_info.json");
    let infos: BTreeMap<u32, Info> = read_json(&path, "{OBJECT: {\"diameter\": MILLIMETRES}}")?;
    let model = |id: u32| {
        let diameter = infos.get(&id).map(|info| info.diameter);
        let Some(diameter_mm) = diameter.filter(|d| d.is_finite() && *d > 0.0) else {
            return Err(Error::Input(format!(
                "{}: expected a positive diameter of object {id}, which both splits hold, got \
                 {diameter:?}",
                path.display()
            )));
        };
        let mesh = folder.join(format!("obj_{id:06}.ply"));
        let mesh = load_ply(&mesh, 1.0)?;
        let points: Vec<_> = mesh.vertices().iter().map(|point| point.coords).collect();
        Ok((id, Model::new(&points, diameter_mm)))
    };
    objects.map(model).collect()
}
