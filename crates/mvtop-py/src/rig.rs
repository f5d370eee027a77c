//! Cameras and rigs.

use std::sync::Arc;

use mvtop_core::{Distortion, report};
use nalgebra::{Point2, Point3};
use ndarray::{ArrayD, Axis};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};
use serde_json::{Value, json};

use crate::convert::{ArrayLike, F64, shaped};
use crate::error::{python, value};

/// A calibrated camera: its lens, and its place in the world.
///
/// Camera frame: x right, y down, z forward. Pixels: integer coordinates are pixel centers, the
/// top-left one at (0, 0). Distortion is OpenCV's, in OpenCV's order.
#[pyclass(frozen, module = "mvtop")]
pub struct Camera(mvtop_core::Camera);

#[pymethods]
impl Camera {
    /// A camera from arrays.
    ///
    /// - K: (3, 3), intrinsics in px: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    /// - size: width and height of its images, px
    /// - distortion: of "pinhole" 0, 4, 5 or 8 of k1 k2 p1 p2 k3 k4 k5 k6, of "fisheye" k1 k2 k3 k4
    /// - model: "pinhole" (Brown-Conrady) or "fisheye" (Kannala-Brandt)
    /// - world_from_cam: (4, 4), camera frame to world frame, metres; the identity by default
    ///
    /// Raises ValueError for anything that hints at a mistake, as a rig file does.
    #[new]
    #[pyo3(signature = (K, size, *, distortion = None, model = "pinhole", world_from_cam = None, id = "cam0"))]
    #[allow(non_snake_case)] // K is the name that everyone knows
    fn new(
        K: ArrayLike,
        size: [u32; 2],
        distortion: Option<ArrayLike>,
        model: &str,
        world_from_cam: Option<ArrayLike>,
        id: &str,
    ) -> PyResult<Self> {
        let distortion: Vec<f64> = match distortion {
            Some(array) => array
                .read::<f64>("distortion", Some(0), &[0])?
                .into_iter()
                .collect(),
            None => Vec::new(),
        };
        let pose: ArrayD<f64> = match world_from_cam {
            Some(array) => array.read("world_from_cam", Some(0), &[4, 4])?,
            None => ndarray::Array2::eye(4).into_dyn(),
        };
        let K = K.read::<f64>("K", Some(0), &[3, 3])?;
        let camera = camera_json(id, size, &K, model, &distortion, &pose)?;
        let rig = mvtop_core::Rig::from_json(&rig_json(vec![camera], id)).map_err(python)?;
        let camera = rig.cameras.into_iter().next();
        camera.map(Self).ok_or_else(|| value("camera: none".into()))
    }

    #[getter]
    fn id(&self) -> &str {
        &self.0.id
    }

    /// Width and height of its images, px.
    #[getter]
    fn size(&self) -> (u32, u32) {
        (self.0.width, self.0.height)
    }

    /// (3, 3), intrinsics, px.
    #[getter(K)]
    fn intrinsics(&self) -> PyResult<F64> {
        let lens = &self.0.lens;
        let rows = vec![lens.fx, 0., lens.cx, 0., lens.fy, lens.cy, 0., 0., 1.];
        Ok(F64(shaped(&[3, 3], rows)?))
    }

    /// "pinhole" or "fisheye".
    #[getter]
    fn model(&self) -> &'static str {
        match self.0.lens.distortion {
            Distortion::None | Distortion::BrownConrady(_) => "pinhole",
            Distortion::KannalaBrandt(_) => "fisheye",
        }
    }

    /// Coefficients in OpenCV's order; none for an ideal pinhole.
    #[getter]
    fn distortion(&self) -> F64 {
        let params = match &self.0.lens.distortion {
            Distortion::None => Vec::new(),
            Distortion::BrownConrady(lens) => lens.params().to_vec(),
            Distortion::KannalaBrandt(lens) => lens.params().to_vec(),
        };
        F64(ndarray::Array1::from(params).into_dyn())
    }

    /// (4, 4), camera frame to world frame, metres.
    #[getter]
    fn world_from_cam(&self) -> F64 {
        F64(ndarray::arr2(&report::rows(&self.0.world_from_cam)).into_dyn())
    }

    /// Pixels at which the lens images points of the camera frame.
    ///
    /// - points: (..., 3), any unit
    /// - returns: (..., 2), px, also outside the image; NaN for what the lens cannot image: behind
    ///   the camera, or past the angle at which the distortion would fold the image back
    fn project(&self, py: Python, points: ArrayLike) -> PyResult<F64> {
        let points = points.any_number("points", None, &[3])?;
        let lens = &self.0.lens;
        along_last(py, &points, |p| {
            let pixel = lens.project(&Point3::new(p[0], p[1], p[2]));
            pixel.map(|pixel| [pixel.x, pixel.y])
        })
    }

    /// Directions of the rays that the lens images at pixels: the exact inverse of `project`.
    ///
    /// - pixels: (..., 2), px
    /// - returns: (..., 3), camera frame, of length 1; NaN where no ray meets the pixel
    fn unproject(&self, py: Python, pixels: ArrayLike) -> PyResult<F64> {
        let pixels = pixels.any_number("pixels", None, &[2])?;
        let lens = &self.0.lens;
        along_last(py, &pixels, |p| {
            let ray = lens.unproject(&Point2::new(p[0], p[1]));
            ray.map(|ray| [ray.x, ray.y, ray.z])
        })
    }

    /// For pickle: the arguments by position and by name.
    fn __getnewargs_ex__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<((F64, (u32, u32)), Bound<'py, PyDict>)> {
        let named = PyDict::new(py);
        named.set_item("distortion", self.distortion())?;
        named.set_item("model", self.model())?;
        named.set_item("world_from_cam", self.world_from_cam())?;
        named.set_item("id", self.id())?;
        Ok(((self.intrinsics()?, self.size()), named))
    }

    fn __repr__(&self) -> String {
        let (id, model) = (&self.0.id, self.model());
        format!(
            "Camera({id:?}, {}x{} px, {model})",
            self.0.width, self.0.height
        )
    }
}

impl Camera {
    pub fn core(&self) -> &mvtop_core::Camera {
        &self.0
    }
}

/// The cameras that look at a scene together.
#[pyclass(frozen, module = "mvtop")]
pub struct Rig(Arc<mvtop_core::Rig>);

#[pymethods]
impl Rig {
    /// A rig of these cameras; `reference` is the id of the one in whose frame poses are given, the
    /// first by default.
    ///
    /// Raises ValueError for anything that hints at a mistake, as a rig file does.
    #[new]
    #[pyo3(signature = (cameras, reference = None))]
    fn new(cameras: Vec<PyRef<Camera>>, reference: Option<&str>) -> PyResult<Self> {
        let cameras: Vec<_> = cameras.iter().map(|camera| camera.0.clone()).collect();
        let index = match reference {
            None => 0,
            Some(id) => cameras
                .iter()
                .position(|camera| camera.id == id)
                .ok_or_else(|| {
                    let ids: Vec<_> = cameras.iter().map(|camera| camera.id.as_str()).collect();
                    let ids = ids.join(", ");
                    value(format!(
                        "reference: no camera `{id}`, expected one of: {ids}"
                    ))
                })?,
        };
        let rig = mvtop_core::Rig {
            cameras,
            reference: index,
        };
        // What a file may not say is refused here as well.
        mvtop_core::Rig::from_json(&rig.to_json()).map_err(python)?;
        Ok(Self(Arc::new(rig)))
    }

    /// Reads a rig file (docs/rig.md).
    ///
    /// Raises OSError where it cannot be read, ValueError where it is refused.
    #[classmethod]
    fn load(_cls: &Bound<PyType>, path: std::path::PathBuf) -> PyResult<Self> {
        let rig = mvtop_core::Rig::load(&path).map_err(python)?;
        Ok(Self(Arc::new(rig)))
    }

    /// Reads the text of a rig file.
    #[classmethod]
    fn from_json(_cls: &Bound<PyType>, text: &str) -> PyResult<Self> {
        let rig = mvtop_core::Rig::from_json(text).map_err(python)?;
        Ok(Self(Arc::new(rig)))
    }

    /// A rig of V cameras of one lens model.
    ///
    /// - K: (V, 3, 3), or (3, 3) for all; intrinsics, px
    /// - world_from_cam: (V, 4, 4), camera frame to world frame, metres
    /// - sizes: (V, 2), or (2,) for all; widths and heights of the images, px
    /// - distortion: (V, n), or (n,) for all; see Camera
    /// - ids: names of the cameras, "cam0", "cam1", ... by default
    #[classmethod]
    #[pyo3(signature = (K, world_from_cam, sizes, *, distortion = None, model = "pinhole", ids = None, reference = None))]
    #[allow(non_snake_case, clippy::too_many_arguments)] // one argument is one array of Python's
    fn from_arrays(
        _cls: &Bound<PyType>,
        K: ArrayLike,
        world_from_cam: ArrayLike,
        sizes: ArrayLike,
        distortion: Option<ArrayLike>,
        model: &str,
        ids: Option<Vec<String>>,
        reference: Option<&str>,
    ) -> PyResult<Self> {
        let poses = world_from_cam.read("world_from_cam", Some(1), &[4, 4])?;
        let count = poses.len_of(Axis(0));
        let K = per_camera("K", &K, &[3, 3], count)?;
        let sizes = per_camera("sizes", &sizes, &[2], count)?;
        let distortion = match distortion {
            Some(array) => per_camera("distortion", &array, &[0], count)?,
            None => ArrayD::zeros(vec![count, 0]),
        };
        let ids = ids.unwrap_or_else(|| (0..count).map(|i| format!("cam{i}")).collect());
        if ids.len() != count {
            let got = ids.len();
            return Err(value(format!(
                "ids: expected {count}, one per camera, got {got}"
            )));
        }
        let mut cameras = Vec::new();
        for (i, id) in ids.iter().enumerate() {
            let at = |array: &ArrayD<f64>| array.index_axis(Axis(0), i).to_owned();
            let params: Vec<f64> = at(&distortion).into_iter().collect();
            let mut camera = camera_json(id, [0, 0], &at(&K), model, &params, &at(&poses))?;
            camera["width"] = json!(sizes[[i, 0]]);
            camera["height"] = json!(sizes[[i, 1]]);
            cameras.push(camera);
        }
        let reference = reference.or(ids.first().map(String::as_str)).unwrap_or("");
        let rig = mvtop_core::Rig::from_json(&rig_json(cameras, reference)).map_err(python)?;
        Ok(Self(Arc::new(rig)))
    }

    /// The text of a rig file, in metres.
    fn to_json(&self) -> String {
        self.0.to_json()
    }

    #[getter]
    fn cameras(&self) -> Vec<Camera> {
        self.0.cameras.iter().cloned().map(Camera).collect()
    }

    /// Id of the camera in whose frame poses are given.
    #[getter]
    fn reference(&self) -> &str {
        self.0
            .cameras
            .get(self.0.reference)
            .map_or("", |camera| &camera.id)
    }

    fn __len__(&self) -> usize {
        self.0.cameras.len()
    }

    fn __repr__(&self) -> String {
        let ids: Vec<_> = self
            .0
            .cameras
            .iter()
            .map(|camera| camera.id.as_str())
            .collect();
        format!("Rig({}; reference {})", ids.join(", "), self.reference())
    }

    /// For pickle.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let from_json = py.get_type::<Self>().getattr("from_json")?;
        Ok((from_json, (self.to_json(),)))
    }
}

impl Rig {
    pub fn core(&self) -> &Arc<mvtop_core::Rig> {
        &self.0
    }
}

/// The last axes as given for each camera, or once for all.
fn per_camera(
    name: &str,
    array: &ArrayLike,
    last: &[usize],
    count: usize,
) -> PyResult<ArrayD<f64>> {
    let array = array.read::<f64>(name, None, last)?;
    let mut shape = vec![count];
    shape.extend(&array.shape()[array.ndim() - last.len()..]);
    match array.broadcast(shape) {
        Some(array) => Ok(array.to_owned()),
        None => Err(value(format!(
            "{name}: expected one for each of {count} cameras or one for all, got shape {:?}",
            array.shape()
        ))),
    }
}

fn camera_json(
    id: &str,
    [width, height]: [u32; 2],
    intrinsics: &ArrayD<f64>,
    model: &str,
    params: &[f64],
    pose: &ArrayD<f64>,
) -> PyResult<Value> {
    let k = |row: usize, column: usize| intrinsics[[row, column]];
    let rest = [k(0, 1), k(1, 0), k(2, 0), k(2, 1), k(2, 2)];
    if rest != [0.0, 0.0, 0.0, 0.0, 1.0] {
        return Err(value(format!(
            "camera `{id}`: K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {:?}",
            intrinsics.iter().collect::<Vec<_>>()
        )));
    }
    let rows: Vec<Vec<f64>> = pose
        .outer_iter()
        .map(|row| row.iter().copied().collect())
        .collect();
    let mut camera = json!({
        "id": id, "width": width, "height": height, "model": model,
        "fx": k(0, 0), "fy": k(1, 1), "cx": k(0, 2), "cy": k(1, 2),
        "T_world_cam": rows,
    });
    if !params.is_empty() {
        let name = if model == "fisheye" {
            "kannala_brandt"
        } else {
            "brown_conrady"
        };
        camera["distortion"] = json!({ "model": name, "params": params });
    }
    Ok(camera)
}

fn rig_json(cameras: Vec<Value>, reference: &str) -> String {
    json!({
        "format": "mvtop-rig", "version": 1, "unit": "m",
        "reference": reference, "cameras": cameras,
    })
    .to_string()
}

/// A function of the numbers along the last axis; `None` becomes NaN.
fn along_last<const N: usize>(
    py: Python,
    array: &ArrayD<f64>,
    function: impl Fn(&[f64]) -> Option<[f64; N]> + Sync,
) -> PyResult<F64> {
    let last = array.ndim() - 1;
    let mut shape = array.shape().to_vec();
    let numbers: Vec<f64> = array.iter().copied().collect();
    let results: Vec<f64> = py.detach(|| {
        numbers
            .chunks_exact(shape[last])
            .flat_map(|row| function(row).unwrap_or([f64::NAN; N]))
            .collect()
    });
    shape[last] = N;
    Ok(F64(shaped(&shape, results)?))
}
