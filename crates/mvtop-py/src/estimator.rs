//! The estimator and what it answers; `python/mvtop/_estimator.py` wraps both.

use std::collections::BTreeMap;
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::process;

use ::image::RgbImage;
use mvtop_core::known::KnownBoxes;
use mvtop_core::onnx::{Provider, SessionOptions};
use mvtop_core::report::Report;
use mvtop_core::{Estimator, Options, PredictOptions, Prediction, image, overlay};
use pyo3::prelude::*;

use crate::convert::{self, F64, Rgb, shaped};
use crate::error::{python, value};
use crate::process::{compute, let_forks_exit};
use crate::rig::Rig;

/// An object's class, and its boxes by camera id.
type Boxes = (String, BTreeMap<String, [f64; 4]>);

/// A network that is loaded in this process.
#[pyclass(frozen, module = "mvtop._mvtop")]
pub struct NativeEstimator {
    estimator: ManuallyDrop<Estimator>,
    process: u32,
}

/// What the core's estimator answered, for drawing.
#[pyclass(frozen, module = "mvtop._mvtop")]
pub struct NativePrediction(Prediction);

#[pymethods]
impl NativeEstimator {
    #[new]
    fn new(
        py: Python,
        bundle: PathBuf,
        ort_lib: Option<PathBuf>,
        provider: &str,
        threads: usize,
    ) -> PyResult<Self> {
        let provider: Provider = provider
            .parse()
            .map_err(|error: mvtop_core::Error| value(error.to_string()))?;
        let options = Options {
            ort_lib,
            session: SessionOptions { provider, threads },
        };
        let estimator = compute(py, || Estimator::load(&bundle, &options))?.map_err(python)?;
        let_forks_exit();
        Ok(Self {
            estimator: ManuallyDrop::new(estimator),
            process: process::id(),
        })
    }

    /// Whether it was loaded in the process that asks, and not in one that this was forked from.
    fn is_of_this_process(&self) -> bool {
        self.process == process::id()
    }

    /// Name and number of each class, with its diameter in metres.
    fn classes(&self) -> Vec<(String, i64, f64)> {
        let classes = self.estimator.bundle().classes.iter();
        classes
            .map(|c| (c.name.clone(), c.id, c.diameter_m))
            .collect()
    }

    /// (P, 3), points on the surface of a class, metres.
    fn points(&self, class_index: usize) -> PyResult<F64> {
        let class = self.estimator.bundle().classes.get(class_index);
        let class = class.ok_or_else(|| value(format!("class {class_index}: none such")))?;
        let numbers: Vec<f64> = class.points.iter().flat_map(|p| p.position).collect();
        Ok(F64(shaped(&[class.points.len(), 3], numbers)?))
    }

    /// The prediction, and its report as JSON. Images are given by the index of their camera.
    fn predict<'py>(
        &self,
        py: Python<'py>,
        rig: PyRef<Rig>,
        images: Vec<(usize, Bound<'py, PyAny>)>,
        reference: Option<String>,
        boxes: Option<Vec<Boxes>>,
        min_views: usize,
    ) -> PyResult<(NativePrediction, String)> {
        let rig = rig.core();
        let images = load(py, rig, images)?;
        let boxes = boxes.map(|all| {
            let known = |(class, boxes)| KnownBoxes { class, boxes };
            all.into_iter().map(known).collect()
        });
        let options = PredictOptions {
            reference,
            boxes,
            min_views,
        };
        let prediction = compute(py, || self.estimator.predict(rig, &images, &options))?;
        let prediction = prediction.map_err(python)?;
        let report = serde_json::to_string(&Report::new(&prediction, rig))
            .map_err(|cause| value(format!("report: {cause}")))?;
        Ok((NativePrediction(prediction), report))
    }

    /// The images as arrays.
    #[staticmethod]
    fn images<'py>(
        py: Python<'py>,
        rig: PyRef<Rig>,
        images: Vec<(usize, Bound<'py, PyAny>)>,
    ) -> PyResult<Vec<Rgb>> {
        let images = load(py, rig.core(), images)?;
        Ok(images.into_iter().map(|(_, image)| Rgb(image)).collect())
    }

    /// Copies of the images with the predicted objects drawn onto them.
    fn draw<'py>(
        &self,
        py: Python<'py>,
        prediction: PyRef<NativePrediction>,
        rig: PyRef<Rig>,
        images: Vec<(usize, Bound<'py, PyAny>)>,
    ) -> PyResult<Vec<Rgb>> {
        let (rig, prediction) = (rig.core(), &prediction.0);
        let images = load(py, rig, images)?;
        let classes = &self.estimator.bundle().classes;
        let drawn = py.detach(|| overlay::draw_prediction(prediction, classes, rig, &images));
        Ok(drawn.into_iter().map(Rgb).collect())
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

/// Images that are arrays or paths.
fn load(
    py: Python,
    rig: &mvtop_core::Rig,
    images: Vec<(usize, Bound<PyAny>)>,
) -> PyResult<Vec<(usize, RgbImage)>> {
    let mut loaded = Vec::with_capacity(images.len());
    for (index, any) in images {
        let Some(camera) = rig.cameras().get(index) else {
            return Err(value(format!("image {index}: the rig has no such camera")));
        };
        let name = format!("image of camera `{}`", camera.id());
        let picture = match convert::image(&name, &any)? {
            Some(picture) => picture,
            None => {
                let path: PathBuf = any.extract().map_err(|_| {
                    let got = any.get_type();
                    value(format!(
                        "{name}: expected an RGB array of uint8 and shape (H, W, 3), or a path, \
                         got {got}"
                    ))
                })?;
                py.detach(|| image::load(&path, camera)).map_err(python)?
            }
        };
        loaded.push((index, picture));
    }
    Ok(loaded)
}
