//! Which objects of successive predictions are the same.

use std::sync::{Mutex, MutexGuard, PoisonError};

use mvtop_core::estimator;
use mvtop_core::estimator::TrackOptions;
use pyo3::prelude::*;

use crate::error::value;

/// Gives objects numbers that stay theirs over time: `Estimator.predict(..., tracks=tracks)`.
///
/// An object is the same as the nearest one of its class in earlier predictions, if it moved by less
/// than the bound; numbers start at 1, and none is given twice. The cameras may move, and be others.
/// Threads may share it: their predictions then run one after the other.
#[pyclass(frozen, module = "mvtop")]
pub struct Tracks(Mutex<estimator::Tracks>);

#[pymethods]
impl Tracks {
    /// Without any objects yet.
    ///
    /// Parameters
    /// ----------
    /// max_motion_m
    ///     Farthest that an object moves between two predictions, metres; None: half its diameter.
    /// patience
    ///     Predictions after which an object that is not found any more is forgotten.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     Where `max_motion_m` is below 0 or not finite.
    #[new]
    #[pyo3(signature = (*, max_motion_m = None, patience = 30))]
    fn new(max_motion_m: Option<f64>, patience: usize) -> PyResult<Self> {
        let tracks = estimator::Tracks::new(options(max_motion_m, patience)?);
        Ok(Self(Mutex::new(tracks)))
    }
}

impl Tracks {
    /// To be locked outside of a pool, see [`in_pool`](crate::process::in_pool).
    pub fn lock(&self) -> MutexGuard<'_, estimator::Tracks> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// How objects are followed; refuses a bound that is none.
pub fn options(max_motion_m: Option<f64>, patience: usize) -> PyResult<TrackOptions> {
    if let Some(reach) = max_motion_m.filter(|reach| !(reach.is_finite() && *reach >= 0.0)) {
        return Err(value(format!(
            "max_motion_m: expected metres, 0 or more, got {reach}"
        )));
    }
    let mut options = TrackOptions::default().with_patience(patience);
    options.max_motion_m = max_motion_m;
    Ok(options)
}
