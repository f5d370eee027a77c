//! Rotations and poses: from the network's numbers, and their errors against the truth.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::{Error, Result};

/// Shortest vector whose direction is trusted.
const SHORTEST: f64 = 1e-9;

/// Rotation whose columns `[x y z]` come from two vectors: `x = a/|a|`, `z = x × b` normalised,
/// `y = z × x`.
///
/// - `values`: `a` (3), then `b` (3)
///
/// # Errors
/// [`Error::Rotation6d`] where a vector is zero or not finite, or the two are parallel.
///
/// Source: Zhou et al., "On the Continuity of Rotation Representations in Neural Networks", 2019.
pub fn rotation_from_6d(values: [f64; 6]) -> Result<Rotation3<f64>> {
    let unit = |v: Vector3<f64>| v.try_normalize(SHORTEST).filter(|u| u.norm() > 0.5);
    let [a0, a1, a2, b0, b1, b2] = values;
    let columns = || {
        let x = unit(Vector3::new(a0, a1, a2))?;
        let z = unit(x.cross(&unit(Vector3::new(b0, b1, b2))?))?;
        Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
    };
    columns()
        .map(Rotation3::from_matrix_unchecked)
        .ok_or(Error::Rotation6d(values))
}

/// Angle of the rotation between two orientations, degrees, in `[0, 180]`.
///
/// `atan2(sin, cos)` of the half angle: exact near 0° and 180°, where the trace's arc cosine is not.
pub fn rotation_error_deg(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    let between = a.inverse() * b;
    2.0 * between.imag().norm().atan2(between.w.abs()).to_degrees()
}

/// Distance between two poses' origins, in their unit.
pub fn translation_error(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.translation.vector - b.translation.vector).norm()
}

/// `[w, x, y, z]` of the two quaternions of a rotation the one with `w >= 0`.
pub fn wxyz(rotation: &UnitQuaternion<f64>) -> [f64; 4] {
    let q = rotation.into_inner() * if rotation.w < 0.0 { -1.0 } else { 1.0 };
    // Adding zero turns -0 into 0.
    [q.w + 0.0, q.i + 0.0, q.j + 0.0, q.k + 0.0]
}
