//! Visible difference of an object at two poses.

use nalgebra::Isometry3;

use super::Refiner;
use super::mesh_model::BACKGROUND;
use super::raster::Raster;
use super::view_state::projected_box;
use crate::Camera;
use crate::closeup::CloseUp;

impl Refiner {
    /// Share of the pixels that show another segment at the second pose, among those that show the
    /// object at either; 0 if the camera does not see all of it at the first pose.
    pub fn difference(
        &self,
        camera: &Camera,
        world_from_obj: &Isometry3<f64>,
        other: &Isometry3<f64>,
    ) -> f64 {
        let rendered = || {
            let bbox = projected_box(&self.mesh.vertices, camera, world_from_obj)?;
            let is_inside = bbox.clip(camera.width(), camera.height()) == Some(bbox);
            let side = self.config.coarse.side_px[0] as u32;
            let closeup = CloseUp::new(camera, bbox, side).filter(|_| is_inside)?;
            let render = |pose| {
                let mut raster = Raster::default();
                let is_complete = raster.render(&self.mesh, &closeup.camera, pose);
                is_complete.then_some(raster)
            };
            Some([render(world_from_obj)?, render(other)?])
        };
        let Some([first, second]) = rendered() else {
            return 0.0;
        };
        let pixels = first.labels().iter().zip(second.labels());
        let shown = pixels.filter(|(a, b)| **a != BACKGROUND || **b != BACKGROUND);
        let (differ, all) = shown.fold((0.0, 0.0), |(differ, all), (a, b)| {
            (differ + if a == b { 0.0 } else { 1.0 }, all + 1.0)
        });
        differ / f64::max(all, 1.0)
    }
}
