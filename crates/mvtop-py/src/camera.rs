//! Cameras.

use mvtop_core::pose::wxyz;
use mvtop_core::{Intrinsics, Projection, transform};
use nalgebra::{Isometry3, Point2, Point3};
use ndarray::ArrayD;
use pyo3::prelude::*;

use crate::convert::{self, ArrayLike, F64, shaped};
use crate::error::{python, value};

/// A calibrated camera: its lens, and its place in the world.
///
/// Camera frame: x right, y down, z forward. Pixels: integer coordinates are pixel centers, the
/// top-left one at (0, 0). Distortion is OpenCV's, in OpenCV's order.
#[pyclass(frozen, eq, module = "mvtop")]
#[derive(PartialEq)]
pub struct Camera(pub mvtop_core::Camera);

/// What a pickled camera is made of again, as [`Camera::restore`] takes it.
type Pickled = (
    F64,
    (u32, u32),
    Vec<f64>,
    &'static str,
    [f64; 4],
    [f64; 3],
    String,
    Option<f64>,
);

#[pymethods]
impl Camera {
    /// A camera from arrays.
    ///
    /// Parameters
    /// ----------
    /// K : array, (3, 3)
    ///     Intrinsics in px: [[fx, skew, cx], [0, fy, cy], [0, 0, 1]].
    /// size
    ///     Width and height of its images, px.
    /// distortion
    ///     Of "pinhole" 0, 4, 5, 8, 12 or 14 of k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty, of
    ///     "fisheye" k1 k2 k3 k4; also as rows or columns, as OpenCV returns them.
    /// model
    ///     "pinhole" (Brown-Conrady) or "fisheye" (Kannala-Brandt).
    /// world_from_cam : array, (4, 4)
    ///     Camera frame to world frame, metres; the identity by default.
    /// max_angle_deg
    ///     Greatest angle from the optical axis at which the lens images anything.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     For anything that hints at a mistake, as a rig file does.
    #[new]
    #[pyo3(signature = (K, size, *, distortion = None, model = "pinhole", world_from_cam = None, id = "cam0", max_angle_deg = None))]
    #[allow(non_snake_case, clippy::too_many_arguments)] // K is the name that everyone knows
    fn new(
        K: ArrayLike,
        size: ArrayLike,
        distortion: Option<ArrayLike>,
        model: &str,
        world_from_cam: Option<ArrayLike>,
        id: &str,
        max_angle_deg: Option<f64>,
    ) -> PyResult<Self> {
        let distortion = distortion.map(|array| array.in_rows()?.row("distortion"));
        let distortion = distortion.transpose()?.unwrap_or_default();
        let pose = world_from_cam.map(|array| array.pose("world_from_cam"));
        let pose = pose.transpose()?.unwrap_or_default();
        let K = K.read::<f64>("K", Some(0), &[3, 3])?;
        let [width, height] = size.vector("size")?;
        let size = [pixels(id, "width", width)?, pixels(id, "height", height)?];
        camera(id, size, &K, model, &distortion, pose, max_angle_deg).map(Self)
    }

    #[getter]
    fn id(&self) -> &str {
        self.0.id()
    }

    /// Width and height of its images, px.
    #[getter]
    fn size(&self) -> (u32, u32) {
        (self.0.width(), self.0.height())
    }

    /// (3, 3), intrinsics, px.
    #[getter(K)]
    fn intrinsics(&self) -> F64 {
        convert::intrinsics(self.0.intrinsics())
    }

    /// "pinhole" or "fisheye".
    #[getter]
    fn model(&self) -> &'static str {
        self.0.intrinsics().projection().family()
    }

    /// Coefficients in OpenCV's order; none for an ideal pinhole.
    #[getter]
    fn distortion(&self) -> F64 {
        convert::distortion(self.0.intrinsics())
    }

    /// Greatest angle from the optical axis at which the lens images anything; None where it is the
    /// projection alone that ends.
    #[getter]
    fn max_angle_deg(&self) -> Option<f64> {
        self.0.intrinsics().max_angle_deg()
    }

    /// (4, 4), camera frame to world frame, metres.
    #[getter]
    fn world_from_cam(&self) -> F64 {
        convert::matrix(self.0.world_from_cam())
    }

    /// Pixels at which the lens images points of the camera frame.
    ///
    /// Parameters
    /// ----------
    /// points : array, (..., 3)
    ///     Any unit.
    ///
    /// Returns
    /// -------
    /// array, (..., 2)
    ///     Px, also outside the image; NaN for what the lens cannot image: behind the camera, or
    ///     past the angle at which the distortion would fold the image back.
    fn project(&self, py: Python, points: ArrayLike) -> PyResult<F64> {
        let points = points.any_number("points", None, &[3])?;
        let intrinsics = self.0.intrinsics();
        along_last(py, &points, |p| {
            let pixel = intrinsics.project(&Point3::new(p[0], p[1], p[2]));
            pixel.map(|pixel| [pixel.x, pixel.y])
        })
    }

    /// Directions of the rays that the lens images at pixels: the exact inverse of `project`.
    ///
    /// Parameters
    /// ----------
    /// pixels : array, (..., 2)
    ///     Px.
    ///
    /// Returns
    /// -------
    /// array, (..., 3)
    ///     Camera frame, of length 1; NaN where no ray meets the pixel.
    fn unproject(&self, py: Python, pixels: ArrayLike) -> PyResult<F64> {
        let pixels = pixels.any_number("pixels", None, &[2])?;
        let intrinsics = self.0.intrinsics();
        along_last(py, &pixels, |p| {
            let ray = intrinsics.unproject(&Point2::new(p[0], p[1]));
            ray.map(|ray| [ray.x, ray.y, ray.z])
        })
    }

    /// For pickle. Its rotation goes as a quaternion: what a matrix is made of by rounding is not
    /// read back equal.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Pickled)> {
        let pose = self.0.world_from_cam();
        let lens = self.0.intrinsics();
        let arguments = (
            self.intrinsics(),
            self.size(),
            lens.projection().params().to_vec(),
            self.model(),
            wxyz(&pose.rotation),
            pose.translation.vector.into(),
            self.id().to_owned(),
            self.max_angle_deg(),
        );
        Ok((py.get_type::<Self>().getattr("_restore")?, arguments))
    }

    /// A camera that was pickled.
    #[staticmethod]
    #[pyo3(name = "_restore")]
    #[allow(non_snake_case, clippy::too_many_arguments)] // what a camera is made of
    fn restore(
        K: ArrayLike,
        size: (u32, u32),
        distortion: Vec<f64>,
        model: &str,
        q_wxyz: [f64; 4],
        t: [f64; 3],
        id: &str,
        max_angle_deg: Option<f64>,
    ) -> PyResult<Self> {
        let K = K.read::<f64>("K", Some(0), &[3, 3])?;
        let pose = transform::from_quaternion_wxyz(q_wxyz, t);
        let pose = pose.map_err(|error| value(format!("world_from_cam: {error}")))?;
        camera(id, size.into(), &K, model, &distortion, pose, max_angle_deg).map(Self)
    }

    fn __repr__(&self) -> String {
        let (id, (width, height), model) = (self.id(), self.size(), self.model());
        format!("Camera({id:?}, {width}x{height} px, {model})")
    }
}

impl Camera {
    pub fn core(&self) -> &mvtop_core::Camera {
        &self.0
    }
}

/// - `matrix`: (3, 3), intrinsics in px
pub fn camera(
    id: &str,
    size: [u32; 2],
    matrix: &ArrayD<f64>,
    model: &str,
    params: &[f64],
    world_from_cam: Isometry3<f64>,
    max_angle_deg: Option<f64>,
) -> PyResult<mvtop_core::Camera> {
    let k = |row: usize, column: usize| matrix[[row, column]];
    let rest = [k(1, 0), k(2, 0), k(2, 1), k(2, 2)];
    if rest != [0.0, 0.0, 0.0, 1.0] {
        return Err(value(format!(
            "camera `{id}`: K must be [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], got {:?}",
            matrix.iter().collect::<Vec<_>>()
        )));
    }
    let intrinsics = Projection::from_params(model, None, params)
        .and_then(|projection| Intrinsics::new(k(0, 0), k(1, 1), k(0, 2), k(1, 2), projection))
        .and_then(|lens| lens.with_skew(k(0, 1)))
        .and_then(|lens| match max_angle_deg {
            Some(degrees) => lens.with_max_angle(degrees),
            None => Ok(lens),
        })
        .map_err(|error| value(format!("camera `{id}`: {error}")))?;
    mvtop_core::Camera::new(id, size, intrinsics, world_from_cam).map_err(python)
}

/// A side of a camera's images.
pub fn pixels(id: &str, key: &str, side: f64) -> PyResult<u32> {
    match side.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&side) {
        true => Ok(side as u32),
        false => Err(value(format!(
            "camera `{id}`: `{key}` must be a whole number of pixels, got {side}"
        ))),
    }
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
    let rows = numbers.chunks_exact(shape[last]);
    let result = |row| function(row).unwrap_or([f64::NAN; N]);
    let results: Vec<f64> = py.detach(|| rows.flat_map(result).collect());
    shape[last] = N;
    Ok(F64(shaped(&shape, results)?))
}
