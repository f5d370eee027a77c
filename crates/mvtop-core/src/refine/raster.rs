//! Depth and segment of each pixel of a crop, rendered from the mesh.

use std::ops::Range;

use nalgebra::{Isometry3, Point2, Point3};

use super::mesh_model::{BACKGROUND, MeshModel};
use crate::Camera;

mod triangles;

use self::triangles::{LANES, draw, whole};

/// A vertex in a crop.
#[derive(Debug, Clone, Copy, Default)]
pub struct ProjectedVertex {
    /// Crop's frame, metres.
    pub point: Point3<f64>,
    /// Px.
    pub pixel: Point2<f64>,
    /// 1/z, 1/m.
    near: f64,
}

/// The rendered mesh. Its memory is reused.
#[derive(Default)]
pub struct Raster {
    pub size: usize,
    /// The mesh's vertices.
    pub vertices: Vec<ProjectedVertex>,
    /// 1/z of the nearest surface in each pixel, 1/m; 0 in the background. `LANES` more than pixels.
    nearness: Vec<f32>,
    /// Segment in each pixel. `LANES` more than pixels.
    labels: Vec<u8>,
    /// Columns and rows beyond which there is only background.
    drawn: [Range<usize>; 2],
    /// Least `nearness` in each square of `SQUARE` px a side.
    farthest: Vec<f32>,
    /// Indices of triangles that are drawn last.
    backs: Vec<usize>,
}

impl Raster {
    /// Renders the mesh; `false` if a part of it is not in front of the camera.
    ///
    /// - `camera`: a pinhole with a square image
    pub fn render(&mut self, mesh: &MeshModel, camera: &Camera, pose: &Isometry3<f64>) -> bool {
        self.clear(camera.width() as usize);
        let (pinhole, cam_from_obj) = (camera.intrinsics(), camera.world_from_cam().inv_mul(pose));
        let (focal, cx, cy) = (pinhole.fx(), pinhole.cx(), pinhole.cy());
        self.vertices.clear();
        self.vertices.extend(mesh.vertices.iter().map(|vertex| {
            let point = cam_from_obj * vertex;
            let near = 1.0 / point.z;
            let (u, v) = (point.x * near * focal + cx, point.y * near * focal + cy);
            ProjectedVertex {
                point,
                pixel: Point2::new(u, v),
                near,
            }
        }));
        if self.vertices.iter().any(|vertex| vertex.point.z <= 1e-3) {
            return false;
        }
        self.drawn = [0, 1].map(|axis| {
            let places = self.vertices.iter().map(|vertex| vertex.pixel[axis]);
            let (least, most) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| {
                (if x < a { x } else { a }, if x > b { x } else { b })
            });
            whole(least.max(0.0), most.min(self.size as f64 - 1.0))
        });
        draw(self, mesh);
        true
    }

    /// Removes what was drawn.
    fn clear(&mut self, size: usize) {
        let [columns, rows] = std::mem::take(&mut self.drawn);
        if size == self.size {
            for row in rows {
                let line = row * size;
                let span = line + columns.start..line + columns.end;
                self.nearness[span.clone()].fill(0.0);
                self.labels[span].fill(BACKGROUND);
            }
        } else {
            self.size = size;
            self.nearness.clear();
            self.nearness.resize(size * size + LANES, 0.0);
            self.labels.clear();
            self.labels.resize(size * size + LANES, BACKGROUND);
        }
    }

    /// Index of the pixel at a place; `None` outside the picture.
    pub fn index(&self, at: Point2<f64>) -> Option<usize> {
        let (u, v) = (at.x + 0.5, at.y + 0.5);
        let inside = |x: f64| x >= 0.0 && x < self.size as f64;
        (inside(u) && inside(v)).then(|| v as usize * self.size + u as usize)
    }

    /// Segment in a pixel.
    pub fn label(&self, index: usize) -> u8 {
        self.labels[index]
    }

    /// Depth of a pixel, metres; infinite in the background.
    pub fn depth(&self, index: usize) -> f64 {
        1.0 / f64::from(self.nearness[index])
    }

    /// Least depth, metres; infinite without any surface.
    pub fn nearest(&self) -> f64 {
        1.0 / f64::from(self.nearness.iter().copied().fold(0.0, f32::max))
    }

    /// Segments in all pixels.
    pub fn labels(&self) -> &[u8] {
        &self.labels[..self.size * self.size]
    }

    /// Segment and indices of each run of neighbouring pixels of one segment of the object.
    pub fn runs(&self) -> impl Iterator<Item = (u8, Range<usize>)> {
        let rows = &self.drawn[1];
        let mut end = rows.start * self.size;
        let labels = &self.labels[..rows.end * self.size];
        std::iter::from_fn(move || {
            let start = end + alike(&labels[end..], BACKGROUND);
            let label = *labels.get(start)?;
            end = start + alike(&labels[start..], label);
            Some((label, start..end))
        })
    }
}

/// How many labels in front are this one.
fn alike(labels: &[u8], label: u8) -> usize {
    const MANY: usize = 16;
    let many = labels.chunks_exact(MANY);
    let many = MANY * many.take_while(|many| **many == [label; MANY]).count();
    let few = labels[many..].iter().take_while(|one| **one == label);
    many + few.count()
}

#[cfg(test)]
mod tests;
