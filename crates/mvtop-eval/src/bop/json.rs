//! Reading BOP's JSON files.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;
use std::path::Path;

use nalgebra::{Isometry3, Matrix3, Rotation3};
use serde::Deserialize;
use serde::de::{DeserializeOwned, Deserializer, Error as _, MapAccess, Visitor};

use crate::{Error, Result};
pub(super) use mvtop_core::json::read;
use mvtop_core::transform;
use mvtop_geometry::Error as Geometry;

/// Metres per unit of a file.
pub(super) const MM: f64 = 1e-3;

/// How far a rotation of a file may be off, in any entry of RᵀR: some data sets come with few digits.
pub(super) const ROTATION_TOLERANCE: f64 = 2e-2;
/// What is off by more is said: no rotation that was computed and written with care is.
pub const ROUNDED: f64 = 1e-3;

/// Reads a file whose keys are numbers, of images or objects, with leading zeros or without.
///
/// # Errors
/// As [`read`], and where a number comes twice, as 1 and 000001.
pub(super) fn read_numbered<T: DeserializeOwned>(
    path: &Path,
    expected: &str,
) -> Result<BTreeMap<u32, T>> {
    let Numbered(map) = read(path, expected)?;
    Ok(map)
}

struct Numbered<T>(BTreeMap<u32, T>);

struct Numbers<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Numbered<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(Numbers(PhantomData))
    }
}

impl<'de, T: Deserialize<'de>> Visitor<'de> for Numbers<T> {
    type Value = Numbered<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with numbers as keys")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut numbered = BTreeMap::new();
        while let Some(key) = map.next_key::<String>()? {
            let number = key
                .parse::<u32>()
                .map_err(|_| A::Error::custom(format!("a key that is no whole number, `{key}`")))?;
            if numbered.insert(number, map.next_value()?).is_some() {
                let twice = format!("the number {number} comes twice as a key");
                return Err(A::Error::custom(twice));
            }
        }
        Ok(Numbered(numbered))
    }
}

/// A motion of a file, millimetres, as one in metres.
///
/// - `r`: row by row
pub(super) fn motion(place: &str, r: &[f64; 9], t: &[f64; 3]) -> Result<Isometry3<f64>> {
    let (rotation, _) =
        rotation(r).map_err(|problem| Error::Data(format!("{place}: {problem}")))?;
    let rows = rotation.into_inner().transpose().into();
    let moved = transform::from_rotation(&rows, t.map(|x| x * MM));
    moved.map_err(|cause| {
        let name = place.to_owned();
        Geometry::Transform { name, cause }.into()
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

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(text: &str) -> Result<BTreeMap<u32, f64>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene_camera.json");
        std::fs::write(&path, text).unwrap();
        read_numbered(&path, "{IMAGE: number}")
    }

    #[test]
    fn numbers_may_have_leading_zeros_but_come_once() {
        let read = numbered(r#"{"000012": 1.5, "3": 2.0, "0": 0.5}"#).unwrap();
        assert_eq!(read, BTreeMap::from([(0, 0.5), (3, 2.0), (12, 1.5)]));
        for (text, hint) in [
            (r#"{"000012": 1, "12": 2}"#, "the number 12 comes twice"),
            (r#"{"cam1": 1}"#, "no whole number, `cam1`"),
            ("[1]", "an object with numbers as keys"),
        ] {
            let error = numbered(text).unwrap_err().to_string();
            assert!(error.contains(hint), "{error}");
        }
    }
}
