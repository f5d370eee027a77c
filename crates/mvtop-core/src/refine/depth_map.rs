//! Depth of an object at a pose, as one camera sees it.

use nalgebra::{Isometry3, Point3};

use super::Refiner;
use super::raster::Raster;
use super::view_state::projected_box;
use crate::Camera;
use crate::closeup::CloseUp;

/// The surface of an object at a pose, rendered into a crop of one camera.
pub struct DepthMap {
    /// A pinhole at the camera's center that looks at the object.
    crop: Camera,
    raster: Raster,
}

impl Refiner {
    /// `None` where the lens does not image the whole object.
    pub fn depth_map(&self, camera: &Camera, world_from_obj: &Isometry3<f64>) -> Option<DepthMap> {
        let bbox = projected_box(&self.mesh.vertices, camera, world_from_obj)?;
        let side = self.config.coarse.side_px[0] as u32;
        let crop = CloseUp::new(camera, bbox, side)?.camera;
        let mut raster = Raster::default();
        let is_complete = raster.render(&self.mesh, &crop, world_from_obj);
        is_complete.then_some(DepthMap { crop, raster })
    }
}

impl DepthMap {
    /// How far a point lies behind the surface, along the axis of the crop, metres: negative before
    /// it, minus infinity where the line of sight misses the object.
    ///
    /// - `point`: world frame, metres
    pub fn behind(&self, point: &Point3<f64>) -> f64 {
        let point = self.crop.world_from_cam().inverse_transform_point(point);
        let pixel = self.crop.intrinsics().project(&point);
        let index = pixel.and_then(|pixel| self.raster.index(pixel));
        index.map_or(f64::NEG_INFINITY, |index| {
            point.z - self.raster.depth(index)
        })
    }
}
