//! Crops rolled about their axes: the network errs differently on each.

use nalgebra::Point3;

use super::crops::CropRequest;
use super::instance::Instance;
use super::pipeline::Pipeline;
use crate::closeup::CloseUp;

impl Pipeline<'_> {
    /// Requests for the rolled crops of an instance where its best pose puts it.
    ///
    /// - `object`: index of the requests
    pub(super) fn rolled(&self, object: usize, instance: &Instance) -> Vec<CropRequest<'_>> {
        let Some(best) = instance.best() else {
            return Vec::new();
        };
        let points = &self.estimator.bundle.classes[instance.class].points;
        let rolls = self.config().search.rolls_deg.iter();
        let request = |degrees: &f64| {
            let views = self.views.iter().enumerate().zip(&best.rois);
            let taken = views.filter_map(|((index, view), roi)| {
                roi.as_ref()?;
                let cam_from_obj = view.camera.world_from_cam().inv_mul(&best.world_from_obj);
                let points = points.iter().map(|one| Point3::from(one.position));
                let points: Vec<_> = points.map(|point| cam_from_obj * point).collect();
                let roll = degrees.to_radians();
                let closeup = CloseUp::rolled(
                    view.camera,
                    &points,
                    roll,
                    self.estimator.bundle.closeups.size,
                )?;
                Some((index, view, closeup))
            });
            let request = CropRequest {
                object,
                class: instance.class,
                taken: taken.collect(),
            };
            (!request.taken.is_empty()).then_some(request)
        };
        rolls.filter_map(request).collect()
    }
}
