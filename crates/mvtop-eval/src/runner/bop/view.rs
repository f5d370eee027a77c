//! The reference view, in which BOP measures errors.

use crate::bop::Model;
use crate::metrics::{DepthImage, MatchingCost, PixelCenter, VSD_TAUS, VsdOptions, vsd};
use mvtop_core::Camera;
use nalgebra::Isometry3;

use crate::Result;

/// Width for which BOP's MSPD thresholds are made, px.
const MSPD_WIDTH: f64 = 640.0;

/// What an error is measured against.
pub struct View<'a> {
    /// Of the reference image.
    pub camera: &'a Camera,
    /// Its depth image, metres.
    pub depth: Option<&'a DepthImage>,
    /// See [`VsdOptions::delta`], metres.
    pub vsd_delta: f64,
}

impl View<'_> {
    /// Infinite where a pose is behind the camera.
    ///
    /// - `truth`, `estimate`: camera frame
    pub fn mspd_px640(
        &self,
        model: &Model,
        truth: &Isometry3<f64>,
        estimate: &Isometry3<f64>,
    ) -> f64 {
        let intrinsics = self.camera.intrinsics();
        let px = model
            .surface
            .mspd(truth, estimate, &model.symmetries, intrinsics);
        px * MSPD_WIDTH / f64::from(self.camera.width())
    }

    /// VSD by tolerance, then estimate, then truth; `None` where it cannot be measured. Like
    /// bop_toolkit: its renderers sample pixels half a pixel beside the measured ones.
    ///
    /// - `truth`, `estimates`: camera frame
    pub fn vsd_of_all(
        &self,
        model: &Model,
        truth: &[Isometry3<f64>],
        estimates: &[Isometry3<f64>],
    ) -> Result<Option<Vec<Vec<Vec<f64>>>>> {
        let intrinsics = self.camera.intrinsics();
        // Models for evaluation may be points alone.
        let rendered = intrinsics.is_pinhole() && !model.mesh.triangles().is_empty();
        let Some(measured) = self.depth.filter(|_| rendered) else {
            return Ok(None);
        };
        let size = [self.camera.width(), self.camera.height()];
        let depths = |poses: &[Isometry3<f64>]| -> Result<Vec<DepthImage>> {
            let depth = |pose| {
                crate::metrics::depth(&model.mesh, pose, intrinsics, size, PixelCenter::Half)
            };
            poses.iter().map(depth).collect()
        };
        let options = VsdOptions {
            delta: self.vsd_delta,
            taus: VSD_TAUS.to_vec(),
            diameter: Some(model.diameter_m),
            cost: MatchingCost::Step,
        };
        let truth = depths(truth)?;
        let mut by_tau = vec![Vec::with_capacity(estimates.len()); VSD_TAUS.len()];
        for estimate in estimates {
            // One at a time: there may be hundreds.
            let estimate = &depths(std::slice::from_ref(estimate))?[0];
            let mut of_estimate = vec![Vec::with_capacity(truth.len()); VSD_TAUS.len()];
            for truth in &truth {
                let errors = vsd(estimate, truth, measured, intrinsics, &options)?;
                for (tau, error) in of_estimate.iter_mut().zip(errors) {
                    tau.push(error);
                }
            }
            for (tau, errors) in by_tau.iter_mut().zip(of_estimate) {
                tau.push(errors);
            }
        }
        Ok(Some(by_tau))
    }
}
