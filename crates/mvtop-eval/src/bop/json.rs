//! Reading BOP's JSON files.

use std::path::Path;

use nalgebra::{Isometry3, Matrix3, Rotation3};
use serde::de::DeserializeOwned;

use crate::{Error, Result};
use mvtop_core::transform;

/// Metres per unit of a file.
pub(super) const MM: f64 = 1e-3;

/// How far a rotation of a file may be off, in any entry of RᵀR: some data sets come with few digits.
const ROTATION_TOLERANCE: f64 = 1e-2;

/// - `expected`: what the file should hold, for the error
///
/// # Errors
/// [`Error::Read`] where it cannot be read, [`Error::Json`] where it holds something else.
pub(super) fn read<T: DeserializeOwned>(path: &Path, expected: &str) -> Result<T> {
    let text = std::fs::read_to_string(path).map_err(|cause| Error::Read {
        path: path.to_owned(),
        cause,
    })?;
    serde_json::from_str(&text).map_err(|cause| Error::Json {
        path: path.to_owned(),
        expected: expected.to_owned(),
        cause,
    })
}

/// A motion of a file, millimetres, as one in metres.
///
/// - `r`: row by row
pub(super) fn motion(place: &str, r: &[f64; 9], t: &[f64; 3]) -> Result<Isometry3<f64>> {
    let rotation =
        nearest_rotation(r).map_err(|problem| Error::Data(format!("{place}: {problem}")))?;
    let rows = rotation.into_inner().transpose().into();
    transform::from_rotation(&rows, t.map(|x| x * MM)).map_err(|cause| Error::Transform {
        name: place.to_owned(),
        cause,
    })
}

/// The rotation nearest to a matrix that is one but for rounding; what is exact stays as it is.
///
/// - `rows`: row by row
///
/// Source: Björck and Bowie, "An Iterative Algorithm for Computing the Best Estimate of an
/// Orthogonal Matrix", 1971.
pub(super) fn nearest_rotation(rows: &[f64; 9]) -> Result<Rotation3<f64>, String> {
    let mut matrix = Matrix3::from_row_slice(rows);
    let excess_of = |m: &Matrix3<f64>| m.transpose() * m - Matrix3::identity();
    let mut excess = excess_of(&matrix);
    // Not `> ROTATION_TOLERANCE`: overflow to NaN must be refused, too.
    if !(excess.amax() <= ROTATION_TOLERANCE && matrix.determinant() > 0.0) {
        return Err(format!(
            "expected a rotation up to {ROTATION_TOLERANCE}, row by row, got {rows:?}"
        ));
    }
    // Each step squares what it is off by, so three are enough.
    while excess.amax() > 1e-14 {
        matrix -= matrix * excess * 0.5;
        excess = excess_of(&matrix);
    }
    Ok(Rotation3::from_matrix_unchecked(matrix))
}
