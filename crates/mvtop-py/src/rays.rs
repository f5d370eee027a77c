//! Lines of sight.

use mvtop_core::image::Letterbox;
use mvtop_core::rays::{BoxRays, LosEncoding};
use ndarray::Ix2;
use pyo3::prelude::*;

use crate::camera::Camera;
use crate::convert::{ArrayLike, F32, axes};
use crate::error::value;
use crate::process::compute;

/// Most lines of sight at a time: 600 times those of a network, and 0.2 GB.
const MOST_CELLS: u64 = 1 << 24;

/// Direction in which each cell of the network's feature maps looks, in the camera's own frame.
///
/// Parameters
/// ----------
/// strides
///     Of the levels, network pixels per cell.
/// net_size
///     Width and height of the network's input, px, into which the image is scaled to fit; the
///     image's own by default.
///
/// Returns
/// -------
/// array, (N, 3), float32
///     Of length 1, levels in the order of strides, each row by row; 0 for cells that lie in
///     the padding or that no ray meets.
#[pyfunction]
#[pyo3(signature = (camera, strides, *, net_size = None))]
pub fn camera_rays(
    py: Python,
    camera: PyRef<Camera>,
    strides: Vec<usize>,
    net_size: Option<(u32, u32)>,
) -> PyResult<F32> {
    let camera = camera.core();
    let (width, height) = net_size.unwrap_or((camera.width(), camera.height()));
    if strides.contains(&0) || width == 0 || height == 0 {
        return Err(value(format!(
            "strides and net_size: expected numbers above 0, got {strides:?} and {width}x{height}"
        )));
    }
    let cells = |&stride: &usize| {
        let along = |side: u32| (side as u64).div_ceil(stride as u64);
        along(width) * along(height)
    };
    let cells = strides.iter().map(cells).fold(0_u64, u64::saturating_add);
    if cells > MOST_CELLS {
        return Err(value(format!(
            "strides and net_size: expected {MOST_CELLS} cells at most, got {cells} of strides \
             {strides:?} in {width}x{height} px"
        )));
    }
    let letterbox = Letterbox::new(camera.width(), camera.height(), width, height);
    let rays = || mvtop_core::rays::camera_rays(camera, &letterbox, &strides);
    Ok(F32(compute(py, rays)?.into_dyn()))
}

/// Lines of sight in the reference camera's frame: unit direction d, origin o, moment d x o, as the
/// paper prints it (textbooks write o x d).
///
/// Parameters
/// ----------
/// camera_rays : array, (N, 3)
///     Directions in the camera's frame; 0 where there is none.
/// ref_from_cam : array, (4, 4)
///     Metres.
/// encoding
///     "direction" [d], "origin_direction" [o, d], "plucker" [d, d x o] or "plucker_origin" [d,
///     d x o, o].
///
/// Returns
/// -------
/// array, (N, 3, 6 or 9), float32
///     0 where there is no ray.
#[pyfunction]
#[pyo3(signature = (camera_rays, ref_from_cam, encoding = "plucker"))]
pub fn encode_rays(
    py: Python,
    camera_rays: ArrayLike,
    ref_from_cam: ArrayLike,
    encoding: &str,
) -> PyResult<F32> {
    let encoding: LosEncoding = serde_json::from_value(encoding.into()).map_err(|_| {
        value(format!(
            "encoding: expected \"direction\", \"origin_direction\", \"plucker\" or \
             \"plucker_origin\", got {encoding:?}"
        ))
    })?;
    let rays = camera_rays.read("camera_rays", Some(1), &[3])?;
    let rays = axes::<_, Ix2>("camera_rays", rays)?;
    let pose = ref_from_cam.pose("ref_from_cam")?;
    let lines = py.detach(|| mvtop_core::rays::encode(rays.view(), &pose, encoding));
    Ok(F32(lines.into_dyn()))
}

/// Lines of sight of a box: camera center o, direction d through the box's center, and how far the
/// directions to its sides lie to the left and right, and above and below.
///
/// Parameters
/// ----------
/// box
///     x0, y0, x1, y1, px of the image.
/// ref_from_cam : array, (4, 4)
///     Metres.
///
/// Returns
/// -------
/// array, (12,), float32
///     [o, d, 10 e_x, 10 e_y] in the reference camera's frame; None where a pixel of it has no
///     ray.
#[pyfunction]
pub fn box_rays(
    camera: PyRef<Camera>,
    r#box: ArrayLike,
    ref_from_cam: ArrayLike,
) -> PyResult<Option<F32>> {
    let bbox: [f64; 4] = r#box.vector("box")?;
    let pose = ref_from_cam.pose("ref_from_cam")?;
    let rays = BoxRays::new(camera.core(), bbox.into());
    Ok(rays.map(|rays| F32(ndarray::arr1(&rays.encode(&pose)).into_dyn())))
}
