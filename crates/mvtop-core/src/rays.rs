//! Lines of sight: where each cell of the network's feature maps looks.

use glam::{Mat3, Vec3};
use nalgebra::{Isometry3, Point2};
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

use crate::camera::Camera;
use crate::image::Letterbox;
pub use mvtop_geometry::rays::{BoxRays, LosEncoding};

/// Direction in which each feature cell looks, in the camera's own frame.
///
/// - `strides`: of the levels, network pixels per cell; a level has `net_height / stride` rows,
///   rounded up, which share the whole height evenly
/// - returns: `[N, 3]`, unit vectors through the true lens, levels in the order of `strides`, each
///   row by row; 0 for cells whose center lies in the padding or that no ray meets
pub fn camera_rays(camera: &Camera, letterbox: &Letterbox, strides: &[usize]) -> Array2<f32> {
    let mut rays = Vec::new();
    for &stride in strides {
        let size = [letterbox.net_width, letterbox.net_height].map(|size| size as usize);
        let [columns, rows] = size.map(|size| match stride {
            0 => 0,
            _ => size.div_ceil(stride),
        });
        let center = |cell: usize, size: usize, cells: usize| {
            (cell as f64 + 0.5) * size as f64 / cells as f64 - 0.5
        };
        rays.par_extend((0..rows * columns).into_par_iter().map(|cell| {
            let net = [
                center(cell % columns, size[0], columns),
                center(cell / columns, size[1], rows),
            ];
            let [u, v] = letterbox.image_from_net(net);
            let [right, bottom] = [camera.width(), camera.height()].map(|n| f64::from(n) - 0.5);
            let inside = (u <= right && v <= bottom).then(|| Point2::new(u, v));
            let ray = inside.and_then(|pixel| camera.intrinsics().unproject(&pixel));
            ray.map_or([0.0; 3], |ray| [ray.x as f32, ray.y as f32, ray.z as f32])
        }));
    }
    Array2::from(rays)
}

/// Lines of sight in the reference camera's frame.
///
/// - `camera_rays`: `[N, 3]`, from [`camera_rays`]
/// - returns: `[N, encoding.width()]`, unitless directions, metres elsewhere; 0 where there is no
///   ray
pub fn encode(
    camera_rays: ArrayView2<f32>,
    ref_from_cam: &Isometry3<f64>,
    encoding: LosEncoding,
) -> Array2<f32> {
    let rotation = ref_from_cam.rotation.to_rotation_matrix().cast::<f32>();
    let rotation = Mat3::from_cols_slice(rotation.matrix().as_slice());
    let o = Vec3::from_array(ref_from_cam.translation.vector.cast::<f32>().into());
    let mut lines = Array2::zeros((camera_rays.nrows(), encoding.width()));
    for (ray, mut line) in camera_rays.rows().into_iter().zip(lines.rows_mut()) {
        let ray = Vec3::new(ray[0], ray[1], ray[2]);
        if ray == Vec3::ZERO {
            continue;
        }
        let d = rotation * ray;
        let numbers = encoding.line(&d.to_array().into(), &o.to_array().into());
        line.iter_mut().zip(numbers).for_each(|(out, x)| *out = x);
    }
    lines
}
