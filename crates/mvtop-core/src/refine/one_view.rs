//! Refinement of a pose in one view alone, on a coarse crop: exact enough to compare views.

use nalgebra::{Isometry3, Matrix6};

use super::gauss_newton::Prior;
use super::view_state::ViewState;
use super::{Refiner, View};
use crate::prediction::Sigma;

/// A pose by one view.
#[derive(Debug, Clone)]
pub struct ByOneView {
    /// Object frame to world frame, metres; a start where the edges do not fit any better.
    pub world_from_obj: Isometry3<f64>,
    /// Inverse covariance by the image and the prior: rotation about the object's center (radians) and
    /// translation (metres), world frame.
    pub information: Matrix6<f64>,
    /// Share of inliers among the contour points.
    pub contour_inliers: f64,
}

impl Refiner {
    /// The pose with the most inliers among those near some starts, which are tried in order until one
    /// has enough; `None` if the view does not show the object.
    ///
    /// - `sigma`: expected error of each start
    /// - `enough`: share of inliers
    pub fn refine_in_one_view(
        &self,
        view: &View,
        starts: &[Isometry3<f64>],
        sigma: Sigma,
        enough: f64,
    ) -> Option<ByOneView> {
        let mut crop: Option<ViewState> = None;
        let mut best: Option<ByOneView> = None;
        for start in starts {
            // Starts that are near each other share a crop.
            let state = match crop.take().filter(|state| state.holds(view.camera, start)) {
                Some(state) => Some(state),
                None => ViewState::new(self, 0, view, start, &self.config.coarse),
            };
            let Some(mut state) = state else { continue };
            let found = self.near(&mut state, start, sigma);
            crop = Some(state);
            let inliers = |one: &ByOneView| one.contour_inliers;
            if found.as_ref().map(inliers) > best.as_ref().map(inliers) {
                best = found;
            }
            if best.as_ref().map(inliers) >= Some(enough) {
                break;
            }
        }
        best
    }

    /// The pose near a start.
    fn near(
        &self,
        state: &mut ViewState,
        start: &Isometry3<f64>,
        sigma: Sigma,
    ) -> Option<ByOneView> {
        let states = std::slice::from_mut(state);
        let initial = self.fit(states, start)?;
        let steps = &self.config.one_view_steps_px;
        let (pose, information) =
            self.descended(states, &Prior::new(*start, sigma), start, steps)?;
        let margin = self.config.accept_margin_bits;
        let better = self.fit(states, &pose);
        let better = better.filter(|fit| fit.is_better(&initial, margin));
        Some(ByOneView {
            world_from_obj: better.as_ref().map_or(*start, |_| pose),
            information,
            contour_inliers: better.unwrap_or(initial).contour_inliers,
        })
    }
}
