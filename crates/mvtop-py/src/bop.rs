//! BOP's annotations, and results in its format.

use std::collections::BTreeMap;
use std::path::PathBuf;

use mvtop_eval::bop::{self, Estimate, Frame, FrameId};
use mvtop_eval::runner::bop::Options;
use nalgebra::Vector3;
use ndarray::{Array3, arr2};
use pyo3::prelude::*;

use crate::convert::{ArrayLike, Dict, F64, dict, distortion, intrinsics, matrix, vector};
use crate::error::{python, value, warn};
use crate::process::compute;

/// An image of a scene: its camera, and what is annotated in it.
#[pyclass(frozen, module = "mvtop.bop")]
pub struct Image {
    id: FrameId,
    frame: Frame,
    instances: Vec<Py<Instance>>,
}

/// An annotated object of an image.
#[pyclass(frozen, module = "mvtop.bop")]
pub struct Instance(bop::Instance);

/// What models_info.json says of an object.
#[pyclass(frozen, module = "mvtop.bop")]
pub struct ModelInfo(bop::ModelInfo);

/// What is known of the images of a scene's folder, in the order of sensors and images; the images
/// themselves are not opened.
///
/// Parameters
/// ----------
/// whole
///     Whether what is incomplete is refused, images that are listed but not unpacked and
///     annotations without a camera, instead of left out.
///
/// Raises
/// ------
/// OSError
///     For a file that cannot be read.
/// ValueError
///     For one that is not BOP's.
///
/// Warns
/// -----
/// MvtopWarning
///     Of what is doubtful: rotations that were made exact, images that are missing, cameras in
///     metres.
#[pyfunction]
#[pyo3(signature = (folder, *, whole = false))]
pub fn read_scene(py: Python, folder: PathBuf, whole: bool) -> PyResult<Vec<Image>> {
    let (frames, doubts) = py
        .detach(|| bop::load_frames(&folder, whole))
        .map_err(python)?;
    warn(py, &doubts.sentences())?;
    frames
        .into_iter()
        .map(|(id, mut frame)| {
            let instances = std::mem::take(&mut frame.objects).into_iter();
            let instances = instances.map(|instance| Py::new(py, Instance(instance)));
            Ok(Image {
                id,
                instances: instances.collect::<PyResult<_>>()?,
                frame,
            })
        })
        .collect()
}

/// What models_info.json says of each object, by its number.
///
/// Raises
/// ------
/// OSError
///     For a file that cannot be read.
/// ValueError
///     For one that is not BOP's.
#[pyfunction]
pub fn read_models_info(path: PathBuf) -> PyResult<BTreeMap<u32, ModelInfo>> {
    let infos = bop::load_infos(&path).map_err(python)?;
    let wrapped = infos.into_iter().map(|(id, info)| (id, ModelInfo(info)));
    Ok(wrapped.collect())
}

#[pymethods]
impl Image {
    /// Its number in the scene.
    #[getter]
    fn number(&self) -> u32 {
        self.id.image
    }

    /// What the files of its camera end in, "cam1" of scene_camera_cam1.json; "" of
    /// scene_camera.json.
    #[getter]
    fn sensor(&self) -> &str {
        &self.id.sensor
    }

    /// File of the color or grey image.
    #[getter]
    fn path(&self) -> PathBuf {
        self.frame.path.clone()
    }

    /// (3, 3), intrinsics, px.
    #[getter(K)]
    fn intrinsics(&self) -> F64 {
        intrinsics(&self.frame.intrinsics)
    }

    /// Coefficients in OpenCV's order; none for an ideal pinhole.
    #[getter]
    fn distortion(&self) -> F64 {
        distortion(&self.frame.intrinsics)
    }

    /// (4, 4), world frame to camera frame, metres; None where the data set does not say where its
    /// cameras stood.
    #[getter]
    fn cam_from_world(&self) -> Option<F64> {
        let world_from_cam = self.frame.world_from_cam?;
        Some(matrix(&world_from_cam.inverse()))
    }

    /// In the order of scene_gt.json; none where the annotations are kept back.
    #[getter]
    fn instances(&self, py: Python) -> Vec<Py<Instance>> {
        self.instances.iter().map(|one| one.clone_ref(py)).collect()
    }

    /// What else scene_camera.json says of it.
    #[getter]
    fn more<'py>(&self, py: Python<'py>) -> PyResult<Dict<'_, 'py>> {
        dict(py, &self.frame.more)
    }

    fn __repr__(&self) -> String {
        format!("Image({}, {} instances)", self.id, self.instances.len())
    }
}

#[pymethods]
impl Instance {
    /// Number of the object.
    #[getter]
    fn obj_id(&self) -> u32 {
        self.0.object
    }

    /// (4, 4), object frame to camera frame, metres.
    #[getter]
    fn cam_from_obj(&self) -> F64 {
        matrix(&self.0.cam_from_obj)
    }

    /// (4,), x0, y0, x1, y1, px, of the whole object also where it is hidden (BOP's bbox_obj); None
    /// where it is not known.
    #[getter]
    fn r#box(&self) -> Option<F64> {
        self.0.bbox.map(|bbox| vector(<[f64; 4]>::from(bbox)))
    }

    /// (4,), the same of what is visible of it (bbox_visib).
    #[getter]
    fn visible_box(&self) -> Option<F64> {
        self.0
            .visible_bbox
            .map(|bbox| vector(<[f64; 4]>::from(bbox)))
    }

    /// Visible share of the object's pixels, 0 to 1 (visib_fract); None where it is not known.
    #[getter]
    fn visible_share(&self) -> Option<f64> {
        self.0.visible
    }

    /// What else scene_gt_info.json says of it.
    #[getter]
    fn more<'py>(&self, py: Python<'py>) -> PyResult<Dict<'_, 'py>> {
        dict(py, &self.0.more)
    }

    fn __repr__(&self) -> String {
        format!("Instance(object {})", self.0.object)
    }
}

#[pymethods]
impl ModelInfo {
    /// mvtop's own data sets have names, BOP's do not.
    #[getter]
    fn name(&self) -> Option<&str> {
        self.0.name.as_deref()
    }

    /// Largest distance between two points of the surface, metres.
    #[getter]
    fn diameter_m(&self) -> f64 {
        self.0.diameter_m
    }

    /// (2, 3), least and greatest coordinates, metres; None where the file lacks one.
    #[getter]
    fn bounds(&self) -> Option<F64> {
        self.0.bounds.map(|bounds| F64(arr2(&bounds).into_dyn()))
    }

    /// (S, 4, 4), motions that do not change how the object looks, metres; without the identity.
    #[getter]
    fn symmetries_discrete(&self) -> F64 {
        let mut motions = Array3::zeros((self.0.discrete.len(), 4, 4));
        for (mut to, motion) in motions.outer_iter_mut().zip(&self.0.discrete) {
            to.assign(&matrix(motion).0);
        }
        F64(motions.into_dyn())
    }

    /// Axis and a point on it, (3,) each, metres, about which no turn changes how it looks: as
    /// `mvtop.metrics.Symmetries` takes them.
    #[getter]
    fn symmetries_continuous(&self) -> Vec<(F64, F64)> {
        let axes = self.0.continuous.iter();
        let numbers = |of: &Vector3<f64>| vector(of.iter().copied());
        axes.map(|turn| (numbers(&turn.axis), numbers(&turn.offset.coords)))
            .collect()
    }

    fn __repr__(&self) -> String {
        let name = self.0.name.as_deref().unwrap_or("no name");
        format!("ModelInfo({name}, {:.1} mm)", 1e3 * self.0.diameter_m)
    }
}

/// The line of one pose, with its end.
///
/// Parameters
/// ----------
/// cam_from_obj : array, (4, 4)
///     Metres; written as rows of the rotation and millimetres.
/// time_s
///     What all poses of the image took, seconds; BOP's -1 where that is not known.
#[pyfunction]
pub fn bop_results_line(
    scene_id: u32,
    im_id: u32,
    obj_id: u32,
    score: f64,
    cam_from_obj: ArrayLike,
    time_s: f64,
) -> PyResult<String> {
    let pose = cam_from_obj.read::<f64>("cam_from_obj", Some(0), &[4, 4])?;
    let estimate = Estimate {
        obj_id,
        score,
        r: std::array::from_fn(|i| pose[[i / 3, i % 3]]),
        t_mm: std::array::from_fn(|i| 1e3 * pose[[i, 3]]),
    };
    Ok(estimate.csv_line(scene_id, im_id, time_s))
}

/// Scores of results in BOP's format as one line of JSON, see `mvtop.bop.evaluate`.
///
/// Parameters
/// ----------
/// names
///     Ids of objects that the files give by name.
/// report
///     Folder for results and pages.
///
/// Raises
/// ------
/// ValueError
///     For what is refused.
#[pyfunction]
#[pyo3(signature = (dataset, predictions, *, split, targets, sensor, objects, names, vsd_delta_mm, report, force))]
#[expect(clippy::too_many_arguments)] // named in Python
pub fn score_results(
    py: Python,
    dataset: PathBuf,
    predictions: Vec<PathBuf>,
    split: String,
    targets: Option<PathBuf>,
    sensor: Option<String>,
    objects: Option<Vec<u32>>,
    names: Vec<(String, u32)>,
    vsd_delta_mm: f64,
    report: Option<PathBuf>,
    force: bool,
) -> PyResult<String> {
    let mut options = Options::new(dataset);
    options.split.split = split;
    options.split.targets = targets;
    options.split.sensor = sensor;
    options.split.objects = objects;
    options.predictions = predictions;
    options.map = names;
    options.vsd_delta_mm = vsd_delta_mm;
    options.force = force;
    compute(py, || mvtop_cli::score_results(&options, report.as_deref()))?.map_err(value)
}
