//! Depth images of a mesh: a rasteriser with a depth buffer, for VSD.

use nalgebra::{Isometry3, Vector3};
use ndarray::Array2;
use rayon::prelude::*;

use crate::{Error, Result};
use mvtop_core::camera::Intrinsics;
use mvtop_core::mesh::Mesh;

/// `[height, width]`: z coordinate in the camera frame of what each pixel shows, 0 for nothing.
pub type DepthImage = Array2<f32>;

/// Rows that one task fills.
const BAND: usize = 16;

/// Which point of a pixel decides what it shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PixelCenter {
    /// Pixel (0, 0) is centered at u = 0, v = 0: mvtop's and BOP's data sets' convention, and that
    /// of bop_toolkit's distance images.
    #[default]
    Integer,
    /// At u = 0.5, v = 0.5: what bop_toolkit's OpenGL renderers do with the same intrinsics, half
    /// a pixel beside its distance images. To compare with its VSD scores.
    Half,
}

/// A triangle as the camera sees it, in the homogeneous form of Olano and Greer: a point of the
/// ray r lies within it where the three `edges` have the same sign on r. Nothing is divided by
/// z, so triangles that reach behind the camera need no clipping.
struct Triangle {
    /// Plane through the camera's center and each edge; all positive on a ray that meets it.
    edges: [Vector3<f64>; 3],
    /// Sum of the edges: depth along a ray r with r.z = 1 is `volume / (sum · r)`.
    sum: Vector3<f64>,
    volume: f64,
    /// First and last column and row that may show it.
    columns: [usize; 2],
    rows: [usize; 2],
}

/// What the rays of an image's pixels are.
struct Pixels {
    intrinsics: Intrinsics,
    offset: f64,
    width: usize,
    height: usize,
}

/// Depth image of a mesh, both of whose sides are seen; in the unit of its vertices and of the pose.
///
/// # Errors
/// [`Error::Input`] for a camera with distortion, which bends edges: undistort first.
///
/// Source: Olano and Greer, "Triangle Scan Conversion using 2D Homogeneous Coordinates", 1997.
pub fn depth(
    mesh: &Mesh,
    cam_from_obj: &Isometry3<f64>,
    intrinsics: &Intrinsics,
    [width, height]: [u32; 2],
    center: PixelCenter,
) -> Result<DepthImage> {
    if !intrinsics.is_pinhole() {
        return Err(Error::Input(
            "depth image: expected an ideal pinhole, got a camera with distortion; undistort the \
             image and give the intrinsics that remain"
                .into(),
        ));
    }
    let pixels = Pixels {
        intrinsics: intrinsics.clone(),
        offset: match center {
            PixelCenter::Integer => 0.0,
            PixelCenter::Half => 0.5,
        },
        width: width as usize,
        height: height as usize,
    };
    let vertices = mesh.vertices().iter();
    let in_camera: Vec<_> = vertices.map(|p| (cam_from_obj * p).coords).collect();
    let seen = |t: &[u32; 3]| Triangle::new(t.map(|v| in_camera[v as usize]), &pixels);
    let seen: Vec<Triangle> = mesh.triangles().par_iter().filter_map(seen).collect();
    let mut image = DepthImage::zeros((pixels.height, pixels.width));
    if let Some(rows) = image.as_slice_mut().filter(|rows| !rows.is_empty()) {
        let bands = rows.par_chunks_mut(BAND * pixels.width).enumerate();
        bands.for_each(|(i, band)| {
            for triangle in &seen {
                triangle.fill(band, i * BAND, &pixels);
            }
        });
    }
    Ok(image)
}

impl Triangle {
    /// `None` where no pixel can show it.
    fn new([a, b, c]: [Vector3<f64>; 3], pixels: &Pixels) -> Option<Self> {
        let mut edges = [b.cross(&c), c.cross(&a), a.cross(&b)];
        let mut volume = a.dot(&edges[0]);
        if volume == 0.0 {
            return None; // seen from its edge
        }
        if volume < 0.0 {
            edges = edges.map(|edge| -edge);
            volume = -volume;
        }
        let corners = [a, b, c];
        if corners.iter().all(|p| p.z <= 0.0) {
            return None;
        }
        let (mut u, mut v) = ([0.0, f64::INFINITY, 0.0], [0.0, f64::INFINITY, 0.0]);
        if corners.iter().all(|p| p.z > 0.0) {
            let intrinsics = &pixels.intrinsics;
            let along = |p: Vector3<f64>| intrinsics.fx() * p.x + intrinsics.skew() * p.y;
            u = corners.map(|p| along(p) / p.z + intrinsics.cx() - pixels.offset);
            v = corners.map(|p| intrinsics.fy() * p.y / p.z + intrinsics.cy() - pixels.offset);
        }
        Some(Self {
            sum: edges[0] + edges[1] + edges[2],
            edges,
            volume,
            columns: range(u, pixels.width)?,
            rows: range(v, pixels.height)?,
        })
    }

    /// - `band`: rows of the image from `top` on
    fn fill(&self, band: &mut [f32], top: usize, pixels: &Pixels) {
        let (intrinsics, offset, width) = (&pixels.intrinsics, pixels.offset, pixels.width);
        let last = self.rows[1].min(top + band.len() / width - 1);
        let [left, right] = self.columns;
        for row in self.rows[0].max(top)..=last {
            let y = (row as f64 + offset - intrinsics.cy()) / intrinsics.fy();
            let middle = intrinsics.cx() + intrinsics.skew() * y;
            let in_row = self.edges.map(|edge| edge.y * y + edge.z);
            let sum_in_row = self.sum.y * y + self.sum.z;
            let first = (row - top) * width;
            let shown = &mut band[first + left..=first + right];
            for (column, nearest) in (left..).zip(shown) {
                let x = (column as f64 + offset - middle) / intrinsics.fx();
                let meets = (0..3).all(|i| self.edges[i].x * x + in_row[i] >= 0.0);
                // On the other side of the camera the edges have the sum's sign, too.
                let sum = self.sum.x * x + sum_in_row;
                if meets && sum > 0.0 {
                    let depth = (self.volume / sum) as f32;
                    if *nearest == 0.0 || depth < *nearest {
                        *nearest = depth;
                    }
                }
            }
        }
    }
}

/// Whole numbers from the least to the greatest coordinate, within an image of `size`; `None` for
/// none.
fn range(coordinates: [f64; 3], size: usize) -> Option<[usize; 2]> {
    let least = coordinates.into_iter().fold(f64::INFINITY, f64::min);
    let greatest = coordinates.into_iter().fold(f64::NEG_INFINITY, f64::max);
    let last = (size as f64 - 1.0).min(greatest.floor());
    let first = least.ceil().max(0.0);
    (first <= last).then_some([first as usize, last as usize])
}

/// Distance from the camera's center of a point that is `depth` before the camera: an entry of
/// `depth_im_to_dist_im` of bop_toolkit.
pub(super) fn distance(depth: f64, intrinsics: &Intrinsics, row: usize, column: usize) -> f64 {
    let y = (row as f64 - intrinsics.cy()) / intrinsics.fy();
    let x = (column as f64 - intrinsics.cx() - intrinsics.skew() * y) / intrinsics.fx();
    let (x, y) = (x * depth, y * depth);
    (x * x + y * y + depth * depth).sqrt()
}

#[cfg(test)]
mod tests;
