//! Correspondence lines of one view, which measure the pose of an object near a common pose.

use nalgebra::{Isometry3, Matrix6};

use super::gauss_newton::{Prior, robust_scale};
use super::view_state::ViewState;
use super::{Refiner, View};
use crate::Result;
use crate::prediction::Sigma;

/// Weak prior, which keeps the system regular.
const PRIOR: Sigma = Sigma {
    rot_deg: 20.0,
    t_m: 0.05,
};
/// Least share of inliers, by robust weight, of a view that measures the pose.
const MIN_INLIERS: f64 = 0.3;

/// Correspondence lines of one object in one view.
pub struct CorrespondenceLines<'a> {
    state: ViewState<'a>,
}

/// Measurement of a pose by one view.
pub struct Measurement {
    /// The pose by this view alone, metres.
    pub cam_from_obj: Isometry3<f64>,
    /// Inverse covariance of the pose if each edge were off by 1 px of the crop: rotation about the
    /// object's center (radians) and translation (metres), camera frame. Zero in unobservable
    /// directions.
    pub information: Matrix6<f64>,
}

impl<'a> CorrespondenceLines<'a> {
    /// `None` if the object does not lie in the image.
    ///
    /// # Errors
    /// Those of [`crate::Camera::moved_to`].
    pub fn new(
        refiner: &'a Refiner,
        view: &View,
        cam_from_obj: &Isometry3<f64>,
    ) -> Result<Option<Self>> {
        // The camera frame is the world frame, so that the camera may be moved later.
        let camera = view.camera.moved_to(Isometry3::identity())?;
        let view = View {
            camera: &camera,
            image: view.image,
        };
        let state = ViewState::new(refiner, 0, &view, cam_from_obj, &refiner.config.coarse);
        Ok(state.map(|state| Self { state }))
    }

    /// Measures the pose near a given one; `None` if the image does not show the object there.
    ///
    /// - `step`: px between the samples of a line
    pub fn measure(&mut self, cam_from_obj: &Isometry3<f64>, step: f64) -> Option<Measurement> {
        self.state.update(cam_from_obj, step);
        let (refiner, residuals) = (self.state.refiner, &self.state.residuals);
        let prior = Prior::new(*cam_from_obj, PRIOR);
        let found = refiner.gauss_newton(&[residuals], &prior, cam_from_obj, step)?;
        let (mut information, mut all, mut inliers) = (Matrix6::zeros(), 0.0, 0.0);
        for one in residuals {
            let robust = one.robust_weight(&found.motion, robust_scale(step));
            let weight = robust / one.edge.variance;
            information += one.jacobian * one.jacobian.transpose() * weight;
            all += weight;
            inliers += robust * (2.0 * step * step / one.edge.variance).min(1.0);
        }
        let share = inliers / residuals.len() as f64;
        let share = Some(share).filter(|share| *share > MIN_INLIERS)?;
        let information = information * (share / all);
        let observable = refiner.observable_projector(&information)?;
        Some(Measurement {
            cam_from_obj: found.world_from_obj,
            information: observable * information * observable.transpose(),
        })
    }
}
