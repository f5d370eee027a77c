//! Rigs.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::PathBuf;
use std::sync::Arc;

use mvtop_core::error::printable;
use mvtop_import::{Direction, Format, ImageSize, Options, Unit};
use ndarray::{ArrayD, Axis};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};

use crate::camera::{Camera, camera, pixels};
use crate::convert::{self, ArrayLike};
use crate::error::{python, value, warn};

/// The cameras that look at a scene together.
#[pyclass(frozen, eq, module = "mvtop")]
#[derive(PartialEq)]
pub struct Rig(Arc<mvtop_core::Rig>);

#[pymethods]
impl Rig {
    /// A rig of these cameras.
    ///
    /// Parameters
    /// ----------
    /// cameras
    ///     In order.
    /// reference
    ///     Id of the one in whose frame poses are given, the first by default.
    /// trust_unit
    ///     Whether the cameras do stand within 2 mm of each other, or up to more than 100 m apart,
    ///     which hints at another unit than metres and is refused else.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     For anything that hints at a mistake, as a rig file does.
    #[new]
    #[pyo3(signature = (cameras, reference = None, *, trust_unit = false))]
    fn new(
        cameras: Vec<PyRef<Camera>>,
        reference: Option<&str>,
        trust_unit: bool,
    ) -> PyResult<Self> {
        let cameras: Vec<_> = cameras.iter().map(|camera| camera.0.clone()).collect();
        rig(cameras, reference, trust_unit)
    }

    /// Reads a rig file (docs/reference/rig-file.md).
    ///
    /// Warns of a lens that folds inside its image (`MvtopWarning`).
    ///
    /// Raises
    /// ------
    /// OSError
    ///     Where it cannot be read.
    /// ValueError
    ///     Where it is refused.
    #[classmethod]
    fn load(cls: &Bound<PyType>, path: PathBuf) -> PyResult<Self> {
        let rig = mvtop_core::Rig::load(&path).map_err(python)?;
        warn(cls.py(), &rig.warnings())?;
        Ok(Self(Arc::new(rig)))
    }

    /// Makes a rig of the calibration files of another program.
    ///
    /// docs/how-to/import-a-calibration.md says what to type.
    ///
    /// What the files cannot say is asked for by these names:
    ///
    /// Parameters
    /// ----------
    /// paths
    ///     A file, or the files of one rig; of COLMAP, its folder will do.
    /// format
    ///     "opencv", "ros", "kalibr", "colmap", "bop", "nerf", "callab", "halcon", "euroc",
    ///     "anipose", "easymocap", "camodocal", "openmvg", "alicevision", "open3d", "metashape",
    ///     "multical", "mccalib", "matlab", "zed" or "depthai"; recognised by default.
    /// scale
    ///     Metres per unit of the files.
    /// unit
    ///     The same by name, "m", "cm" or "mm".
    /// image_size
    ///     Width and height of all images, px.
    /// image_sizes
    ///     Of single cameras, by id.
    /// direction
    ///     What poses map to what, "world_from_cam" or "cam_from_world".
    /// model
    ///     "pinhole" or "fisheye".
    /// max_angle
    ///     Greatest angle from the axis at which a lens images anything or is to be used, degrees.
    /// image
    ///     Of BOP, the image whose cameras make the rig.
    /// rectified
    ///     Of ROS, whether images are rectified rather than raw.
    /// trust_unit
    ///     As of Rig.
    /// ignore
    ///     Keys that state neither a lens nor a place nor a size; unknown keys are refused otherwise.
    ///
    /// Returns
    /// -------
    /// The rig, and a list of sentences: what was taken for what, and errors of fitted lenses in px.
    ///
    /// Raises
    /// ------
    /// OSError
    ///     Where a file cannot be read.
    /// ValueError
    ///     Where it is refused.
    #[classmethod]
    #[pyo3(signature = (paths, *, format = None, scale = None, unit = None, image_size = None, image_sizes = None, direction = None, model = None, max_angle = None, image = None, rectified = false, trust_unit = false, ignore = Vec::new()))]
    #[allow(clippy::too_many_arguments)] // as many as there are things that files leave open
    fn import_file(
        _cls: &Bound<PyType>,
        paths: Paths,
        format: Option<&str>,
        scale: Option<f64>,
        unit: Option<&str>,
        image_size: Option<(u32, u32)>,
        image_sizes: Option<BTreeMap<String, (u32, u32)>>,
        direction: Option<&str>,
        model: Option<String>,
        max_angle: Option<f64>,
        image: Option<u32>,
        rectified: bool,
        trust_unit: bool,
        ignore: Vec<String>,
    ) -> PyResult<(Self, Vec<String>)> {
        let for_all = image_size.map(|size| (None, size));
        let by_id = image_sizes.into_iter().flatten();
        let by_id = by_id.map(|(id, size)| (Some(id), size));
        let sizes = for_all.into_iter().chain(by_id);
        let options = Options {
            format: named("format", format, Format::named)?,
            scale,
            unit: named("unit", unit, Unit::named)?,
            image_sizes: sizes
                .map(|(camera, (width, height))| ImageSize {
                    camera,
                    size: [width, height],
                })
                .collect(),
            direction: named("direction", direction, Direction::named)?,
            model,
            max_angle,
            image,
            rectified,
            trust_unit,
            ignore,
        };
        let imported = mvtop_import::import(&paths.list(), &options).map_err(python)?;
        Ok((Self(Arc::new(imported.rig)), imported.notes))
    }

    /// A rig from images of a board, with a verdict on it: a `mvtop.Calibration`, whose `rig` it is.
    ///
    /// Needs `pip install 'mvtop[calibrate]'`. The same as `mvtop.calibrate`, which says what may be
    /// given.
    ///
    /// - images: a folder or several, or images by camera and exposure
    /// - board: a board file, or a `mvtop.calibration.Board`
    /// - options: lens, intrinsics, cameras, reference, world, layout, measured, ...
    ///
    /// Raises OSError where a file cannot be read, ValueError for what is refused.
    #[classmethod]
    #[pyo3(signature = (images, board, **options: "Any"))]
    fn calibrate<'py>(
        _cls: &Bound<'py, PyType>,
        images: Bound<'py, PyAny>,
        board: Bound<'py, PyAny>,
        options: Option<Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let calibration = images.py().import("mvtop.calibration")?;
        let calibrate = calibration.getattr("calibrate")?;
        calibrate.call((images, board), options.as_ref())
    }

    /// Logs where cameras stand and look, and the distances between them, to Rerun, below the entity
    /// `path`.
    ///
    /// Needs `pip install mvtop[viz]`. Start a recording first, for example with `rerun.init`.
    ///
    /// Parameters
    /// ----------
    /// recording
    ///     Where to; the active one by default.
    #[pyo3(signature = (recording = None, *, path = "mvtop"))]
    fn to_rerun(slf: &Bound<Self>, recording: Option<Bound<PyAny>>, path: &str) -> PyResult<()> {
        let viewer = slf.py().import("mvtop._viewer")?;
        viewer
            .call_method1("log_rig", (slf, recording, path))
            .map(drop)
    }

    /// Reads the text of a rig file.
    #[classmethod]
    fn from_json(_cls: &Bound<PyType>, text: &str) -> PyResult<Self> {
        let rig = mvtop_core::Rig::from_json(text).map_err(python)?;
        Ok(Self(Arc::new(rig)))
    }

    /// A rig of V cameras of one lens model.
    ///
    /// Parameters
    /// ----------
    /// K : array, (V, 3, 3), or (3, 3) for all
    ///     Intrinsics, px.
    /// world_from_cam : array, (V, 4, 4)
    ///     Camera frame to world frame, metres.
    /// sizes : array, (V, 2), or (2,) for all
    ///     Widths and heights of the images, px.
    /// distortion : array, (V, n), or (n,) for all
    ///     See Camera.
    /// ids
    ///     Names of the cameras, "cam0", "cam1", ... by default.
    /// reference, trust_unit
    ///     As of Rig.
    #[classmethod]
    #[pyo3(signature = (K, world_from_cam, sizes, *, distortion = None, model = "pinhole", ids = None, reference = None, trust_unit = false))]
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
        trust_unit: bool,
    ) -> PyResult<Self> {
        let poses = world_from_cam.read("world_from_cam", Some(1), &[4, 4])?;
        let count = poses.len_of(Axis(0));
        let K = per_camera("K", &K, &[3, 3], count)?;
        let sizes = per_camera("sizes", &sizes, &[2], count)?;
        let distortion = match distortion {
            Some(array) => per_camera("distortion", &array.in_rows()?, &[0], count)?,
            None => ArrayD::zeros(vec![count, 0]),
        };
        let ids = ids.unwrap_or_else(|| (0..count).map(|i| format!("cam{i}")).collect());
        if ids.len() != count {
            let got = ids.len();
            let problem = format!("ids: expected {count}, one per camera, got {got}");
            return Err(value(problem));
        }
        let cameras = ids.iter().enumerate().map(|(i, id)| {
            let at = |array: &ArrayD<f64>| array.index_axis(Axis(0), i).to_owned();
            let params: Vec<f64> = at(&distortion).into_iter().collect();
            let [width, height] = [sizes[[i, 0]], sizes[[i, 1]]];
            let size = [pixels(id, "width", width)?, pixels(id, "height", height)?];
            let name = format!("world_from_cam of camera `{id}`");
            let pose = convert::pose(&name, at(&poses).view())?;
            camera(id, size, &at(&K), model, &params, pose, None)
        });
        rig(cameras.collect::<PyResult<_>>()?, reference, trust_unit)
    }

    /// The text of a rig file, in metres.
    fn to_json(&self) -> String {
        self.0.to_json()
    }

    /// Writes a rig file, in metres; what is read back is equal.
    ///
    /// Parameters
    /// ----------
    /// overwrite
    ///     Whether a file may be replaced.
    ///
    /// Raises
    /// ------
    /// FileExistsError
    ///     Where there is one.
    /// OSError
    ///     Where it cannot be written.
    #[pyo3(signature = (path, *, overwrite = false))]
    fn save(&self, path: PathBuf, overwrite: bool) -> PyResult<()> {
        mvtop_cli::save(&path, &self.to_json(), overwrite).map_err(|cause| {
            let sentence = match cause.kind() {
                ErrorKind::AlreadyExists => format!(
                    "{} exists already; give overwrite=True to replace it",
                    path.display()
                ),
                _ => format!("cannot write {}: {cause}", path.display()),
            };
            io::Error::new(cause.kind(), printable(&sentence)).into()
        })
    }

    #[getter]
    fn cameras(&self) -> Vec<Camera> {
        self.0.cameras().iter().cloned().map(Camera).collect()
    }

    /// Id of the camera in whose frame poses are given.
    #[getter]
    fn reference(&self) -> &str {
        self.0.reference_camera().id()
    }

    fn __len__(&self) -> usize {
        self.0.cameras().len()
    }

    fn __repr__(&self) -> String {
        let ids: Vec<_> = self.0.cameras().iter().map(|c| c.id()).collect();
        format!("Rig({}; reference {})", ids.join(", "), self.reference())
    }

    /// For pickle.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let from_json = py.get_type::<Self>().getattr("from_json")?;
        Ok((from_json, (self.to_json(),)))
    }
}

impl Rig {
    pub fn of(rig: Arc<mvtop_core::Rig>) -> Self {
        Self(rig)
    }

    pub fn core(&self) -> &Arc<mvtop_core::Rig> {
        &self.0
    }
}

/// One path, or several.
#[derive(FromPyObject)]
enum Paths {
    One(PathBuf),
    Several(Vec<PathBuf>),
}

impl Paths {
    fn list(self) -> Vec<PathBuf> {
        match self {
            Self::One(path) => vec![path],
            Self::Several(paths) => paths,
        }
    }
}

/// One of several words.
fn named<T>(what: &str, name: Option<&str>, of: fn(&str) -> Option<T>) -> PyResult<Option<T>> {
    let unknown = |name| {
        value(format!(
            "{what}: {name:?} is not known; see help(Rig.import_file)"
        ))
    };
    name.map(|name| of(name).ok_or_else(|| unknown(name)))
        .transpose()
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

/// - `reference`: id of a camera; the first by default
fn rig(
    cameras: Vec<mvtop_core::Camera>,
    reference: Option<&str>,
    trust_unit: bool,
) -> PyResult<Rig> {
    let mut rig = mvtop_core::Rig::new(cameras, 0).map_err(python)?;
    if let Some(id) = reference {
        rig = rig.referring_to(id).map_err(python)?;
    }
    // A person's numbers, unlike a data set's, may be in another unit.
    if !trust_unit {
        rig.check_spread().map_err(python)?;
    }
    Ok(Rig(Arc::new(rig)))
}
