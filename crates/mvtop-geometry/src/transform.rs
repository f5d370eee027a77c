//! Rigid transforms from numbers, checked: rounding is taken out, mistakes are refused.
//!
//! A transform `a_from_b` takes coordinates of frame b to frame a.

mod json;

use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

pub use json::from_json;

/// How far a rotation may be from exact before it is taken for a mistake rather than for rounding.
const TOLERANCE: f64 = 1e-3;
/// What rounding alone may do to a rotation: what is exact up to this stays as it is, so that a rig
/// that was written is read back the same.
const ROUNDING: f64 = 1e-14;
/// Longest translation that is believed, metres: the Earth's size, for geocentric worlds.
const FARTHEST: f64 = 1e7;

/// Why numbers are no rigid transform; a sentence without the transform's name.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TransformError {
    /// A number is NaN or infinite.
    #[error("its numbers must be finite, got {0}")]
    NotFinite(f64),

    /// The matrix does not end in 0 0 0 1.
    #[error(
        "the last row must be [0, 0, 0, 1], got {last_row:?}{}",
        if *in_columns { "; it looks like a matrix in columns, so transpose it" } else { "" }
    )]
    LastRow {
        /// What came instead.
        last_row: [f64; 4],
        /// The last column is that of a matrix written in columns.
        in_columns: bool,
    },

    /// Left-handed axes.
    #[error(
        "it is a reflection (determinant -1), not a rotation; use right-handed axes, x right, y \
         down, z forward for the camera"
    )]
    Reflection,

    /// A 3x3 part with a scale or a shear.
    #[error(
        "the upper left 3x3 part is not a rotation (determinant {determinant:.4}, its columns are \
         off from orthonormal by {off:.1e}, {TOLERANCE:.0e} allowed)"
    )]
    NotRotation {
        /// Of the 3x3 part; 1 for a rotation.
        determinant: f64,
        /// Largest entry of `RᵀR - 1`.
        off: f64,
    },

    /// A quaternion of another length than 1.
    #[error("its quaternion must have the norm 1, got {0:.4}")]
    Norm(f64),

    /// A translation of more than 10 000 km, in metres.
    #[error("its translation of {0:.1e} m is not credible")]
    TooFar(f64),
}

/// The transform of a homogeneous matrix.
///
/// - `rows`: of the matrix, rotation and translation in metres; the last one is 0 0 0 1
///
/// # Errors
/// [`TransformError`] for a part that is no rotation up to 0.001, a translation of more than
/// 10 000 km, another last row, or a number that is not finite.
///
/// ```
/// use mvtop_geometry::transform::{TransformError, from_matrix};
///
/// let mut rows = [[1., 0., 0., 0.1], [0., 1., 0., 0.], [0., 0., 1., 0.8], [0., 0., 0., 1.]];
/// let world_from_cam = from_matrix(&rows)?;
/// assert_eq!(world_from_cam.translation.vector.as_slice(), [0.1, 0.0, 0.8]);
/// rows[2][2] = -1.0;
/// assert_eq!(from_matrix(&rows), Err(TransformError::Reflection));
/// # Ok::<(), TransformError>(())
/// ```
pub fn from_matrix(rows: &[[f64; 4]; 4]) -> Result<Isometry3<f64>, TransformError> {
    finite(rows.as_flattened())?;
    let [a, b, c, last_row] = *rows;
    if last_row != [0.0, 0.0, 0.0, 1.0] {
        let in_columns = [a[3], b[3], c[3]] == [0.0; 3];
        return Err(TransformError::LastRow {
            last_row,
            in_columns,
        });
    }
    from_rotation(&[a, b, c].map(|[x, y, z, _]| [x, y, z]), [a[3], b[3], c[3]])
}

/// The transform of a rotation and a translation.
///
/// - `rotation`: rows of the matrix; an error of rounding, up to 0.001, is taken out
/// - `translation`: metres
///
/// # Errors
/// [`TransformError`], as [`from_matrix`].
pub fn from_rotation(
    rotation: &[[f64; 3]; 3],
    translation: [f64; 3],
) -> Result<Isometry3<f64>, TransformError> {
    finite(rotation.as_flattened())?;
    let matrix = Matrix3::from_fn(|row, column| rotation[row][column]);
    with_translation(checked_rotation(matrix)?, translation)
}

/// The transform of a unit quaternion and a translation.
///
/// - `wxyz`: of norm 1 up to 0.001; it is normalised
/// - `translation`: metres
///
/// # Errors
/// [`TransformError`] for a quaternion of another norm, a translation of more than 10 000 km, or a
/// number that is not finite.
pub fn from_quaternion_wxyz(
    wxyz: [f64; 4],
    translation: [f64; 3],
) -> Result<Isometry3<f64>, TransformError> {
    finite(&wxyz)?;
    let [w, x, y, z] = wxyz;
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = unit_norm(&quaternion)?;
    let rotation = match (norm - 1.0).abs() <= ROUNDING {
        true => UnitQuaternion::new_unchecked(quaternion),
        false => UnitQuaternion::new_normalize(quaternion),
    };
    with_translation(rotation, translation)
}

/// Refuses a pose that was put together elsewhere and that none of the functions above would give.
pub(crate) fn check(pose: &Isometry3<f64>) -> Result<(), TransformError> {
    finite(pose.rotation.coords.as_slice())?;
    unit_norm(&pose.rotation)?;
    with_translation(pose.rotation, pose.translation.vector.into()).map(|_| ())
}

fn finite(numbers: &[f64]) -> Result<(), TransformError> {
    match numbers.iter().find(|number| !number.is_finite()) {
        Some(&number) => Err(TransformError::NotFinite(number)),
        None => Ok(()),
    }
}

/// The norm, refused where it is not 1.
fn unit_norm(quaternion: &Quaternion<f64>) -> Result<f64, TransformError> {
    let norm = quaternion.norm();
    // Not `> TOLERANCE`: overflow must end here too.
    match (norm - 1.0).abs() <= TOLERANCE {
        true => Ok(norm),
        false => Err(TransformError::Norm(norm)),
    }
}

fn with_translation(
    rotation: UnitQuaternion<f64>,
    translation: [f64; 3],
) -> Result<Isometry3<f64>, TransformError> {
    finite(&translation)?;
    let translation = Vector3::from(translation);
    let distance = translation.norm();
    if distance > FARTHEST {
        return Err(TransformError::TooFar(distance));
    }
    Ok(Isometry3::from_parts(translation.into(), rotation))
}

fn checked_rotation(matrix: Matrix3<f64>) -> Result<UnitQuaternion<f64>, TransformError> {
    let determinant = matrix.determinant();
    let off = off_orthonormal(&matrix).amax();
    match nearest_rotation(matrix, TOLERANCE) {
        Some(rotation) if (determinant - 1.0).abs() <= TOLERANCE => {
            Ok(UnitQuaternion::from_rotation_matrix(&rotation))
        }
        None if off <= TOLERANCE => Err(TransformError::Reflection),
        _ => Err(TransformError::NotRotation { determinant, off }),
    }
}

/// The rotation nearest to a matrix that is one but for rounding; what is exact stays as it is.
///
/// - `tolerance`: how far the matrix may be off, in any entry of RᵀR, below 0.1
/// - returns: `None` where it is off by more, or a reflection
///
/// Source: Björck and Bowie, "An Iterative Algorithm for Computing the Best Estimate of an
/// Orthogonal Matrix", 1971.
pub fn nearest_rotation(mut matrix: Matrix3<f64>, tolerance: f64) -> Option<Rotation3<f64>> {
    let mut off = off_orthonormal(&matrix);
    // Not `> tolerance`: overflow to NaN must be refused, too.
    if !(off.amax() <= tolerance && matrix.determinant() > 0.0) {
        return None;
    }
    // Each step squares what it is off by, so three are enough.
    while off.amax() > ROUNDING {
        matrix -= matrix * off * 0.5;
        off = off_orthonormal(&matrix);
    }
    Some(Rotation3::from_matrix_unchecked(matrix))
}

fn off_orthonormal(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    matrix.transpose() * matrix - Matrix3::identity()
}
