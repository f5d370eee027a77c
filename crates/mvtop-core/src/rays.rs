//! Lines of sight: where each cell of the network's feature maps looks.

use glam::{Mat3, Vec3};
use nalgebra::{Isometry3, Point2, Vector3};
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::BBox;
use crate::camera::Camera;
use crate::image::Letterbox;

/// Enlarges the half widths of a box's lines of sight towards the size of its other numbers.
const EXTENT_SCALE: f64 = 10.0;

/// What a line of sight is encoded as: unit direction `d`, origin `o` (metres), moment `d x o`.
///
/// The moment has the sign that the MVTOP paper prints, the opposite of the textbooks' `o x d`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LosEncoding {
    /// `[d]`
    Direction,
    /// `[o, d]`
    OriginDirection,
    /// `[d, d x o]`
    Plucker,
    /// `[d, d x o, o]`
    PluckerOrigin,
}

impl LosEncoding {
    /// Every encoding.
    pub const ALL: [Self; 4] = [
        Self::Direction,
        Self::OriginDirection,
        Self::Plucker,
        Self::PluckerOrigin,
    ];

    /// Numbers per line of sight.
    pub fn width(self) -> usize {
        match self {
            Self::Direction => 3,
            Self::OriginDirection | Self::Plucker => 6,
            Self::PluckerOrigin => 9,
        }
    }
}

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
        let m = d.cross(o);
        let parts = match encoding {
            LosEncoding::Direction => &[d][..],
            LosEncoding::OriginDirection => &[o, d],
            LosEncoding::Plucker => &[d, m],
            LosEncoding::PluckerOrigin => &[d, m, o],
        };
        let numbers = parts.iter().flat_map(|part| part.to_array());
        line.iter_mut().zip(numbers).for_each(|(out, x)| *out = x);
    }
    lines
}

/// Lines of sight of a box, in its camera's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoxRays {
    /// Unit direction through the box's center, `ray(xc, yc)`.
    pub center: Vector3<f64>,
    /// Half the way from the left side's direction to the right one's,
    /// `(ray(x1, yc) - ray(x0, yc)) / 2`.
    pub half_x: Vector3<f64>,
    /// The same from the top to the bottom side, `(ray(xc, y1) - ray(xc, y0)) / 2`.
    pub half_y: Vector3<f64>,
}

impl BoxRays {
    /// Of a box in the camera's image; `None` where one of its pixels has no ray.
    pub fn new(camera: &Camera, bbox: BBox) -> Option<Self> {
        let ray = |u, v| {
            let ray = camera.intrinsics().unproject(&Point2::new(u, v))?;
            Some(ray.into_inner())
        };
        let (BBox { x0, y0, x1, y1 }, center) = (bbox, bbox.center());
        Some(Self {
            center: ray(center.x, center.y)?,
            half_x: (ray(x1, center.y)? - ray(x0, center.y)?) / 2.0,
            half_y: (ray(center.x, y1)? - ray(center.x, y0)?) / 2.0,
        })
    }

    /// What the network is told of the box: `[o, d, 10 e_x, 10 e_y]`, camera center (metres), center
    /// direction and half widths, in the reference camera's frame.
    pub fn encode(&self, ref_from_cam: &Isometry3<f64>) -> [f32; 12] {
        let turn = &ref_from_cam.rotation;
        let parts = [
            ref_from_cam.translation.vector,
            turn * self.center,
            turn * self.half_x * EXTENT_SCALE,
            turn * self.half_y * EXTENT_SCALE,
        ];
        std::array::from_fn(|i| parts[i / 3][i % 3] as f32)
    }
}
