//! Errors of poses.

use mvtop_eval::bop::{Inexact, ROUNDED, exact_rotation};
use mvtop_eval::metrics;
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use ndarray::{ArrayD, ArrayView2, Axis, Ix2, s};
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::{Borrowed, type_hint_identifier};
use rayon::prelude::*;

use crate::camera::Camera;
use crate::convert::{ArrayLike, F32, F64, axes, pose_or_rotation, shaped};
use crate::error::{python, value, warn};
use crate::process::compute;

/// Motions of an object that do not change how it looks, the identity among them.
#[pyclass(frozen, module = "mvtop.metrics")]
pub struct Symmetries(metrics::Symmetries);

#[pymethods]
impl Symmetries {
    /// The identity and the discrete symmetries, each followed by every turn about each axis, as in
    /// BOP's models_info.json.
    ///
    /// Parameters
    /// ----------
    /// discrete : array, (S, 4, 4)
    ///     Without the identity, in the unit of the points.
    /// continuous
    ///     Axis and a point on it, (3,) each.
    #[new]
    #[pyo3(signature = (discrete = None, continuous = vec![]))]
    fn new(
        py: Python,
        discrete: Option<ArrayLike>,
        continuous: Vec<(ArrayLike, ArrayLike)>,
    ) -> PyResult<Self> {
        let read = |array: ArrayLike| array.read("discrete", Some(1), &[4, 4]);
        let discrete = discrete.map(|array| poses(py, "discrete", &read(array)?));
        let discrete = discrete.transpose()?.unwrap_or_default();
        let mut axes = Vec::new();
        for (axis, offset) in &continuous {
            let axis = Vector3::from(axis.vector::<3>("axis")?);
            let axis = Unit::try_new(axis, 1e-9)
                .ok_or_else(|| value("axis: expected a direction, got 0".into()))?;
            let offset = Point3::from(offset.vector::<3>("offset")?);
            axes.push(metrics::ContinuousSymmetry { axis, offset });
        }
        let all = metrics::Symmetries::new(&discrete, &axes, metrics::BOP_MAX_STEP);
        all.map(Self).map_err(python)
    }

    /// Number of motions.
    fn __len__(&self) -> usize {
        self.0.motions().len()
    }

    fn __repr__(&self) -> String {
        format!("Symmetries({} motions)", self.__len__())
    }
}

/// Points on an object's surface, made ready for measuring many poses.
///
/// Poses are (..., 4, 4), object frame to any one frame, in the unit of the points; one of truth
/// and estimate may be a single one. Errors are (...), in the unit of the points.
#[pyclass(frozen, module = "mvtop.metrics")]
pub struct Surface {
    surface: metrics::Surface,
    points: usize,
}

#[pymethods]
impl Surface {
    ///
    /// Parameters
    /// ----------
    /// points : array, (P, 3)
    ///     Object frame.
    #[new]
    fn new(points: ArrayLike) -> PyResult<Self> {
        let points = points.any_number("points", Some(1), &[3])?;
        let surface = metrics::Surface::new(&points3(&points)).map_err(python)?;
        let points = points.len() / 3;
        Ok(Self { surface, points })
    }

    fn __repr__(&self) -> String {
        format!("Surface({} points)", self.points)
    }

    /// ADD: average distance of the points under both poses (Hinterstoisser et al. 2012).
    fn add(&self, py: Python, truth: ArrayLike, estimate: ArrayLike) -> PyResult<F64> {
        pairs(py, POSE, &truth, &estimate, |truth, estimate| {
            self.surface.add(truth, estimate)
        })
    }

    /// ADD-S, also ADI: average distance of the points under the true pose to the nearest point
    /// under the estimated one.
    fn add_s(&self, py: Python, truth: ArrayLike, estimate: ArrayLike) -> PyResult<F64> {
        pairs(py, POSE, &truth, &estimate, |truth, estimate| {
            self.surface.add_s(truth, estimate)
        })
    }

    /// ADD-(S): ADD-S for symmetric objects, ADD for others.
    fn add_or_add_s(
        &self,
        py: Python,
        truth: ArrayLike,
        estimate: ArrayLike,
        symmetric: bool,
    ) -> PyResult<F64> {
        pairs(py, POSE, &truth, &estimate, |truth, estimate| {
            self.surface.add_or_add_s(truth, estimate, symmetric)
        })
    }

    /// MSSD: greatest distance of the points, for the symmetry where that is least (BOP).
    #[pyo3(signature = (truth, estimate, symmetries = None))]
    fn mssd(
        &self,
        py: Python,
        truth: ArrayLike,
        estimate: ArrayLike,
        symmetries: Option<PyRef<Symmetries>>,
    ) -> PyResult<F64> {
        let symmetries = or_none(symmetries);
        pairs(py, POSE, &truth, &estimate, |truth, estimate| {
            self.surface.mssd(truth, estimate, &symmetries)
        })
    }

    /// MSPD: greatest distance of the points' pixels, px, for the symmetry where that is least
    /// (BOP); infinite where the lens cannot image a point.
    ///
    /// Parameters
    /// ----------
    /// truth, estimate
    ///     Object frame to camera frame.
    #[pyo3(signature = (truth, estimate, camera, symmetries = None))]
    fn mspd(
        &self,
        py: Python,
        truth: ArrayLike,
        estimate: ArrayLike,
        camera: PyRef<Camera>,
        symmetries: Option<PyRef<Symmetries>>,
    ) -> PyResult<F64> {
        let symmetries = or_none(symmetries);
        let intrinsics = &camera.core().intrinsics();
        pairs(py, POSE, &truth, &estimate, |truth, estimate| {
            self.surface.mspd(truth, estimate, &symmetries, intrinsics)
        })
    }
}

/// A triangle mesh in the object's frame, for depth images.
#[pyclass(frozen, module = "mvtop.metrics")]
pub struct Mesh {
    mesh: mvtop_core::mesh::Mesh,
}

#[pymethods]
impl Mesh {
    ///
    /// Parameters
    /// ----------
    /// vertices : array, (P, 3)
    /// triangles
    ///     Three vertices' numbers each; both sides are seen.
    #[new]
    fn new(vertices: ArrayLike, triangles: Vec<[u32; 3]>) -> PyResult<Self> {
        let vertices = points3(&vertices.any_number("vertices", Some(1), &[3])?);
        let mesh = mvtop_core::mesh::Mesh::new(vertices, Vec::new(), triangles);
        Ok(Self {
            mesh: mesh.map_err(python)?,
        })
    }

    fn __repr__(&self) -> String {
        let (vertices, triangles) = (self.mesh.vertices().len(), self.mesh.triangles().len());
        format!("Mesh({vertices} vertices, {triangles} triangles)")
    }

    /// Depth image, in the unit of the vertices and the pose.
    ///
    /// Parameters
    /// ----------
    /// half_pixel
    ///     Pixels are centered at (0.5, 0.5), as in bop_toolkit's renderers.
    ///
    /// Returns
    /// -------
    /// array, (H, W), float32
    ///     Of the camera's size; 0 where there is nothing.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     For a lens with distortion.
    #[pyo3(signature = (cam_from_obj, camera, *, half_pixel = false))]
    fn depth(
        &self,
        py: Python,
        cam_from_obj: ArrayLike,
        camera: PyRef<Camera>,
        half_pixel: bool,
    ) -> PyResult<F32> {
        let pose = cam_from_obj.pose("cam_from_obj")?;
        let camera = camera.core();
        let center = match half_pixel {
            true => metrics::PixelCenter::Half,
            false => metrics::PixelCenter::Integer,
        };
        let size = [camera.width(), camera.height()];
        let depth = || metrics::depth(&self.mesh, &pose, camera.intrinsics(), size, center);
        let depth = compute(py, depth)?;
        Ok(F32(depth.map_err(python)?.into_dyn()))
    }
}

/// VSD: share of the visible pixels of both poses where the object's surfaces do not coincide
/// (BOP).
///
/// Parameters
/// ----------
/// estimate, truth : array, (H, W)
///     Depth images of the object, see Mesh.depth.
/// measured : array, (H, W)
///     Depth image of the scene, 0 where nothing was measured.
/// delta
///     How far a surface may lie behind the measured one and still be seen; BOP: 15 mm.
/// taus
///     Misalignment tolerances; BOP's shares of the diameter by default.
/// diameter
///     Divides distances where given, as BOP does.
///
/// Returns
/// -------
/// One number for each tolerance, 0 to 1.
#[pyfunction]
#[pyo3(signature = (estimate, truth, measured, camera, *, delta, taus = None, diameter = None))]
#[allow(clippy::too_many_arguments)] // as many as the definition has
pub fn vsd(
    py: Python,
    estimate: ArrayLike,
    truth: ArrayLike,
    measured: ArrayLike,
    camera: PyRef<Camera>,
    delta: f64,
    taus: Option<Vec<f64>>,
    diameter: Option<f64>,
) -> PyResult<Vec<f64>> {
    let depth =
        |name, array: &ArrayLike| axes::<_, Ix2>(name, array.read::<f32>(name, Some(2), &[])?);
    let estimate = depth("estimate", &estimate)?;
    let truth = depth("truth", &truth)?;
    let measured = depth("measured", &measured)?;
    let options = metrics::VsdOptions {
        delta,
        taus: taus.unwrap_or_else(|| metrics::VSD_TAUS.to_vec()),
        diameter,
        cost: metrics::MatchingCost::Step,
    };
    let intrinsics = &camera.core().intrinsics();
    py.detach(|| metrics::vsd(&estimate, &truth, &measured, intrinsics, &options))
        .map_err(python)
}

/// Least angle between the estimated rotation and a symmetric one of the true, degrees.
///
/// Parameters
/// ----------
/// truth, estimate
///     (..., 4, 4) poses or (..., 3, 3) rotations; one of the two may be a single one.
///
/// Returns
/// -------
/// array, (...)
#[pyfunction]
#[pyo3(signature = (truth, estimate, symmetries = None))]
pub fn rotation_error_deg(
    py: Python,
    truth: ArrayLike,
    estimate: ArrayLike,
    symmetries: Option<PyRef<Symmetries>>,
) -> PyResult<F64> {
    let symmetries = or_none(symmetries);
    pairs(
        py,
        POSE_OR_ROTATION,
        &truth,
        &estimate,
        |truth, estimate| metrics::rotation_error_deg(truth, estimate, &symmetries),
    )
}

/// Least distance between the estimated origin and a symmetric one of the true, in the unit of the
/// poses.
///
/// Parameters
/// ----------
/// truth, estimate : array, (..., 4, 4)
///     One of the two may be a single one.
///
/// Returns
/// -------
/// array, (...)
#[pyfunction]
#[pyo3(signature = (truth, estimate, symmetries = None))]
pub fn translation_error(
    py: Python,
    truth: ArrayLike,
    estimate: ArrayLike,
    symmetries: Option<PyRef<Symmetries>>,
) -> PyResult<F64> {
    let symmetries = or_none(symmetries);
    pairs(py, POSE, &truth, &estimate, |truth, estimate| {
        metrics::translation_error(truth, estimate, &symmetries)
    })
}

/// Share of errors below a threshold; of ADD at 0.1 diameters, the usual "ADD recall". None
/// without errors; an object that was not found counts as infinity.
#[pyfunction]
pub fn recall(errors: Errors, threshold: f64) -> PyResult<Option<f64>> {
    Ok(metrics::recall(&errors.0, above_0("threshold", threshold)?))
}

/// Mean of the recalls at several thresholds: BOP's average recall for one kind of error.
#[pyfunction]
pub fn average_recall(errors: Errors, thresholds: Vec<f64>) -> PyResult<Option<f64>> {
    for &threshold in &thresholds {
        above_0("thresholds", threshold)?;
    }
    Ok(metrics::average_recall(&errors.0, &thresholds))
}

/// Exact area under the recall curve from 0 to `max`, over `max`.
#[pyfunction]
pub fn auc_exact(errors: Errors, max: f64) -> PyResult<Option<f64>> {
    Ok(metrics::auc_exact(&errors.0, above_0("max", max)?))
}

/// The area of PoseCNN's and CosyPose's evaluations, `max` there being 0.1 m.
#[pyfunction]
pub fn auc_posecnn(errors: Errors, max: f64) -> PyResult<Option<f64>> {
    Ok(metrics::auc_posecnn(&errors.0, above_0("max", max)?))
}

/// The area of PoET's evaluation, `max` there being 0.1 m.
#[pyfunction]
pub fn auc_poet(errors: Errors, max: f64) -> PyResult<Option<f64>> {
    Ok(metrics::auc_poet(&errors.0, above_0("max", max)?))
}

/// Errors of poses: 0 or more, infinite where an object was not found.
pub struct Errors(Vec<f64>);

impl<'py> FromPyObject<'_, 'py> for Errors {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = type_hint_identifier!("numpy.typing", "ArrayLike");

    fn extract(any: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let array = any.extract::<ArrayLike>()?;
        let errors = array.any_number::<f64>("errors", Some(0), &[0])?;
        // NaN is not 0 or more either.
        match errors
            .iter()
            .find(|error| !(0.0..=f64::INFINITY).contains(*error))
        {
            None => Ok(Self(errors.into_iter().collect())),
            Some(wrong) => Err(value(format!(
                "errors: expected 0 or more, infinity for what was not found, got {wrong}"
            ))),
        }
    }
}

fn above_0(name: &str, number: f64) -> PyResult<f64> {
    match number.is_finite() && number > 0.0 {
        true => Ok(number),
        false => Err(value(format!(
            "{name}: expected a number above 0, got {number}"
        ))),
    }
}

fn or_none(symmetries: Option<PyRef<Symmetries>>) -> metrics::Symmetries {
    symmetries.map(|given| given.0.clone()).unwrap_or_default()
}

fn points3(array: &ArrayD<f64>) -> Vec<Point3<f64>> {
    let points = array.outer_iter();
    points.map(|p| Point3::new(p[0], p[1], p[2])).collect()
}

/// Of the matrices of all leading indices, one after the other. Rotations that are off by more than
/// rounding, as those of some data sets, are made exact with a warning.
fn poses(py: Python, name: &str, array: &ArrayD<f64>) -> PyResult<Vec<Isometry3<f64>>> {
    let (leading, last) = array.shape().split_at(array.ndim() - 2);
    let matrices = array.to_shape((leading.iter().product(), last[0], last[1]));
    let matrices = matrices.map_err(|cause| value(format!("{name}: {cause}")))?;
    let mut inexact = Inexact::default();
    let count = matrices.len_of(Axis(0));
    let pose = |(i, matrix): (usize, ArrayView2<f64>)| {
        let place = match count {
            1 => name.to_owned(),
            _ => format!("{name}, pose {i}"),
        };
        let mut matrix = matrix.to_owned();
        if matrix.shape().iter().all(|&side| side >= 3) {
            let mut part = matrix.slice_mut(s![..3, ..3]);
            let rows = std::array::from_fn(|i| part[[i / 3, i % 3]]);
            // What is none is refused below.
            if let Ok((exact, off)) = exact_rotation(&rows) {
                if off > ROUNDED {
                    part.indexed_iter_mut()
                        .for_each(|(at, entry)| *entry = exact[at]);
                }
                inexact.note(off, || place.clone());
            }
        }
        pose_or_rotation(&place, matrix.view().into_dyn())
    };
    let poses = matrices.outer_iter().enumerate().map(pose).collect();
    warn(py, inexact.sentence(name).as_slice())?;
    poses
}

/// What [`pairs`] takes: 4x4 matrices, or matrices that [`pose_or_rotation`] reads.
const POSE: [usize; 2] = [4, 4];
const POSE_OR_ROTATION: [usize; 2] = [0, 0];

/// An error of each true pose with its estimate.
fn pairs(
    py: Python,
    matrix: [usize; 2],
    truth: &ArrayLike,
    estimate: &ArrayLike,
    error: impl Fn(&Isometry3<f64>, &Isometry3<f64>) -> f64 + Sync,
) -> PyResult<F64> {
    let truth = truth.read::<f64>("truth", None, &matrix)?;
    let estimate = estimate.read::<f64>("estimate", None, &matrix)?;
    let leading = |array: &ArrayD<f64>| array.shape()[..array.ndim() - 2].to_vec();
    let shape = match truth.ndim() {
        2 => leading(&estimate),
        _ => leading(&truth),
    };
    if estimate.ndim() > 2 && leading(&estimate) != shape {
        return Err(value(format!(
            "expected as many true poses as estimates, or one of either, got shapes {:?} and {:?}",
            truth.shape(),
            estimate.shape()
        )));
    }
    let (truth, estimate) = (
        poses(py, "truth", &truth)?,
        poses(py, "estimate", &estimate)?,
    );
    let count: usize = shape.iter().product();
    let errors = compute(py, || {
        let one = |i: usize| error(&truth[i % truth.len()], &estimate[i % estimate.len()]);
        (0..count).into_par_iter().map(one).collect::<Vec<f64>>()
    })?;
    Ok(F64(shaped(&shape, errors)?))
}
