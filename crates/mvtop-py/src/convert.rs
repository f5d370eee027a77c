//! Between numpy's arrays and the core's types.

use std::collections::BTreeMap;

use image::RgbImage;
use mvtop_core::{Camera, Error, Intrinsics, report, transform};
use nalgebra::{Isometry3, Matrix3, Rotation3};
use ndarray::{Array, Array1, ArrayD, ArrayViewD, Dimension, arr2};
use numpy::{
    AllowTypeChange, Element, PyArray, PyArrayDescrMethods, PyArrayDyn, PyArrayLikeDyn,
    PyArrayMethods, PyReadonlyArray, PyReadonlyArray3, PyReadwriteArray, PyUntypedArray,
    PyUntypedArrayMethods, ToPyArray,
};
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::{Borrowed, IntoPyObjectExt, type_hint_identifier, type_hint_subscript};
use serde_json::{Map, Value};

use crate::error::{python, unless_interrupted, value};

/// Anything that numpy makes an array of numbers from.
pub struct ArrayLike<'py>(Bound<'py, PyAny>);

impl<'py> FromPyObject<'_, 'py> for ArrayLike<'py> {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = type_hint_identifier!("numpy.typing", "ArrayLike");

    fn extract(any: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        Ok(Self(any.to_owned()))
    }
}

/// Lengths of an array's last axes; 0 is any length.
pub type LastAxes<'a> = &'a [usize];

impl ArrayLike<'_> {
    /// The numbers, if they are finite and the array ends in these axes.
    ///
    /// - `leading`: how many more axes there are; `None` for any number
    pub fn read<T>(&self, name: &str, leading: Option<usize>, last: LastAxes) -> PyResult<ArrayD<T>>
    where
        T: Element + Copy + Into<f64> + 'static,
        for<'a, 'p> Vec<T>: FromPyObject<'a, 'p>,
    {
        let array = self.any_number::<T>(name, leading, last)?;
        let not_finite = |number: &f64| !number.is_finite();
        match array.iter().map(|&number| number.into()).find(not_finite) {
            Some(bad) => Err(value(format!("{name}: expected finite numbers, got {bad}"))),
            None => Ok(array),
        }
    }

    /// The same, but NaN and infinity are numbers as well.
    pub fn any_number<T>(
        &self,
        name: &str,
        leading: Option<usize>,
        last: LastAxes,
    ) -> PyResult<ArrayD<T>>
    where
        T: Element + Copy + 'static,
        for<'a, 'p> Vec<T>: FromPyObject<'a, 'p>,
    {
        let expected = || {
            let any = || "any".to_owned();
            let mut axes = leading.map_or(vec!["...".into()], |count| vec![any(); count]);
            let length = |&length: &usize| (length > 0).then(|| length.to_string());
            axes.extend(last.iter().map(|axis| length(axis).unwrap_or_else(any)));
            format!("numbers of shape ({})", axes.join(", "))
        };
        self.refuse_other_kinds(name, &expected)?;
        let array: PyArrayLikeDyn<T, AllowTypeChange> =
            self.0.extract().map_err(|cause: PyErr| {
                let got = self.0.get_type();
                let sentence = format!("{name}: expected {}, got {got}", expected());
                unless_interrupted(self.0.py(), cause, sentence)
            })?;
        let array = array.as_array();
        let shape = array.shape();
        let fits = |more: usize| {
            let lengths = shape[more..].iter().zip(last);
            let fit = |(&got, &expected)| expected == 0 || got == expected;
            leading.is_none_or(|count| count == more) && lengths.into_iter().all(fit)
        };
        match shape.len().checked_sub(last.len()).is_some_and(fits) {
            true => Ok(array.to_owned()),
            false => {
                let expected = expected();
                Err(value(format!(
                    "{name}: expected {expected}, got shape {shape:?}"
                )))
            }
        }
    }

    /// Refuses arrays of which numpy would make real numbers by leaving something out: imaginary
    /// parts, units of time, masks.
    fn refuse_other_kinds(&self, name: &str, expected: &dyn Fn() -> String) -> PyResult<()> {
        let Ok(array) = self.0.cast::<PyUntypedArray>() else {
            return Ok(());
        };
        let masked = is_masked(array)?;
        if !masked && b"biuf".contains(&array.dtype().kind()) {
            return Ok(());
        }
        let what = if masked { "a masked array of " } else { "" };
        let (expected, dtype) = (expected(), array.dtype());
        Err(value(format!(
            "{name}: expected {expected}, got {what}{dtype}"
        )))
    }

    /// The numbers of an array with one axis.
    pub fn list(&self, name: &str) -> PyResult<Vec<f64>> {
        let array = self.read(name, Some(0), &[0])?;
        Ok(array.into_iter().collect())
    }

    /// The numbers of an array with one axis, or of one row.
    pub fn row(&self, name: &str) -> PyResult<Vec<f64>> {
        let array = self.any_number::<f64>(name, None, &[0])?;
        match array.shape() {
            [1, _] => self
                .read::<f64>(name, Some(1), &[0])?
                .into_iter()
                .map(Ok)
                .collect(),
            _ => self.list(name),
        }
    }

    /// OpenCV's columns as rows: (n, 1) as (n,) and (V, 1, n) or (V, n, 1) as (V, n).
    pub fn in_rows(&self) -> PyResult<Self> {
        let numpy = self.0.py().import("numpy")?;
        let array = numpy.call_method1("asarray", (&self.0,))?;
        let shape: Vec<usize> = array.getattr("shape")?.extract()?;
        let axis = match shape.as_slice() {
            [_, 1] | [_, _, 1] => -1,
            [_, 1, _] => 1,
            _ => return Ok(Self(array)),
        };
        Ok(Self(array.call_method1("squeeze", (axis,))?))
    }

    /// As many numbers.
    pub fn vector<const N: usize>(&self, name: &str) -> PyResult<[f64; N]> {
        let array = self.read::<f64>(name, Some(0), &[N])?;
        Ok(std::array::from_fn(|i| array[[i]]))
    }

    /// A rigid transform: rows of the homogeneous matrix.
    pub fn pose(&self, name: &str) -> PyResult<Isometry3<f64>> {
        pose(name, self.read::<f64>(name, Some(0), &[4, 4])?.view())
    }
}

/// An array of NumPy's that is read or written where it lies: C-contiguous, of float32.
pub struct ArrayInPlace<'py>(Bound<'py, PyAny>);

impl<'py> FromPyObject<'_, 'py> for ArrayInPlace<'py> {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = F32::OUTPUT_TYPE;

    fn extract(any: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        Ok(Self(any.to_owned()))
    }
}

impl<'py> ArrayInPlace<'py> {
    pub fn read<D: Dimension>(&self, name: &str) -> PyResult<PyReadonlyArray<'py, f32, D>> {
        let array = self.array::<D>(name)?.try_readonly();
        array.map_err(|cause| value(format!("{name}: {cause}")))
    }

    /// Refuses what does not have this shape, is read-only, or is read or written already.
    pub fn write<D: Dimension>(
        &self,
        name: &str,
        shape: &[usize],
    ) -> PyResult<PyReadwriteArray<'py, f32, D>> {
        let array = self.array::<D>(name)?;
        if array.shape() != shape {
            let got = array.shape();
            return Err(value(format!(
                "{name}: expected shape {shape:?}, got {got:?}"
            )));
        }
        let array = array.try_readwrite();
        array.map_err(|cause| value(format!("{name}: {cause}")))
    }

    fn array<D: Dimension>(&self, name: &str) -> PyResult<&Bound<'py, PyArray<f32, D>>> {
        let array = self.0.cast::<PyArray<f32, D>>().ok();
        array.filter(|a| a.is_c_contiguous()).ok_or_else(|| {
            let axes = D::NDIM.unwrap_or(0);
            let got = match self.0.cast::<PyUntypedArray>() {
                Ok(array) => {
                    let order = match array.is_c_contiguous() {
                        true => "C-contiguous",
                        false => "of other strides",
                    };
                    format!("{} of shape {:?}, {order}", array.dtype(), array.shape())
                }
                Err(_) => self.0.get_type().to_string(),
            };
            value(format!(
                "{name}: expected a C-contiguous array of float32 with {axes} axes, got {got}"
            ))
        })
    }
}

/// The rigid transform of a 4x4 matrix; an error of rounding in its rotation is taken out.
pub fn pose(name: &str, matrix: ArrayViewD<f64>) -> PyResult<Isometry3<f64>> {
    let rows = square::<4>(name, matrix)?;
    transform::from_matrix(&rows).map_err(|error| value(format!("{name}: {error}")))
}

/// The same, of a rotation's 3x3 matrix as well.
pub fn pose_or_rotation(name: &str, matrix: ArrayViewD<f64>) -> PyResult<Isometry3<f64>> {
    if matrix.shape() != [3, 3] {
        return pose(name, matrix);
    }
    let rows = square::<3>(name, matrix)?;
    transform::from_rotation(&rows, [0.0; 3]).map_err(|error| value(format!("{name}: {error}")))
}

fn square<const N: usize>(name: &str, matrix: ArrayViewD<f64>) -> PyResult<[[f64; N]; N]> {
    if matrix.shape() != [N, N] {
        return Err(value(format!(
            "{name}: expected numbers of shape ({N}, {N}), got shape {:?}",
            matrix.shape()
        )));
    }
    Ok(std::array::from_fn(|row| {
        std::array::from_fn(|column| matrix[[row, column]])
    }))
}

/// Rows of a rotation's matrix, one after the other.
pub fn rotation_rows(rotation: &Rotation3<f64>) -> [f64; 9] {
    let matrix: &Matrix3<f64> = rotation.matrix();
    std::array::from_fn(|i| matrix[(i / 3, i % 3)])
}

/// Numbers as an array, (N,).
pub fn vector(numbers: impl IntoIterator<Item = f64>) -> F64 {
    F64(Array1::from_iter(numbers).into_dyn())
}

/// A rigid transform's homogeneous matrix, (4, 4).
pub fn matrix(pose: &Isometry3<f64>) -> F64 {
    F64(arr2(&report::rows(pose)).into_dyn())
}

/// A camera's matrix, (3, 3), px.
pub fn intrinsics(of: &Intrinsics) -> F64 {
    F64(arr2(&of.matrix()).into_dyn())
}

/// A lens's coefficients in OpenCV's order; none for an ideal pinhole.
pub fn distortion(of: &Intrinsics) -> F64 {
    vector(of.projection().params().iter().copied())
}

/// What goes to Python as a dict.
pub type Dict<'a, 'py> = BTreeMap<&'a str, Bound<'py, PyAny>>;

/// A JSON object.
pub fn dict<'a, 'py>(py: Python<'py>, object: &'a Map<String, Value>) -> PyResult<Dict<'a, 'py>> {
    let entries = object.iter();
    entries
        .map(|(key, value)| Ok((key.as_str(), json(py, value)?)))
        .collect()
}

fn json<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    match value {
        Value::Null => Ok(py.None().into_bound(py)),
        Value::Bool(truth) => truth.into_bound_py_any(py),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => whole.into_bound_py_any(py),
            None => number.as_f64().into_bound_py_any(py),
        },
        Value::String(text) => text.into_bound_py_any(py),
        Value::Array(items) => {
            let items = items.iter().map(|item| json(py, item));
            items.collect::<PyResult<Vec<_>>>()?.into_bound_py_any(py)
        }
        Value::Object(object) => dict(py, object)?.into_bound_py_any(py),
    }
}

/// An array that goes to Python as numpy's of 64-bit floats.
#[derive(Clone)]
pub struct F64(pub ArrayD<f64>);

/// The same of 32-bit floats.
pub struct F32(pub ArrayD<f32>);

/// An image, `[H, W, 3]`.
pub struct Rgb(pub RgbImage);

macro_rules! into_numpy {
    ($type:ty, $number:ty, $dtype:literal, $array:expr) => {
        impl<'py> IntoPyObject<'py> for $type {
            type Target = PyArrayDyn<$number>;
            type Output = Bound<'py, Self::Target>;
            type Error = PyErr;
            const OUTPUT_TYPE: PyStaticExpr = type_hint_subscript!(
                type_hint_identifier!("numpy.typing", "NDArray"),
                type_hint_identifier!("numpy", $dtype)
            );

            fn into_pyobject(self, py: Python<'py>) -> PyResult<Self::Output> {
                let array: fn(Self) -> PyResult<ArrayD<$number>> = $array;
                Ok(array(self)?.to_pyarray(py))
            }
        }
    };
}

into_numpy!(F64, f64, "float64", |array| Ok(array.0));
into_numpy!(F32, f32, "float32", |array| Ok(array.0));
into_numpy!(Rgb, u8, "uint8", |image| {
    let (width, height) = (image.0.width() as usize, image.0.height() as usize);
    shaped(&[height, width, 3], image.0.into_raw())
});

/// An array of as many axes as its type says.
pub fn axes<T, D: Dimension>(name: &str, array: ArrayD<T>) -> PyResult<Array<T, D>> {
    let array = array.into_dimensionality();
    array.map_err(|cause| value(format!("{name}: {cause}")))
}

/// An array of known shape.
pub fn shaped<T>(shape: &[usize], numbers: Vec<T>) -> PyResult<ArrayD<T>> {
    ArrayD::from_shape_vec(shape, numbers).map_err(|cause| value(format!("array: {cause}")))
}

/// Whether an array says of some of its numbers that they are none.
fn is_masked(array: &Bound<PyUntypedArray>) -> PyResult<bool> {
    array.hasattr("mask")
}

/// An 8-bit RGB image of numpy's; `None` for what is no array of numpy's at all.
///
/// Of another size than the camera's it is refused before it is copied: what numpy has broadcast may
/// be larger than the memory.
pub fn image(name: &str, any: &Bound<PyAny>, camera: &Camera) -> PyResult<Option<RgbImage>> {
    let Ok(array) = any.cast::<PyUntypedArray>() else {
        return Ok(None);
    };
    let masked = is_masked(array)?;
    let refuse = || {
        let (dtype, shape) = (array.dtype(), array.shape());
        let what = if masked { "a masked array of " } else { "" };
        value(format!(
            "{name}: expected an RGB array of uint8 and shape (H, W, 3), got {what}{dtype} and \
             {shape:?}"
        ))
    };
    if masked {
        return Err(refuse());
    }
    let array: PyReadonlyArray3<u8> = any.extract().map_err(|_| refuse())?;
    let array = array.as_array();
    let (height, width, channels) = array.dim();
    let (Ok(width), Ok(height), 3) = (u32::try_from(width), u32::try_from(height), channels) else {
        return Err(refuse());
    };
    let expected = [camera.width(), camera.height()];
    if expected != [width, height] {
        return Err(python(Error::ImageSize {
            camera: camera.id().to_owned(),
            expected,
            got: [width, height],
        }));
    }
    let bytes = match array.as_slice() {
        Some(bytes) => bytes.to_vec(),
        None => array.iter().copied().collect(),
    };
    let image = RgbImage::from_raw(width, height, bytes);
    image.map(Some).ok_or_else(refuse)
}
