//! Object coordinates of crops: which point of an object lies on which ray.

use nalgebra::{Isometry3, Point3, Vector3};
use ndarray::{ArrayView3, ArrayView4, Axis};

use super::inlier;
use crate::bundle::{Class, SurfacePoint};
use crate::camera::Camera;
use crate::estimator::crops::{Crop, Group, TRUST, cell_at, cell_center};
use crate::symmetry::Symmetry;

/// A point of the object, and the ray on which it is seen.
#[derive(Debug, Clone, Copy)]
pub struct Correspondence {
    /// Index of the crop that shows it.
    pub crop: usize,
    /// Number of its cell there, row by row.
    pub cell: usize,
    /// Object frame, metres, up to one of the crop's [`Correspondences::equivalents`].
    pub point: Point3<f64>,
    /// Origin of the ray, world frame, metres.
    pub origin: Point3<f64>,
    /// Unit vector, world frame.
    pub direction: Vector3<f64>,
    /// Distance of the object, metres; known once its position is.
    pub distance: f64,
    /// Trust, 0 to 1.
    pub weight: f64,
}

/// The correspondences of all crops of an object.
#[derive(Debug, Clone)]
pub struct Correspondences {
    pub list: Vec<Correspondence>,
    /// Index of the view, and the virtual camera, of each crop.
    pub crops: Vec<(usize, Camera)>,
    /// Cells of a crop's row.
    pub columns: usize,
    pub symmetry: Symmetry,
    /// Metres.
    pub diameter: f64,
}

impl Correspondences {
    /// Those of a group's crops.
    ///
    /// - `codes`: of all crops, see [`crate::network::Network::coordinates`]
    /// - `extent`: their unit, metres
    /// - `min_trust`: cells of less are left out
    pub fn new(
        crops: &[Crop],
        codes: ArrayView4<f32>,
        group: &Group,
        extent: f64,
        class: &Class,
        min_trust: f64,
    ) -> Self {
        let list = &crops[group.crops.clone()];
        let mut all = Vec::new();
        for (at, (crop, index)) in list.iter().zip(group.crops.clone()).enumerate() {
            let codes = codes.index_axis(Axis(0), index);
            all.extend(trusted(at, crop, codes, extent, min_trust));
        }
        let crops = list.iter().map(|crop| (crop.view, crop.camera.clone()));
        Self {
            list: all,
            crops: crops.collect(),
            columns: codes.dim().3,
            symmetry: class.symmetry.clone(),
            diameter: class.diameter_m,
        }
    }

    /// For each crop the symmetry transform that maps its coordinates to this representative of the
    /// pose; empty without symmetries.
    ///
    /// A crop knows nothing of the others: of all equivalent poses it means the one most upright in its
    /// own frame.
    pub fn equivalents(&self, world_from_obj: &Isometry3<f64>) -> Vec<Isometry3<f64>> {
        if self.symmetry.is_none() {
            return Vec::new();
        }
        let transform = |(_, camera): &(usize, Camera)| {
            let pose = camera.world_from_cam().inv_mul(world_from_obj);
            pose.inv_mul(&self.symmetry.canonical(&pose))
        };
        self.crops.iter().map(transform).collect()
    }

    /// A correspondence's point, after these [`Self::equivalents`].
    pub fn point(equivalents: &[Isometry3<f64>], one: &Correspondence) -> Point3<f64> {
        let transform = equivalents.get(one.crop);
        transform.map_or(one.point, |transform| transform * one.point)
    }

    /// About `count` of the correspondences, evenly spread.
    pub fn thinned(&self, count: usize) -> Self {
        let step = self.list.len().div_ceil(count).max(1);
        Self {
            list: self.list.iter().step_by(step).copied().collect(),
            crops: self.crops.clone(),
            symmetry: self.symmetry.clone(),
            ..*self
        }
    }

    /// Inlier share of each crop over the cells that the object covers at a pose, by index of the view:
    /// occluders lower it, and anything that is no such object.
    ///
    /// - `points`: of the surface, object frame
    /// - `scale`: residual of an inlier, in diameters
    pub fn coverage(
        &self,
        points: &[SurfacePoint],
        pose: &Isometry3<f64>,
        scale: f64,
    ) -> Vec<(usize, f64)> {
        let (equivalents, cells) = (self.equivalents(pose), self.columns * self.columns);
        let mut inliers = vec![0.0; self.crops.len() * cells];
        for one in &self.list {
            inliers[one.crop * cells + one.cell] =
                inlier(one, &equivalents, pose, scale * self.diameter);
        }
        let of_crop = |((view, camera), inliers): (&(usize, Camera), &[f64])| {
            let cam_from_obj = camera.world_from_cam().inv_mul(pose);
            let mut covered = vec![false; cells];
            for point in points {
                let in_cam = cam_from_obj * Point3::from(point.position);
                let Some(pixel) = camera.intrinsics().project(&in_cam) else {
                    continue;
                };
                let cell = |pixel| cell_at(pixel, self.columns, camera.width());
                if let (Some(column), Some(row)) = (cell(pixel.x), cell(pixel.y)) {
                    covered[row * self.columns + column] = true;
                }
            }
            let count = covered.iter().filter(|covered| **covered).count().max(1);
            let of = |(covered, inlier): (&bool, &f64)| covered.then_some(*inlier);
            let sum: f64 = covered.iter().zip(inliers).filter_map(of).sum();
            (*view, sum / count as f64)
        };
        let crops = self.crops.iter().zip(inliers.chunks(cells.max(1)));
        crops.map(of_crop).collect()
    }
}

/// The trusted correspondences of a crop.
fn trusted<'a>(
    at: usize,
    crop: &'a Crop,
    codes: ArrayView3<'a, f32>,
    extent: f64,
    min_trust: f64,
) -> impl Iterator<Item = Correspondence> + 'a {
    let (_, rows, columns) = codes.dim();
    let center = move |n: usize| cell_center(n, columns, crop.camera.width());
    let world_from_cam = crop.camera.world_from_cam();
    let cells = (0..rows).flat_map(move |row| (0..columns).map(move |column| (row, column)));
    cells.filter_map(move |(row, column)| {
        let [x, y, z, trust] = [0, 1, 2, TRUST].map(|axis| f64::from(codes[(axis, row, column)]));
        // Not-a-number fails the comparison as well.
        let trusted = trust >= min_trust && [x, y, z].iter().all(|x| x.is_finite());
        let pixel = [center(column), center(row)].into();
        let ray = trusted
            .then(|| crop.camera.intrinsics().unproject(&pixel))
            .flatten()?;
        Some(Correspondence {
            crop: at,
            cell: row * columns + column,
            point: Point3::new(x, y, z) * extent,
            origin: world_from_cam.translation.vector.into(),
            direction: (world_from_cam.rotation * ray).normalize(),
            distance: 0.0,
            weight: trust,
        })
    })
}
