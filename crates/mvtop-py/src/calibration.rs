//! What images say of a rig.

use std::collections::BTreeMap;
use std::sync::Arc;

use mvtop_core::calibration::{Correction, Observed};
use pyo3::prelude::*;

use crate::convert::{self, F64};
use crate::error::{python, value};
use crate::process::compute;
use crate::rig::Rig;

/// What sets of images say of a rig, from `Estimator.check_rig`.
#[pyclass(frozen, module = "mvtop")]
pub struct RigCheck {
    observed: Arc<Observed>,
    rig: Arc<mvtop_core::Rig>,
}

/// How a camera is to be moved to where images show it.
#[pyclass(frozen, get_all, module = "mvtop")]
pub struct RigCorrection {
    /// Id of the camera.
    camera: String,
    /// From where it stands to where the images show it, in its own axes, metres; (4, 4).
    cam_from_shown: F64,
    /// Standard deviation of the turn, about the axis that is known least, degrees.
    turn_sd_deg: f64,
    /// Standard deviation of the move, along the axis that is known least, metres.
    shift_sd_m: f64,
    /// How many standard deviations it is, turn and move together.
    deviation: f64,
    /// On how many objects the camera agrees with others once it is moved.
    objects: usize,
    /// Whether the camera does not stand where the rig says: one object alone does not tell.
    is_off: bool,
    /// Whether the images tell where it stands.
    is_told: bool,
}

/// A rig some of whose cameras were moved to where images show them.
#[pyclass(frozen, get_all, module = "mvtop")]
pub struct RefinedRig {
    /// The rig; cameras that are not in `moved` stand where they stood.
    rig: Py<Rig>,
    /// How cameras were moved.
    moved: Vec<Py<RigCorrection>>,
    /// By ids of two cameras, as `RigCheck.pairs`, of the new rig.
    pairs: BTreeMap<(String, String), f64>,
    /// How far edges are off in sets that were held out one by one, by the rig as given and by what the
    /// other sets show: means, px of close-ups; None of one set.
    held_out_px: Option<(f64, f64)>,
}

#[pymethods]
impl RigCheck {
    /// What is wrong with the rig, in one sentence; None where the images do not contradict it. That
    /// is not to say that it is right: `corrections` tells how far off it may be.
    #[getter]
    fn problem(&self) -> Option<String> {
        self.observed.problem()
    }

    /// How many objects two cameras or more show, over all sets.
    #[getter]
    fn objects(&self) -> usize {
        self.observed.objects()
    }

    /// How many of these two cameras or more agree on.
    #[getter]
    fn agreeing(&self) -> usize {
        self.observed.agreeing()
    }

    /// What edges of one object in one view are found to err by together, px of close-ups.
    #[getter]
    fn noise_px(&self) -> f64 {
        self.observed.noise_px()
    }

    /// By ids of two cameras, how far the edges of the objects that both show are off at the poses on
    /// which both agree best: mean, px of close-ups.
    #[getter]
    fn pairs(&self) -> BTreeMap<(String, String), f64> {
        pairs(&self.observed, &self.rig)
    }

    /// The fewest cameras whose being off explains the images; empty where these do not contradict the
    /// rig.
    #[getter]
    fn off(&self) -> Vec<RigCorrection> {
        self.shown(&self.observed.off().cameras)
    }

    /// Whether no other cameras explain the images as well as `off`: of two cameras, either may be the
    /// wrong one.
    #[getter]
    fn is_told(&self) -> bool {
        self.observed.off().is_told
    }

    /// How each other camera would be moved, if one stands where the rig says.
    ///
    /// Parameters
    /// ----------
    /// base
    ///     Id of that one; the reference by default.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     Where the rig has no such camera.
    #[pyo3(signature = (base = None))]
    fn corrections(&self, base: Option<&str>) -> PyResult<Vec<RigCorrection>> {
        let index = match base {
            None => self.rig.reference(),
            Some(id) => self.rig.index_of(id).ok_or_else(|| {
                let ids: Vec<_> = self.rig.cameras().iter().map(|c| c.id()).collect();
                let ids = ids.join(", ");
                value(format!(
                    "base: no camera `{id}` in the rig, expected one of: {ids}"
                ))
            })?,
        };
        Ok(self.shown(&self.observed.corrections(index)))
    }

    /// The rig with the cameras of `off` where the images show them.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     Where there are none, where the images tell too little of where one stands, and where
    ///     sets that were held out fit no better.
    fn refined(&self, py: Python) -> PyResult<RefinedRig> {
        let cameras: Vec<usize> = self
            .observed
            .off()
            .cameras
            .iter()
            .map(|c| c.camera)
            .collect();
        let refined = compute(py, || self.observed.refined(&cameras))?.map_err(python)?;
        let rig = Arc::new(refined.accepted().map_err(python)?.clone());
        let moved = self.shown(&refined.moved).into_iter();
        Ok(RefinedRig {
            pairs: pairs(&self.observed, &rig),
            rig: Py::new(py, Rig::of(rig))?,
            moved: moved
                .map(|camera| Py::new(py, camera))
                .collect::<PyResult<_>>()?,
            held_out_px: refined.held_out_px().map(Into::into),
        })
    }

    fn __repr__(&self) -> String {
        match self.problem() {
            Some(problem) => format!("RigCheck({problem})"),
            None => "RigCheck(no camera was found to be off)".into(),
        }
    }
}

impl RigCheck {
    pub fn new(observed: Observed, rig: Arc<mvtop_core::Rig>) -> Self {
        let observed = Arc::new(observed);
        Self { observed, rig }
    }

    fn shown(&self, corrections: &[Correction]) -> Vec<RigCorrection> {
        let one = |correction: &Correction| RigCorrection {
            camera: self.rig.cameras()[correction.camera].id().to_owned(),
            cam_from_shown: convert::matrix(&correction.cam_from_shown),
            turn_sd_deg: correction.sigma.turn_deg,
            shift_sd_m: correction.sigma.shift_m,
            deviation: correction.deviation,
            objects: correction.objects,
            is_off: correction.is_off(),
            is_told: correction.is_told(),
        };
        corrections.iter().map(one).collect()
    }
}

#[pymethods]
impl RigCorrection {
    fn __repr__(&self) -> String {
        let off = if self.is_off {
            "off"
        } else {
            "not found to be off"
        };
        let (id, deviation) = (&self.camera, self.deviation);
        format!("RigCorrection({id:?}, {off}, {deviation:.1} standard deviations)")
    }
}

#[pymethods]
impl RefinedRig {
    fn __repr__(&self) -> String {
        format!("RefinedRig({} moved)", self.moved.len())
    }
}

fn pairs(observed: &Observed, rig: &mvtop_core::Rig) -> BTreeMap<(String, String), f64> {
    let id = |index: usize| rig.cameras()[index].id().to_owned();
    let pairs = observed.pairs(rig).into_iter();
    let named = pairs.map(|pair| ((id(pair.cameras[0]), id(pair.cameras[1])), pair.px));
    named.collect()
}
