//! What one view by itself tells of an object's pose, near a pose that all views have.

use nalgebra::{Isometry3, Matrix6};

use super::solve::{self, Prior};
use super::working::{COARSE, Working};
use super::{Refiner, View};
use crate::Result;
use crate::prediction::Sigma;

/// How far from the common pose a view's own one is looked for.
const NEAR: Sigma = Sigma {
    rot_deg: 20.0,
    t_m: 0.05,
};
/// A view that shows a smaller share of the edges tells nothing.
const LEAST_SHOWN: f64 = 0.3;

/// One object in one view.
pub struct Lines {
    working: Working,
}

/// What a view tells.
pub struct Told {
    /// Where it shows the object by itself, metres.
    pub cam_from_obj: Isometry3<f64>,
    /// Mean square of the way that edges make across themselves, px of the close-up, by a turn about
    /// the object's center (radians) and a shift (metres) in the camera's frame: inverse covariance of
    /// the pose were they off by a pixel. Zero in directions that the view does not tell.
    pub edges: Matrix6<f64>,
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
        let working = Working::new(refiner, 0, &view, cam_from_obj, COARSE);
        Ok(working.map(|working| Self { working }))
    }

    /// What the image shows near this pose; `None` where it does not show the object.
    ///
    /// - `step`: px between what is looked at
    pub fn told(
        &mut self,
        refiner: &Refiner,
        cam_from_obj: &Isometry3<f64>,
        step: f64,
    ) -> Option<Told> {
        self.working.look(refiner, cam_from_obj, step);
        let (rows, center) = (&self.working.rows, &refiner.part.center);
        let (radius, scale) = (refiner.diameter / 4.0, 1.0 + 1.5 * step);
        let prior = Prior::new(*cam_from_obj, NEAR);
        let own = solve::step(&[rows], &prior, cam_from_obj, center, radius, scale)?;
        let (mut edges, mut all, mut shown) = (Matrix6::zeros(), 0.0, 0.0);
        for row in rows {
            let off = row.offset - row.by_pose.dot(&own.motion);
            let robust = (1.0 + (off / scale).powi(2)).powi(-2);
            let weight = robust / row.variance;
            edges += row.by_pose * row.by_pose.transpose() * weight;
            all += weight;
            shown += robust * (2.0 * step * step / row.variance).min(1.0);
        }
        let shown = Some(shown / rows.len() as f64).filter(|shown| *shown > LEAST_SHOWN)?;
        let edges = edges * (shown / all);
        let told = solve::told(&edges, radius)?;
        Some(Told {
            cam_from_obj: solve::moved(cam_from_obj, center, &own.motion),
            edges: told * edges * told.transpose(),
        })
    }
}
