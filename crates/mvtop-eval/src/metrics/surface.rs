//! Errors of a pose over the points of the object's surface.

use std::sync::OnceLock;

use nalgebra::{Isometry3, Point3};

use super::Symmetries;
use super::kernel::{Affine, Columns, PinholePair, max_squared, max_squared_px, sum_of_lengths};
use super::nearest::Tree;
use crate::{Error, Result};
use mvtop_core::camera::Intrinsics;

/// Points on an object's surface, in its frame, made ready for measuring many poses.
///
/// Poses map the object's frame into one other frame (a camera's or the world's), and have the unit
/// of the points.
#[derive(Debug)]
pub struct Surface {
    /// Farthest from the center first: where a pose is off, it is most off there, and a symmetry
    /// that is not the best one is ruled out after a few points.
    points: Columns,
    /// Made when first needed.
    tree: OnceLock<Tree>,
}

impl Surface {
    /// # Errors
    /// [`Error::Input`] where there is no point or one that is not finite.
    pub fn new(points: &[Point3<f64>]) -> Result<Self> {
        if points.is_empty() {
            return Err(Error::Input(
                "surface: expected at least one point, got none".into(),
            ));
        }
        if let Some(i) = points.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
            return Err(Error::Input(format!(
                "surface: expected finite coordinates, got {} for point {i}",
                points[i]
            )));
        }
        let sum = points
            .iter()
            .fold(Point3::origin(), |sum, p| sum + p.coords);
        let center = sum / points.len() as f64;
        let mut sorted: Vec<&Point3<f64>> = points.iter().collect();
        sorted.sort_by(|a, b| (*b - center).norm().total_cmp(&(*a - center).norm()));
        let axis = |axis: usize| sorted.iter().map(|p| p[axis]).collect();
        Ok(Self {
            points: Columns {
                x: axis(0),
                y: axis(1),
                z: axis(2),
            },
            tree: OnceLock::new(),
        })
    }

    /// Number of points.
    fn count(&self) -> f64 {
        self.points.x.len() as f64
    }

    fn point(&self, i: usize) -> Point3<f64> {
        Point3::new(self.points.x[i], self.points.y[i], self.points.z[i])
    }

    /// ADD: average distance of the points under both poses.
    ///
    /// Source: Hinterstoisser et al., "Model Based Training, Detection and Pose Estimation of
    /// Texture-Less 3D Objects in Heavily Cluttered Scenes", 2012; `add` of bop_toolkit.
    pub fn add(&self, truth: &Isometry3<f64>, estimate: &Isometry3<f64>) -> f64 {
        self.mean_length(&Affine::difference(truth, estimate))
    }

    /// Mean length of what the points become; of the difference of two poses, that is ADD.
    pub(crate) fn mean_length(&self, map: &Affine) -> f64 {
        sum_of_lengths(&self.points, map) / self.count()
    }

    /// ADD-S (also ADI): average distance of the points under the true pose to the nearest point
    /// under the estimated one.
    ///
    /// Source: as [`Surface::add`]; `adi` of bop_toolkit.
    pub fn add_s(&self, truth: &Isometry3<f64>, estimate: &Isometry3<f64>) -> f64 {
        let tree = self.tree.get_or_init(|| {
            let points: Vec<_> = (0..self.points.x.len()).map(|i| self.point(i)).collect();
            Tree::new(&points)
        });
        // Distances are the same in the object's frame, where one tree serves all poses.
        tree.sum_of_distances(&estimate.inv_mul(truth)) / self.count()
    }

    /// ADD-(S): ADD-S for symmetric objects, ADD for others.
    ///
    /// Which objects count as symmetric differs: of YCB-V, PoseCNN takes 13, 16, 19, 20 and 21, BOP
    /// also 1, 14 and 18.
    pub fn add_or_add_s(
        &self,
        truth: &Isometry3<f64>,
        estimate: &Isometry3<f64>,
        symmetric: bool,
    ) -> f64 {
        match symmetric {
            true => self.add_s(truth, estimate),
            false => self.add(truth, estimate),
        }
    }

    /// MSSD: greatest distance of the points under both poses, for the symmetry where that is
    /// least.
    ///
    /// Source: Hodaň et al., "BOP Challenge 2020 on 6D Object Localization"; `mssd` of bop_toolkit.
    pub fn mssd(
        &self,
        truth: &Isometry3<f64>,
        estimate: &Isometry3<f64>,
        symmetries: &Symmetries,
    ) -> f64 {
        least(symmetries, truth, |truth, least| {
            max_squared(&self.points, &Affine::difference(estimate, truth), least)
        })
    }

    /// MSPD: greatest distance of the points' pixels under both poses, for the symmetry where that
    /// is least, px.
    ///
    /// - `truth`, `estimate`: object frame to camera frame
    /// - `intrinsics`: BOP's is a pinhole; others are taken as they are
    /// - returns: infinite where the lens cannot image a point, as behind the camera
    ///
    /// Source: as [`Surface::mssd`]; `mspd` of bop_toolkit.
    pub fn mspd(
        &self,
        truth: &Isometry3<f64>,
        estimate: &Isometry3<f64>,
        symmetries: &Symmetries,
        intrinsics: &Intrinsics,
    ) -> f64 {
        if intrinsics.is_pinhole() && intrinsics.skew() == 0.0 {
            let estimate = Affine::new(estimate);
            return least(symmetries, truth, |truth, least| {
                let pair = PinholePair {
                    truth: Affine::new(truth),
                    estimate,
                    fx: intrinsics.fx(),
                    fy: intrinsics.fy(),
                };
                max_squared_px(&self.points, &pair, least)
            });
        }
        let project = |pose: &Isometry3<f64>, i| intrinsics.project(&(pose * self.point(i)));
        let count = self.points.x.len();
        let pixels: Option<Vec<_>> = (0..count).map(|i| project(estimate, i)).collect();
        let Some(pixels) = pixels else {
            return f64::INFINITY;
        };
        least(symmetries, truth, |truth, least| {
            let mut greatest: f64 = 0.0;
            for (i, pixel) in pixels.iter().enumerate() {
                let squared = project(truth, i).map_or(f64::INFINITY, |p| {
                    (p.x - pixel.x).powi(2) + (p.y - pixel.y).powi(2)
                });
                greatest = greatest.max(squared);
                if greatest > least {
                    break;
                }
            }
            greatest
        })
    }
}

/// Square root of the least that a squared error is for any symmetric one of the true poses.
///
/// - `squared`: of a true pose; is told the least so far, above which any number will do
fn least(
    symmetries: &Symmetries,
    truth: &Isometry3<f64>,
    squared: impl Fn(&Isometry3<f64>, f64) -> f64,
) -> f64 {
    let motions = symmetries.motions().iter();
    let least = |least: f64, motion| least.min(squared(&(truth * motion), least));
    motions.fold(f64::INFINITY, least).sqrt()
}
