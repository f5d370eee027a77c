//! More looks at objects that the first one leaves open, through close-ups that are rolled.
//!
//! A close-up that is rolled shows the same, but the network errs otherwise: where one look takes what
//! is hardly seen for something else, most others do not.

use nalgebra::{Isometry3, Point3};

use super::pass::Pass;
use super::picture::{self, CloseUpsOf};
use super::pose::DecodedPose;
use super::sightings::Sighting;
use super::view::View;
use crate::Result;
use crate::bundle::CloseUps;
use crate::closeup::CloseUp;

/// By which close-ups are rolled, degrees: as far as most are in training.
pub(super) const ROLLS_DEG: [f64; 4] = [20.0, -20.0, 40.0, -40.0];

impl Pass<'_> {
    /// The poses of each look at objects that seem to be at some places in the world.
    pub(super) fn rolled_looks(
        &self,
        closeups: &CloseUps,
        places: &[(&Sighting, Isometry3<f64>)],
    ) -> Result<Vec<Vec<DecodedPose>>> {
        let bundle = &self.estimator.bundle;
        let (mut looks, mut of) = (Vec::new(), Vec::new());
        for (place, (object, world_from_obj)) in places.iter().enumerate() {
            let points = &bundle.classes[object.class].points;
            let with_box = self.views.iter().zip(&object.boxes);
            let views = with_box.filter(|(_, bbox)| bbox.is_some());
            let seen = views.map(|(view, _)| {
                let cam_from_obj = view.camera.world_from_cam().inv_mul(world_from_obj);
                let points = points.iter().map(|one| Point3::from(one.position));
                (view, points.map(|point| cam_from_obj * point).collect())
            });
            let seen: Vec<(&View, Vec<Point3<f64>>)> = seen.collect();
            for degrees in ROLLS_DEG {
                let taken = seen.iter().filter_map(|(view, points)| {
                    let roll = degrees.to_radians();
                    let closeup = CloseUp::rolled(view.camera, points, roll, closeups.size)?;
                    Some((*view, closeup))
                });
                let (class, taken) = (object.class, taken.collect::<Vec<_>>());
                if !taken.is_empty() {
                    of.push(place);
                    looks.push(CloseUpsOf { class, taken });
                }
            }
        }
        let (pictures, groups) = picture::in_closeups(self.network, bundle, closeups, looks)?;
        let mut found = vec![Vec::new(); places.len()];
        for (place, pose) in of.into_iter().zip(self.poses(&pictures, &groups)?) {
            found[place].push(pose);
        }
        Ok(found)
    }
}
