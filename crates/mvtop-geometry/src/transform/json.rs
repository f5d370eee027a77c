//! Reading rigid transforms from JSON.

use nalgebra::Isometry3;
use serde_json::Value;

use super::{TransformError, from_matrix, from_quaternion_wxyz};
use crate::rig::fields::{Checked, Fields, numbers, show};

/// A transform as a 4x4 matrix in rows, or as `t` with `q_wxyz` or `q_xyzw`.
///
/// - `place`: how to name it in an error
/// - `unit`: metres per unit of its translation
///
/// # Errors
/// One sentence that names the place, for anything else and as [`from_matrix`] and
/// [`from_quaternion_wxyz`].
pub fn from_json(place: String, value: &Value, unit: f64) -> Result<Isometry3<f64>, String> {
    match value {
        Value::Array(rows) => {
            let row = |row| -> Option<[f64; 4]> { numbers(row)?.try_into().ok() };
            let rows: Option<Vec<_>> = rows.iter().map(row).collect();
            let Some(mut rows): Option<[[f64; 4]; 4]> = rows.and_then(|r| r.try_into().ok()) else {
                return Err(format!("{place} must be 4 rows of 4 finite numbers"));
            };
            rows[..3].iter_mut().for_each(|row| row[3] *= unit);
            from_matrix(&rows).map_err(|error| format!("{place}: {error}"))
        }
        Value::Object(_) => from_parts(&place, value, unit),
        other => Err(format!(
            "{place} must be a 4x4 matrix in rows or an object with `t` and `q_wxyz` or \
             `q_xyzw`, got {}",
            show(other)
        )),
    }
}

fn from_parts(place: &str, value: &Value, unit: f64) -> Checked<Isometry3<f64>> {
    let fields = Fields::new(place.to_owned(), value, &["t"], &["q_wxyz", "q_xyzw"])?;
    let key = match (fields.optional("q_wxyz"), fields.optional("q_xyzw")) {
        (Some(_), None) => "q_wxyz",
        (None, Some(_)) => "q_xyzw",
        (Some(_), Some(_)) => {
            return Err(format!("{place}: give only one of `q_wxyz` and `q_xyzw`"));
        }
        (None, None) => {
            let problem = "the rotation is missing, give `q_wxyz` or `q_xyzw`";
            return Err(format!("{place}: {problem}"));
        }
    };
    let t: [f64; 3] = (fields.numbers("t")?.try_into())
        .map_err(|t: Vec<f64>| format!("{place}: `t` must be 3 numbers, got {}", t.len()))?;
    let mut q: [f64; 4] = (fields.numbers(key)?.try_into())
        .map_err(|q: Vec<f64>| format!("{place}: `{key}` must be 4 numbers, got {}", q.len()))?;
    if key == "q_xyzw" {
        q.rotate_right(1);
    }
    from_quaternion_wxyz(q, t.map(|x| x * unit)).map_err(|error| match error {
        TransformError::Norm(norm) => {
            format!("{place}: `{key}` must have the norm 1, got {norm:.4}")
        }
        error => format!("{place}: {error}"),
    })
}
