//! Reading rigid transforms.

use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;

use super::fields::{Checked, Fields, numbers, show};

/// How far a rotation may be from exact before it is taken for a mistake rather than for rounding.
const TOLERANCE: f64 = 1e-3;
/// Longest translation that is believed, metres: the Earth's size, for geocentric worlds.
const FARTHEST: f64 = 1e7;

/// A transform as a 4x4 matrix in rows, or as `t` with `q_wxyz` or `q_xyzw`.
///
/// - `place`: how to name it in an error
/// - `unit`: metres per unit of its translation
pub fn read(place: String, value: &Value, unit: f64) -> Checked<Isometry3<f64>> {
    let (translation, rotation) = match value {
        Value::Array(rows) => from_matrix(&place, rows),
        Value::Object(_) => from_parts(&place, value),
        other => Err(format!(
            "{place} must be a 4x4 matrix in rows or an object with `t` and `q_wxyz` or \
             `q_xyzw`, got {}",
            show(other)
        )),
    }?;
    let translation = translation * unit;
    if translation.norm() > FARTHEST {
        return Err(format!(
            "{place}: its translation of {:.1e} m is not credible",
            translation.norm()
        ));
    }
    Ok(Isometry3::from_parts(
        Translation3::from(translation),
        rotation,
    ))
}

fn from_matrix(place: &str, rows: &[Value]) -> Checked<(Vector3<f64>, UnitQuaternion<f64>)> {
    let row = |i: usize| -> Option<[f64; 4]> { numbers(rows.get(i)?)?.try_into().ok() };
    let (Some(a), Some(b), Some(c), Some(last), 4) = (row(0), row(1), row(2), row(3), rows.len())
    else {
        return Err(format!("{place} must be 4 rows of 4 finite numbers"));
    };
    if last != [0.0, 0.0, 0.0, 1.0] {
        let hint = if [a[3], b[3], c[3]] == [0.0; 3] {
            "; it looks like a matrix in columns, so transpose it"
        } else {
            ""
        };
        return Err(format!(
            "{place}: the last row must be [0, 0, 0, 1], got {last:?}{hint}"
        ));
    }
    let matrix = Matrix3::new(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]);
    Ok((Vector3::new(a[3], b[3], c[3]), rotation(place, &matrix)?))
}

/// The rotation nearest to a matrix that is one but for rounding.
fn rotation(place: &str, matrix: &Matrix3<f64>) -> Checked<UnitQuaternion<f64>> {
    let determinant = matrix.determinant();
    let off = (matrix.transpose() * matrix - Matrix3::identity())
        .abs()
        .max();
    if off <= TOLERANCE && determinant < 0.0 {
        return Err(format!(
            "{place} is a reflection (determinant -1), not a rotation; use right-handed axes, x \
             right, y down, z forward for the camera"
        ));
    }
    // Not `off > TOLERANCE`: overflow to NaN must end here too.
    if !(off <= TOLERANCE && (determinant - 1.0).abs() <= TOLERANCE) {
        return Err(format!(
            "{place}: the upper left 3x3 part is not a rotation (determinant {determinant:.4}, \
             its columns are off from orthonormal by {off:.1e}, {TOLERANCE:.0e} allowed)"
        ));
    }
    let svd = matrix.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(format!(
            "{place}: the upper left 3x3 part is not a rotation"
        ));
    };
    Ok(UnitQuaternion::from_rotation_matrix(
        &Rotation3::from_matrix_unchecked(u * v_t),
    ))
}

fn from_parts(place: &str, value: &Value) -> Checked<(Vector3<f64>, UnitQuaternion<f64>)> {
    let fields = Fields::new(place.to_owned(), value, &["t"], &["q_wxyz", "q_xyzw"])?;
    let key = match (fields.optional("q_wxyz"), fields.optional("q_xyzw")) {
        (Some(_), None) => "q_wxyz",
        (None, Some(_)) => "q_xyzw",
        (Some(_), Some(_)) => {
            return Err(format!("{place}: give only one of `q_wxyz` and `q_xyzw`"));
        }
        (None, None) => {
            return Err(format!(
                "{place}: the rotation is missing, give `q_wxyz` or `q_xyzw`"
            ));
        }
    };
    let t: [f64; 3] = (fields.numbers("t")?.try_into())
        .map_err(|t: Vec<f64>| format!("{place}: `t` must be 3 numbers, got {}", t.len()))?;
    let q: [f64; 4] = (fields.numbers(key)?.try_into())
        .map_err(|q: Vec<f64>| format!("{place}: `{key}` must be 4 numbers, got {}", q.len()))?;
    let [w, x, y, z] = if key == "q_wxyz" {
        q
    } else {
        [q[3], q[0], q[1], q[2]]
    };
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if (norm - 1.0).abs() > TOLERANCE {
        return Err(format!(
            "{place}: `{key}` must have the norm 1, got {norm:.4}"
        ));
    }
    Ok((Vector3::from(t), UnitQuaternion::new_normalize(quaternion)))
}
