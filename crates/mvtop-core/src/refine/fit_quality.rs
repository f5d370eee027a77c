//! Fit of a pose to all views, to accept or reject a refinement.

use nalgebra::Isometry3;
use rayon::prelude::*;

use super::Refiner;
use super::view_quality::{Quality, ViewQuality};
use super::view_state::ViewState;

/// Fit of a pose to all views.
pub struct FitQuality {
    /// Mean over views of [`ViewState::edge_separation`]: for the outline, and for inner edges.
    separation: [f64; 2],
    /// Indices of the view states that show the outline; at least one.
    visible: Vec<usize>,
    /// Mean over these of [`ViewState::contour_inliers`].
    pub contour_inliers: f64,
    /// Mean over these of [`ViewState::contour_residual_px`], px of the crops.
    pub contour_residual_px: f64,
}

impl FitQuality {
    /// Whether colors separate the sides of all edges better than at another pose nearby, and neither
    /// the outline nor the inner edges get worse by the margin.
    pub fn is_better(&self, other: &Self, margin: f64) -> bool {
        let gain = |i: usize| self.separation[i] - other.separation[i];
        gain(0) + gain(1) > 0.0 && gain(0).min(gain(1)) > -margin
    }
}

impl Refiner {
    /// Evaluates a pose; `None` if no view shows the outline.
    pub(super) fn fit(
        &self,
        states: &mut [ViewState],
        pose: &Isometry3<f64>,
    ) -> Option<FitQuality> {
        let (step, [line_step, _]) = (self.config.final_step_px(), self.config.inlier_px);
        let one = |view: &mut ViewState| {
            view.update(pose, step);
            view.edge_separation(line_step)
        };
        let bits: Vec<[Option<f64>; 2]> = states.par_iter_mut().map(one).collect();
        let separation = [0, 1].map(|i| {
            let known = || bits.iter().filter_map(|bits| bits[i]);
            known().sum::<f64>() / known().count().max(1) as f64
        });
        let visible = (0..states.len()).filter(|&state| bits[state][0].is_some());
        let visible: Vec<usize> = visible.collect();
        let mean = |number: fn(&ViewState) -> f64| {
            let numbers = visible.iter().map(|&state| number(&states[state]));
            numbers.sum::<f64>() / visible.len() as f64
        };
        let contour_inliers = mean(|view| view.contour_inliers());
        let contour_residual_px = mean(|view| view.contour_residual_px());
        (!visible.is_empty()).then_some(FitQuality {
            separation,
            visible,
            contour_inliers,
            contour_residual_px,
        })
    }

    /// - `fit`: fit of the pose to which the states were last updated
    pub(super) fn quality_of(
        &self,
        states: &[ViewState],
        fit: &FitQuality,
        pose: &Isometry3<f64>,
    ) -> Quality {
        let texture = self.texture.as_ref();
        let one = |&state: &usize| {
            let view = &states[state];
            let [texture_correlation, texture_gain] =
                texture.map_or([None; 2], |texture| texture.evidence(view, pose));
            ViewQuality {
                view: view.index,
                contour_inliers: view.contour_inliers(),
                contour_residual_px: view.contour_residual_px() / view.scale,
                color_separation: view.color_separation().unwrap_or(0.0),
                mutual_information: view.mutual_information(),
                texture_correlation,
                texture_gain,
                visible_share: view.visible_share(),
            }
        };
        Quality {
            views: fit.visible.par_iter().map(one).collect(),
        }
    }
}
