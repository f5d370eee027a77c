//! The estimator and what it answers; `python/mvtop/_estimator.py` wraps both.

use std::collections::BTreeMap;
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::process;
use std::sync::Arc;

use mvtop_core::annotations::GivenBoxes;
use mvtop_core::onnx::{Provider, SessionOptions};
use mvtop_core::pose::wxyz;
use mvtop_core::report::{self, Report};
use mvtop_core::{Estimator, Options, PredictOptions, Prediction, ViewImage, image, overlay};
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

/// What the core's estimator answered.
#[pyclass(frozen, module = "mvtop._mvtop")]
pub struct NativePrediction {
    prediction: Prediction,
    rig: Arc<mvtop_core::Rig>,
}

/// One object, by the names of `mvtop.ObjectPose`.
#[derive(IntoPyObject)]
pub struct Found {
    class_name: String,
    class_id: i64,
    score: f64,
    ref_from_obj: F64,
    world_from_obj: F64,
    quat_wxyz: F64,
    /// Degrees, metres.
    sigma: (f64, f64),
    /// Id, `cam_from_obj`, box.
    cameras: Vec<(String, F64, Option<F64>)>,
}

#[pymethods]
impl NativePrediction {
    /// Id of the reference camera.
    #[getter]
    fn reference(&self) -> String {
        self.id(self.prediction.reference)
    }

    /// Wall time of each stage and their total, milliseconds.
    #[getter]
    fn timings_ms(&self) -> Vec<(&'static str, f64)> {
        let t = &self.prediction.timings;
        let stages = [
            "prepare", "features", "detect", "closeup", "decode", "total",
        ];
        let times = [
            t.prepare, t.features, t.detect, t.closeup, t.decode, t.total,
        ];
        stages.into_iter().zip(times).collect()
    }

    /// What executed the network.
    #[getter]
    fn provider(&self) -> &str {
        &self.prediction.provider
    }

    fn objects(&self) -> Vec<Found> {
        let matrix = |pose| F64(ndarray::arr2(&report::rows(pose)).into_dyn());
        let numbers = |four: [f64; 4]| F64(ndarray::arr1(&four).into_dyn());
        let objects = self.prediction.objects.iter();
        objects
            .map(|found| Found {
                class_name: found.class.clone(),
                class_id: found.class_id,
                score: found.score,
                ref_from_obj: matrix(&found.ref_from_obj),
                world_from_obj: matrix(&found.world_from_obj),
                quat_wxyz: numbers(wxyz(&found.ref_from_obj.rotation)),
                sigma: (found.sigma.rot_deg, found.sigma.t_m),
                cameras: found
                    .cameras
                    .iter()
                    .map(|seen| {
                        let bounds = seen.bbox.map(|b| numbers(b.into()));
                        (self.id(seen.camera), matrix(&seen.cam_from_obj), bounds)
                    })
                    .collect(),
            })
            .collect()
    }

    /// What `mvtop-cli infer --json` prints.
    fn to_json(&self) -> PyResult<String> {
        serde_json::to_string(&Report::new(&self.prediction, &self.rig))
            .map_err(|cause| value(format!("report: {cause}")))
    }

    fn __repr__(&self) -> String {
        let count = self.prediction.objects.len();
        format!("NativePrediction({count} objects)")
    }
}

impl NativePrediction {
    fn id(&self, camera: usize) -> String {
        let camera = self.rig.cameras().get(camera);
        camera
            .map(|camera| camera.id().to_owned())
            .unwrap_or_default()
    }
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

    /// Images are given by the index of their camera.
    fn predict<'py>(
        &self,
        py: Python<'py>,
        rig: PyRef<Rig>,
        images: Vec<(usize, Bound<'py, PyAny>)>,
        reference: Option<String>,
        boxes: Option<Vec<Boxes>>,
        min_views: usize,
    ) -> PyResult<NativePrediction> {
        let rig = rig.core().clone();
        let images = load(py, &rig, images)?;
        let boxes = boxes.map(|all| {
            let given = |(class, boxes): Boxes| GivenBoxes {
                class,
                boxes: boxes.into_iter().map(|(id, b)| (id, b.into())).collect(),
            };
            all.into_iter().map(given).collect()
        });
        let options = PredictOptions {
            reference,
            boxes,
            min_views,
        };
        let prediction = compute(py, || self.estimator.predict(&rig, &images, &options))?;
        let prediction = prediction.map_err(python)?;
        Ok(NativePrediction { prediction, rig })
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

    /// Copies of the images with the predicted objects drawn onto them.
    fn draw<'py>(
        &self,
        py: Python<'py>,
        prediction: PyRef<NativePrediction>,
        images: Vec<(usize, Bound<'py, PyAny>)>,
    ) -> PyResult<Vec<Rgb>> {
        let NativePrediction { prediction, rig } = &*prediction;
        let images = load(py, rig, images)?;
        let classes = &self.estimator.bundle().classes;
        let drawn = py.detach(|| overlay::draw_prediction(prediction, classes, rig, &images));
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

/// Images that are arrays or paths.
fn load(
    py: Python,
    rig: &mvtop_core::Rig,
    images: Vec<(usize, Bound<PyAny>)>,
) -> PyResult<Vec<ViewImage>> {
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
        loaded.push(ViewImage {
            camera: index,
            image: picture,
        });
    }
    Ok(loaded)
}
