//! More looks at objects that the first one leaves open, through close-ups that are rolled.
//!
//! A close-up that is rolled shows the same, but the network errs otherwise: where one look takes what
//! is hardly seen for something else, most others do not.

use nalgebra::{Isometry3, Point3};

use super::pass::Pass;
use super::picture::{self, CloseUpsOf};
use super::pose::DecodedPose;
use super::sightings::Sighting;
use crate::Result;
use crate::bundle::PoseInput;
use crate::closeup::CloseUp;

/// By which close-ups are rolled, degrees: as far as most are in training.
pub(super) const ROLLS_DEG: [f64; 4] = [20.0, -20.0, 40.0, -40.0];

impl Pass<'_> {
    /// The poses of each look, of objects that seem to be at some places; none for networks that decode
    /// whole images.
    ///
    /// - `places`: index into `objects`, and pose in the world
    pub(super) fn rolled_looks(
        &self,
        objects: &[Sighting],
        places: &[(usize, Isometry3<f64>)],
    ) -> Result<Vec<Vec<DecodedPose>>> {
        let bundle = &self.estimator.bundle;
        let PoseInput::CloseUps(closeups) = &bundle.poses else {
            return Ok(vec![Vec::new(); places.len()]);
        };
        let (mut looks, mut of) = (Vec::new(), Vec::new());
        for (place, (index, world_from_obj)) in places.iter().enumerate() {
            let object = &objects[*index];
            let points = &bundle.classes[object.class].points;
            let with_box = self.views.iter().zip(&object.boxes);
            let views: Vec<_> = with_box
                .filter_map(|(view, bbox)| bbox.map(|_| view))
                .collect();
            for degrees in ROLLS_DEG {
                let taken = views.iter().filter_map(|&view| {
                    let cam_from_obj = view.camera.world_from_cam().inv_mul(world_from_obj);
                    let seen = points
                        .iter()
                        .map(|one| cam_from_obj * Point3::from(one.position));
                    let points: Vec<Point3<f64>> = seen.collect();
                    let roll = degrees.to_radians();
                    Some((
                        view,
                        CloseUp::rolled(view.camera, &points, roll, closeups.size)?,
                    ))
                });
                let taken: Vec<_> = taken.collect();
                if !taken.is_empty() {
                    of.push(place);
                    looks.push(CloseUpsOf {
                        class: object.class,
                        taken,
                    });
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
