//! The estimator and what it answers; `python/mvtop/_estimator.py` wraps both.

use std::collections::BTreeMap;
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::process;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use mvtop_core::bundle::Class;
use mvtop_core::calibration::{Expected, observe};
use mvtop_core::config::InferenceConfig;
use mvtop_core::onnx::SessionOptions;
use mvtop_core::request::Grasps;
use mvtop_core::{Estimator, Options, Tracker, ViewImage, image::load_views, overlay};
use pyo3::prelude::*;

use crate::calibration::RigCheck;
use crate::convert::{self, F64, Rgb, shaped};
use crate::error::{python, unless_interrupted, value};
use crate::prediction::NativePrediction;
use crate::process::{compute, in_pool, interruptible, let_forks_exit};
use crate::request::{Boxes, asked};
use crate::rig::Rig;
use crate::tracks::{self, Tracks};

/// A network that is loaded in this process.
#[pyclass(frozen, module = "mvtop._mvtop")]
pub struct NativeEstimator {
    estimator: ManuallyDrop<Arc<Estimator>>,
    grasps: Option<Arc<Grasps>>,
    process: u32,
}

/// Predictions of one rig, again and again, by a network that is loaded in this process.
#[pyclass(frozen, module = "mvtop._mvtop")]
pub struct NativeTracker {
    tracker: ManuallyDrop<Mutex<Tracker>>,
    estimator: ManuallyDrop<Arc<Estimator>>,
    grasps: Option<Arc<Grasps>>,
    rig: Arc<mvtop_core::Rig>,
    process: u32,
}

/// All inference settings without a bundle, as JSON.
#[pyfunction]
pub fn default_inference() -> PyResult<String> {
    let text = serde_json::to_string(&InferenceConfig::default());
    text.map_err(|error| value(error.to_string()))
}

#[pymethods]
impl NativeEstimator {
    #[new]
    fn new(
        py: Python,
        bundle: PathBuf,
        ort_lib: Option<PathBuf>,
        provider: &str,
        threads: usize,
        inference: BTreeMap<String, String>,
    ) -> PyResult<Self> {
        let unknown = |error: mvtop_core::Error| value(error.to_string());
        let provider = provider.parse().map_err(unknown)?;
        let session = SessionOptions::default()
            .with_provider(provider)
            .with_threads(threads);
        let parsed = |(key, text): (String, String)| {
            let parsed = serde_json::from_str(&text);
            let parsed = parsed.map_err(|e| value(format!("inference setting `{key}`: {e}")));
            Ok((key, parsed?))
        };
        let inference = inference.into_iter().map(parsed).collect::<PyResult<_>>()?;
        let mut options = Options::default()
            .with_session(session)
            .with_inference(inference);
        options.ort_lib = ort_lib;
        let load = || in_pool(|| Estimator::load(&bundle, &options))?.map_err(python);
        let estimator = interruptible(py, load)?;
        let_forks_exit();
        let grasps = Grasps::of_bundle(estimator.bundle()).map_err(python)?;
        Ok(Self {
            estimator: ManuallyDrop::new(Arc::new(estimator)),
            grasps: grasps.map(Arc::new),
            process: process::id(),
        })
    }

    /// Whether it was loaded in the process that asks, and not in one that this was forked from.
    fn is_of_this_process(&self) -> bool {
        self.process == process::id()
    }

    /// Name and number of each class, with its diameter in metres.
    fn classes(&self) -> Vec<(String, i64, f64)> {
        let about = |c: &Class| (c.name.clone(), c.id, c.diameter_m);
        self.estimator.bundle().classes.iter().map(about).collect()
    }

    /// (P, 3), points on the surface of a class, metres.
    fn points(&self, class_index: usize) -> PyResult<F64> {
        let class = self.estimator.bundle().classes.get(class_index);
        let class = class.ok_or_else(|| value(format!("class {class_index}: none such")))?;
        let numbers: Vec<f64> = class.points.iter().flat_map(|p| p.position).collect();
        Ok(F64(shaped(&[class.points.len(), 3], numbers)?))
    }

    /// Images are given by the index of their camera, the request as JSON; what is given beside it
    /// replaces what it says. `tracks` numbers the objects.
    #[allow(clippy::too_many_arguments)] // Python's keywords
    fn predict<'py>(
        &self,
        py: Python<'py>,
        rig: PyRef<Rig>,
        images: Vec<(usize, Bound<'py, PyAny>)>,
        request: Option<&str>,
        reference: Option<String>,
        boxes: Option<Vec<Boxes>>,
        min_views: Option<usize>,
        refine: Option<bool>,
        tracks: Option<Bound<'py, Tracks>>,
    ) -> PyResult<NativePrediction> {
        let rig = rig.core().clone();
        let request = asked(request, reference, boxes, min_views, refine)?;
        let images = load(py, &rig, images)?;
        let (estimator, grasps): (&Estimator, _) = (&self.estimator, self.grasps.as_deref());
        let tracks = tracks.as_ref().map(Bound::get);
        let answer = interruptible(py, || {
            let mut locked = tracks.map(Tracks::lock);
            let tracks = locked.as_deref_mut();
            in_pool(|| request.answer_tracked(estimator, grasps, &rig, &images, tracks))?
                .map_err(python)
        })?;
        Ok(NativePrediction::new(answer, rig))
    }

    /// Sets of images, each given by the index of its camera, against the rig that they are of.
    fn check_rig<'py>(
        &self,
        py: Python<'py>,
        rig: PyRef<Rig>,
        sets: Vec<Vec<(usize, Bound<'py, PyAny>)>>,
        turn_sd_deg: f64,
        shift_sd_m: f64,
    ) -> PyResult<RigCheck> {
        let rig = rig.core().clone();
        let sets = sets.into_iter().map(|images| load(py, &rig, images));
        let sets = sets.collect::<PyResult<Vec<_>>>()?;
        let expected = Expected {
            turn_deg: turn_sd_deg,
            shift_m: shift_sd_m,
        };
        let observe = || in_pool(|| observe(&self.estimator, &rig, &sets, expected));
        let observed = interruptible(py, || observe()?.map_err(python))?;
        Ok(RigCheck::new(observed, rig))
    }

    /// The images as arrays.
    #[staticmethod]
    fn images<'py>(
        py: Python<'py>,
        rig: PyRef<Rig>,
        images: Vec<(usize, Bound<'py, PyAny>)>,
    ) -> PyResult<Vec<Rgb>> {
        let images = load(py, rig.core(), images)?;
        Ok(images.into_iter().map(|view| Rgb(view.image)).collect())
    }

    /// Copies of the images with the predicted objects drawn onto them, or their edges alone.
    fn draw<'py>(
        &self,
        py: Python<'py>,
        prediction: PyRef<NativePrediction>,
        images: Vec<(usize, Bound<'py, PyAny>)>,
        edges: bool,
    ) -> PyResult<Vec<Rgb>> {
        let NativePrediction {
            prediction, rig, ..
        } = &*prediction;
        let images = load(py, rig, images)?;
        let estimator: &Estimator = &self.estimator;
        if edges {
            let without = "leave edges=True out";
            estimator.needs_mesh("edges", without).map_err(python)?;
        }
        let classes = &estimator.bundle().classes;
        let drawn = compute(py, || match edges {
            true => overlay::draw_prediction_edges(prediction, estimator, rig, &images),
            false => overlay::draw_prediction(prediction, classes, rig, &images),
        })?;
        Ok(drawn.into_iter().map(Rgb).collect())
    }

    fn __repr__(&self) -> String {
        let bundle = self.estimator.bundle();
        let classes: Vec<_> = bundle.classes.iter().map(|c| c.name.as_str()).collect();
        format!("NativeEstimator({})", classes.join(", "))
    }
}

impl Drop for NativeEstimator {
    fn drop(&mut self) {
        // In a forked process, dropping the network would wait for threads that are not there.
        if self.is_of_this_process() {
            // SAFETY: nothing uses it after this.
            unsafe { ManuallyDrop::drop(&mut self.estimator) }
        }
    }
}

#[pymethods]
impl NativeTracker {
    #[new]
    fn new(
        estimator: PyRef<NativeEstimator>,
        rig: PyRef<Rig>,
        max_motion_m: Option<f64>,
        patience: usize,
    ) -> PyResult<Self> {
        let options = tracks::options(max_motion_m, patience)?;
        let rig = rig.core().clone();
        let tracker = Tracker::new((*estimator.estimator).clone(), rig.clone());
        let tracker = tracker.with_tracks(options);
        Ok(Self {
            tracker: ManuallyDrop::new(Mutex::new(tracker)),
            estimator: estimator.estimator.clone(),
            grasps: estimator.grasps.clone(),
            rig,
            process: estimator.process,
        })
    }

    /// New images are given by the index of their camera.
    fn update<'py>(
        &self,
        py: Python<'py>,
        images: Vec<(usize, Bound<'py, PyAny>)>,
    ) -> PyResult<()> {
        let images = load(py, &self.rig, images)?;
        py.detach(|| self.lock().update(images)).map_err(python)
    }

    /// Of the latest images.
    fn predict(
        &self,
        py: Python,
        request: Option<&str>,
        reference: Option<String>,
        boxes: Option<Vec<Boxes>>,
        min_views: Option<usize>,
        refine: Option<bool>,
    ) -> PyResult<NativePrediction> {
        let request = asked(request, reference, boxes, min_views, refine)?;
        let (bundle, grasps) = (self.estimator.bundle(), self.grasps.as_deref());
        request
            .check(bundle, &self.rig, grasps.is_some())
            .map_err(python)?;
        let found = interruptible(py, || {
            let tracker = &mut *self.lock();
            in_pool(|| tracker.predict(&request.options()))?.map_err(python)
        })?;
        let answer = request.choose(found, bundle, grasps, &self.rig);
        Ok(NativePrediction::new(
            answer.map_err(python)?,
            self.rig.clone(),
        ))
    }

    /// Forgets the image of a camera, by its index.
    fn remove(&self, py: Python, camera: usize) {
        py.detach(|| self.lock().remove(camera));
    }

    fn __repr__(&self) -> String {
        format!("NativeTracker({} cameras)", self.rig.cameras().len())
    }
}

impl NativeTracker {
    fn lock(&self) -> MutexGuard<'_, Tracker> {
        self.tracker.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for NativeTracker {
    fn drop(&mut self) {
        // As with the estimator, whose network it shares.
        if self.process == process::id() {
            // SAFETY: nothing uses them after this.
            unsafe {
                ManuallyDrop::drop(&mut self.tracker);
                ManuallyDrop::drop(&mut self.estimator);
            }
        }
    }
}

/// Images that are arrays or paths, in their order, at most one of each camera.
fn load(
    py: Python,
    rig: &mvtop_core::Rig,
    images: Vec<(usize, Bound<PyAny>)>,
) -> PyResult<Vec<ViewImage>> {
    let order: Vec<usize> = images.iter().map(|(index, _)| *index).collect();
    let (mut loaded, mut files) = (Vec::with_capacity(images.len()), Vec::new());
    for (index, any) in images {
        let Some(camera) = rig.cameras().get(index) else {
            return Err(value(format!("image {index}: the rig has no such camera")));
        };
        let name = format!("image of camera `{}`", camera.id());
        match convert::image(&name, &any, camera)? {
            Some(image) => loaded.push(ViewImage {
                camera: index,
                image,
            }),
            None => {
                let path: PathBuf = any.extract().map_err(|cause| {
                    let got = any.get_type();
                    let sentence = format!(
                        "{name}: expected an RGB array of uint8 and shape (H, W, 3), or a path, \
                         got {got}"
                    );
                    unless_interrupted(any.py(), cause, sentence)
                })?;
                files.push((index, path));
            }
        }
    }
    loaded.extend(compute(py, || load_views(rig, &files))?.map_err(python)?);
    loaded.sort_by_key(|view| order.iter().position(|&index| index == view.camera));
    Ok(loaded)
}
