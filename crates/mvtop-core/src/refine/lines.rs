//! The edges of one object in one view, for what moves cameras as well as objects.

use nalgebra::Isometry3;

use super::solve::Row;
use super::{Refiner, View, Working};
use crate::Result;

/// One object in one view.
pub struct Lines {
    working: Working,
}

impl Lines {
    /// `None` where the object does not lie in the image.
    ///
    /// - `cam_from_obj`: where it is about
    ///
    /// # Errors
    /// Those of [`crate::Camera::moved_to`].
    pub fn new(
        refiner: &Refiner,
        view: &View,
        cam_from_obj: &Isometry3<f64>,
    ) -> Result<Option<Self>> {
        // The camera is the world here, so that it may be moved later.
        let camera = view.camera.moved_to(Isometry3::identity())?;
        let view = View {
            camera: &camera,
            image: view.image,
        };
        let working = Working::new(refiner, 0, &view, cam_from_obj);
        Ok(working.map(|working| Self { working }))
    }

    /// Where the edges are found of the object at this pose. What changes with the pose does so by a
    /// turn about the object's center and a shift, both in the camera's frame.
    ///
    /// - `step`: px between what is looked at
    pub fn look(&mut self, refiner: &Refiner, cam_from_obj: &Isometry3<f64>, step: f64) -> &[Row] {
        self.working.look(refiner, cam_from_obj, step);
        &self.working.rows
    }
}
