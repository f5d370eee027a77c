//! How far two poses of an object are apart, measured on its points.

use nalgebra::{Matrix3, Point3, Vector3};

use super::PoseRecord;
use crate::Result;
use crate::bop::Model;
use crate::metrics::{Affine, Surface};

/// Points that ADD is measured on, at most; of a mesh with more vertices, every n-th.
const POINTS: usize = 1000;

/// An object's points, with what bounds ADD without visiting them; millimetres.
#[derive(Debug)]
pub struct Shape {
    points: Surface,
    diameter_mm: f64,
    mean: Vector3<f64>,
    /// Mean of `q qᵀ`, where q is a point relative to the mean.
    spread: Matrix3<f64>,
    /// Largest distance of a point from the mean.
    radius: f64,
}

impl Shape {
    /// # Errors
    /// [`crate::Error::Input`] where the model has no vertices.
    pub fn new(model: &Model) -> Result<Self> {
        let vertices = model.mesh.vertices();
        let stride = vertices.len().div_ceil(POINTS).max(1);
        let points: Vec<Point3<f64>> = vertices.iter().step_by(stride).map(|p| p * 1e3).collect();
        let surface = Surface::new(&points)?;
        let share = 1.0 / points.len() as f64;
        let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() * share;
        let relative = || points.iter().map(|point| point.coords - mean);
        Ok(Self {
            diameter_mm: model.diameter_m * 1e3,
            mean,
            spread: relative().map(|q| q * q.transpose()).sum::<Matrix3<f64>>() * share,
            radius: relative().map(|q| q.norm()).fold(0.0, f64::max),
            points: surface,
        })
    }

    /// The diameter that [`Model`] names.
    pub fn diameter_mm(&self) -> f64 {
        self.diameter_mm
    }

    /// Where a pose puts the mean of the points, millimetres. ADD is never less than the distance
    /// of these places.
    pub(super) fn center(&self, pose: &PoseRecord) -> Vector3<f64> {
        pose.rotation * self.mean + pose.translation_mm
    }

    /// Mean distance of the points under two poses (ADD), millimetres; `None` where it is more than
    /// `limit_mm`.
    ///
    /// With distances d_i, ADD = mean d ≥ mean d² / max d, which needs no visit of the points and
    /// sorts out nearly every pose that is another one.
    pub fn add_mm(&self, a: &PoseRecord, b: &PoseRecord, limit_mm: f64) -> Option<f64> {
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
        let add = self.points.mean_length(&Affine::from_parts(turn, shift));
        (add <= limit_mm).then_some(add)
    }
}
