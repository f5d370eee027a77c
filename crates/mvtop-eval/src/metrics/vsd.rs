//! Visible surface discrepancy.

use super::depth::{DepthImage, distance};
use crate::{Error, Result};
use mvtop_core::camera::Intrinsics;

/// BOP's misalignment tolerances, as shares of the object's diameter.
pub const VSD_TAUS: [f64; 10] = [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5];

/// What a pixel costs that both poses show, at different distances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MatchingCost {
    /// 1 from the tolerance on, else 0: BOP's, since 2017.
    #[default]
    Step,
    /// Share of the tolerance, at most 1: the first definition, of 2016.
    TruncatedLinear,
}

/// How [`vsd`] is to be measured.
#[derive(Debug, Clone, PartialEq)]
pub struct VsdOptions {
    /// How far a surface may lie behind the measured one and still be seen; BOP: 15 mm, for ITODD
    /// 5 mm. In the unit of the depth images.
    pub delta: f64,
    /// Misalignment tolerances: shares of `diameter`, else in the unit of the depth images.
    pub taus: Vec<f64>,
    /// Divides distances where given, as BOP does.
    pub diameter: Option<f64>,
    /// Of a pixel that both poses show.
    pub cost: MatchingCost,
}

/// VSD: share of the visible pixels of both poses where the object's surfaces do not coincide; one
/// number for each tolerance, from 0 to 1.
///
/// Visible is what lies no more than `delta` behind the measured surface or where nothing was
/// measured ("bop19"), and, for the estimated pose, what covers visible pixels of the true one. 1
/// where nothing is visible.
///
/// - `estimate`, `truth`: depth images of the object, see [`super::depth`]
/// - `measured`: depth image of the scene, 0 where nothing was measured
/// - `intrinsics`: a pinhole; its distortion is not used
///
/// # Errors
/// [`Error::Input`] where the images' sizes differ, `delta` is below 0, or a tolerance or the diameter
/// is not above 0.
///
/// Source: Hodaň, Michel et al., "BOP: Benchmark for 6D Object Pose Estimation", 2018; `vsd` of
/// bop_toolkit.
pub fn vsd(
    estimate: &DepthImage,
    truth: &DepthImage,
    measured: &DepthImage,
    intrinsics: &Intrinsics,
    options: &VsdOptions,
) -> Result<Vec<f64>> {
    if estimate.dim() != truth.dim() || measured.dim() != truth.dim() {
        let size = |image: &DepthImage| format!("{}x{}", image.ncols(), image.nrows());
        return Err(Error::Input(format!(
            "VSD: expected three depth images of one size, got {} (estimate), {} (truth) and {} \
             (measured)",
            size(estimate),
            size(truth),
            size(measured)
        )));
    }
    let above_0 = |x: &f64| x.is_finite() && *x > 0.0;
    let tolerated = options.delta >= 0.0 && options.taus.iter().all(above_0);
    if !(tolerated && options.diameter.iter().all(above_0)) {
        return Err(Error::Input(format!(
            "VSD: expected delta of 0 or more, taus and diameter above 0, got {}, {:?} and {:?}",
            options.delta, options.taus, options.diameter
        )));
    }
    let (mut union, mut both) = (0_usize, 0_usize);
    let mut costs = vec![0.0; options.taus.len()];
    let rows = truth
        .rows()
        .into_iter()
        .zip(estimate.rows())
        .zip(measured.rows());
    for (row, ((truth, estimate), measured)) in rows.enumerate() {
        for (column, ((&true_depth, &estimated), &measured)) in
            truth.iter().zip(estimate).zip(measured).enumerate()
        {
            if true_depth <= 0.0 && estimated <= 0.0 {
                continue;
            }
            let distance = |depth: f32| distance(f64::from(depth), intrinsics, row, column);
            let (of_truth, of_estimate) = (distance(true_depth), distance(estimated));
            let scene = distance(measured);
            // In single precision like the toolkit's, so that the same pixels count as visible.
            let seen = |model: f64| {
                model > 0.0 && (scene == 0.0 || model as f32 - scene as f32 <= options.delta as f32)
            };
            let true_seen = seen(of_truth);
            let estimate_seen = seen(of_estimate) || (true_seen && of_estimate > 0.0);
            union += usize::from(true_seen || estimate_seen);
            if !(true_seen && estimate_seen) {
                continue;
            }
            both += 1;
            let off = (of_truth - of_estimate).abs() / options.diameter.unwrap_or(1.0);
            for (cost, &tau) in costs.iter_mut().zip(&options.taus) {
                *cost += match options.cost {
                    MatchingCost::Step => f64::from(u8::from(off >= tau)),
                    MatchingCost::TruncatedLinear => (off / tau).min(1.0),
                };
            }
        }
    }
    let only_one = (union - both) as f64;
    let share = |cost: f64| match union {
        0 => 1.0,
        _ => (cost + only_one) / union as f64,
    };
    Ok(costs.into_iter().map(share).collect())
}
