//! How differently a camera would see an object at two poses.

use nalgebra::Isometry3;

use super::Refiner;
use super::part::BACKGROUND;
use super::raster::Raster;
use super::working::around;
use crate::Camera;
use crate::closeup::CloseUp;

/// Side of the close-up in which poses are compared, px.
const SIDE: u32 = 96;

impl Refiner {
    /// Of the pixels that show the object at either pose, the share that show another part of it or
    /// none at the other, 0 to 1; 0 where the camera does not see all of it at the first.
    pub fn difference(
        &self,
        camera: &Camera,
        world_from_obj: &Isometry3<f64>,
        other: &Isometry3<f64>,
    ) -> f64 {
        let closeup = around(&self.part.vertices, camera, world_from_obj)
            .filter(|bbox| bbox.clip(camera.width(), camera.height()) == Some(*bbox))
            .and_then(|bbox| CloseUp::new(camera, bbox, SIDE));
        let Some(closeup) = closeup else {
            return 0.0;
        };
        let drawn = |pose: &Isometry3<f64>| {
            let mut raster = Raster::default();
            let camera = &closeup.camera;
            let cam_from_obj = camera.world_from_cam().inv_mul(pose);
            let all = raster.draw(
                &self.part,
                &cam_from_obj,
                camera.intrinsics(),
                SIDE as usize,
            );
            all.then_some(raster)
        };
        let (Some(first), Some(second)) = (drawn(world_from_obj), drawn(other)) else {
            return 0.0;
        };
        let pixels = first.labels().iter().zip(second.labels());
        let shown = pixels.filter(|(a, b)| **a != BACKGROUND || **b != BACKGROUND);
        let (mut differ, mut count) = (0.0, 0.0);
        for (a, b) in shown {
            differ += if a == b { 0.0 } else { 1.0 };
            count += 1.0;
        }
        differ / f64::max(count, 1.0)
    }
}
