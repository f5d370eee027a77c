//! Reading BOP's JSON files.

use std::path::Path;

use nalgebra::Isometry3;
use serde::de::DeserializeOwned;

use crate::{Error, Result};
use mvtop_core::transform;

/// Metres per unit of a file.
pub(super) const MM: f64 = 1e-3;

/// - `expected`: what the file should hold, for the error
///
/// # Errors
/// [`Error::Read`] where it cannot be read, [`Error::Json`] where it holds something else.
pub(crate) fn read<T: DeserializeOwned>(path: &Path, expected: &str) -> Result<T> {
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
pub(super) fn motion(place: String, r: &[f64; 9], t: &[f64; 3]) -> Result<Isometry3<f64>> {
    let rows = [[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]];
    transform::from_rotation(&rows, t.map(|x| x * MM))
        .map_err(|cause| Error::Transform { name: place, cause })
}
