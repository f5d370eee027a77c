//! Results in BOP's format.

use mvtop_eval::bop::Estimate;
use pyo3::prelude::*;

use crate::convert::ArrayLike;

/// The line of one pose, with its end.
///
/// - cam_from_obj: (4, 4), metres; written as rows of the rotation and millimetres
/// - time_s: what all poses of the image took, seconds; BOP's -1 where that is not known
#[pyfunction]
pub fn bop_results_line(
    scene_id: u32,
    im_id: u32,
    obj_id: u32,
    score: f64,
    cam_from_obj: ArrayLike,
    time_s: f64,
) -> PyResult<String> {
    let pose = cam_from_obj.read::<f64>("cam_from_obj", Some(0), &[4, 4])?;
    let estimate = Estimate {
        obj_id,
        score,
        r: std::array::from_fn(|i| pose[[i / 3, i % 3]]),
        t_mm: std::array::from_fn(|i| 1e3 * pose[[i, 3]]),
    };
    Ok(estimate.csv_line(scene_id, im_id, time_s))
}
