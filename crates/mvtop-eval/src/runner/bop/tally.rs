//! How many targets are right, as BOP's evaluation counts them.

use crate::bop::{Model, count_right};
use crate::metrics::{MSPD_THRESHOLDS_PX, MSSD_THRESHOLDS, VSD_TAUS, VSD_THRESHOLDS};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use super::view::View;
use crate::Result;

/// How many targets of one object in one image are right.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Number of the object.
    pub obj_id: u32,
    /// True instances that count.
    pub targets: usize,
    /// Estimates that count.
    pub estimates: usize,
    /// Right ones, summed over the ten thresholds.
    pub mssd: usize,
    /// The same.
    pub mspd: usize,
    /// The same over ten tolerances as well; null where VSD cannot be measured.
    pub vsd: Option<usize>,
}

/// BOP's average recalls of many.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recalls {
    pub mssd: Option<f64>,
    pub mspd: Option<f64>,
    /// Over the objects in images with depth.
    pub vsd: Option<f64>,
    /// The mean of the three, where there is VSD of all objects.
    pub all: Option<f64>,
}

impl Tally {
    /// - `truth`: poses of the targets, world frame
    /// - `estimates`: poses, surest first
    pub(super) fn new(
        truth: &[Isometry3<f64>],
        estimates: &[Isometry3<f64>],
        model: &Model,
        view: &View,
    ) -> Result<Self> {
        let cam_from_world = view.camera.world_from_cam().inverse();
        let seen = |poses: &[Isometry3<f64>]| -> Vec<Isometry3<f64>> {
            poses.iter().map(|pose| cam_from_world * pose).collect()
        };
        let (truth, estimates) = (seen(truth), seen(estimates));
        let errors = |error: &dyn Fn(usize, usize) -> f64| -> Vec<Vec<f64>> {
            let of_estimate = |e| (0..truth.len()).map(|t| error(e, t)).collect();
            (0..estimates.len()).map(of_estimate).collect()
        };
        let (surface, symmetries) = (&model.surface, &model.symmetries);
        let mssd = errors(&|e, t| surface.mssd(&truth[t], &estimates[e], symmetries));
        let mspd = errors(&|e, t| view.mspd_px640(model, &truth[t], &estimates[e]));
        let vsd = view.vsd_of_all(model, &truth, &estimates)?;
        let right = |errors: &[Vec<f64>], thresholds: &[f64], unit: f64| -> usize {
            let right = thresholds.iter().map(|&at| count_right(errors, at * unit));
            right.sum()
        };
        Ok(Self {
            obj_id: model.id,
            targets: truth.len(),
            estimates: estimates.len(),
            mssd: right(&mssd, &MSSD_THRESHOLDS, model.diameter_m),
            mspd: right(&mspd, &MSPD_THRESHOLDS_PX, 1.0),
            vsd: vsd.map(|by_tau| {
                let right = by_tau
                    .iter()
                    .map(|errors| right(errors, &VSD_THRESHOLDS, 1.0));
                right.sum()
            }),
        })
    }
}

impl Recalls {
    pub fn new(tallies: &[&Tally]) -> Self {
        let share = |tallies: &[&Tally], right: fn(&Tally) -> usize, each: usize| {
            let of: usize = tallies.iter().map(|tally| tally.targets * each).sum();
            let right: usize = tallies.iter().map(|tally| right(tally)).sum();
            (of > 0).then(|| right as f64 / of as f64)
        };
        let (with_vsd, without): (Vec<&Tally>, Vec<&Tally>) =
            tallies.iter().partition(|tally| tally.vsd.is_some());
        let mssd = share(tallies, |tally| tally.mssd, MSSD_THRESHOLDS.len());
        let mspd = share(tallies, |tally| tally.mspd, MSPD_THRESHOLDS_PX.len());
        let each = VSD_TAUS.len() * VSD_THRESHOLDS.len();
        let vsd = share(&with_vsd, |tally| tally.vsd.unwrap_or(0), each);
        let all = || Some((mssd? + mspd? + vsd?) / 3.0);
        let whole = without.iter().all(|tally| tally.targets == 0);
        Self {
            mssd,
            mspd,
            vsd,
            all: all().filter(|_| whole),
        }
    }
}
