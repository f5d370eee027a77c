//! The network's rotations.

use pyo3::prelude::*;

use crate::convert::{self, ArrayLike, F64, shaped};
use crate::error::python;

/// Rotations from six numbers (Zhou et al. 2019): a, then b; columns x = a/|a|,
/// z = (x × b)/|x × b|, y = z × x.
///
/// Parameters
/// ----------
/// values : array, (..., 6)
///
/// Returns
/// -------
/// array, (..., 3, 3)
///
/// Raises
/// ------
/// ValueError
///     Where a or b is 0, or the two are parallel.
#[pyfunction]
pub fn rotation_from_6d(values: ArrayLike) -> PyResult<F64> {
    let values = values.any_number::<f64>("values", None, &[6])?;
    let mut shape = values.shape().to_vec();
    shape.pop();
    shape.extend([3, 3]);
    let numbers: Vec<f64> = values.iter().copied().collect();
    let mut rows = Vec::with_capacity(numbers.len() / 2 * 3);
    for six in numbers.chunks_exact(6) {
        let six = std::array::from_fn(|i| six[i]);
        let rotation = mvtop_core::pose::rotation_from_6d(six).map_err(python)?;
        rows.extend(convert::rotation_rows(&rotation));
    }
    Ok(F64(shaped(&shape, rows)?))
}
