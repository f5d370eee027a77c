//! Reading BOP's JSON files.

use nalgebra::{Isometry3, Matrix3, Rotation3};

use crate::{Error, Result};
pub(super) use mvtop_core::json::read;
use mvtop_core::transform;

/// Metres per unit of a file.
pub(super) const MM: f64 = 1e-3;

/// How far a rotation of a file may be off, in any entry of RᵀR: some data sets come with few digits.
pub(super) const ROTATION_TOLERANCE: f64 = 2e-2;
/// What is off by more is said: no rotation that was computed and written with care is.
pub const ROUNDED: f64 = 1e-3;

/// A motion of a file, millimetres, as one in metres.
///
/// - `r`: row by row
pub(super) fn motion(place: &str, r: &[f64; 9], t: &[f64; 3]) -> Result<Isometry3<f64>> {
    let (rotation, _) =
        rotation(r).map_err(|problem| Error::Data(format!("{place}: {problem}")))?;
    let rows = rotation.into_inner().transpose().into();
    transform::from_rotation(&rows, t.map(|x| x * MM)).map_err(|cause| Error::Transform {
        name: place.to_owned(),
        cause,
    })
}

/// The rotation of a file, without what it was rounded by, and how far it was off: the largest entry
/// of RᵀR - 1.
///
/// - `rows`: row by row
///
/// # Errors
/// What is off by more than 0.02, and a reflection.
pub fn rotation(rows: &[f64; 9]) -> Result<(Rotation3<f64>, f64), String> {
    let matrix = Matrix3::from_row_slice(rows);
    let off = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    let nearest = transform::nearest_rotation(matrix, ROTATION_TOLERANCE).ok_or_else(|| {
        format!("expected a rotation up to {ROTATION_TOLERANCE}, row by row, got {rows:?}")
    })?;
    Ok((nearest, off))
}
