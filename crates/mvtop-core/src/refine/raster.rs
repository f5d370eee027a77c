//! What each pixel of a close-up shows of a mesh.

use nalgebra::{Isometry3, Point2, Point3};

use super::part::{BACKGROUND, Part};
use crate::camera::Intrinsics;

/// A vertex in a close-up.
#[derive(Debug, Clone, Copy, Default)]
pub struct Seen {
    /// Close-up's frame, metres.
    pub point: Point3<f64>,
    /// Px.
    pub pixel: Point2<f64>,
}

/// The mesh, drawn into a square picture. Its memory is used again.
#[derive(Default)]
pub struct Raster {
    pub size: usize,
    /// The mesh's vertices.
    pub seen: Vec<Seen>,
    /// Of each pixel: 1/z of what is nearest, 1/m; 0 where the object is not.
    nearness: Vec<f32>,
    /// Of each pixel.
    labels: Vec<u8>,
}

impl Raster {
    /// Draws the mesh; `false` where a part of it is not before the camera.
    ///
    /// - `size`: side of the picture, px
    pub fn draw(
        &mut self,
        part: &Part,
        cam_from_obj: &Isometry3<f64>,
        pinhole: &Intrinsics,
        size: usize,
    ) -> bool {
        self.size = size;
        let focal = pinhole.fx();
        let (cx, cy) = (pinhole.cx(), pinhole.cy());
        self.seen.clear();
        self.seen.extend(part.vertices.iter().map(|vertex| {
            let point = cam_from_obj * vertex;
            let (u, v) = (
                point.x / point.z * focal + cx,
                point.y / point.z * focal + cy,
            );
            Seen {
                point,
                pixel: Point2::new(u, v),
            }
        }));
        self.nearness.clear();
        self.nearness.resize(size * size, 0.0);
        self.labels.clear();
        self.labels.resize(size * size, BACKGROUND);
        if self.seen.iter().any(|seen| seen.point.z <= 1e-3) {
            return false;
        }
        for (triangle, &label) in part.triangles.iter().zip(&part.labels) {
            self.fill(triangle.map(|v| self.seen[v as usize]), label);
        }
        true
    }

    /// Draws a triangle: within it, 1/z is linear in the picture.
    fn fill(&mut self, corners: [Seen; 3], label: u8) {
        let [a, b, c] = corners.map(|corner| corner.pixel);
        let area = (b - a).perp(&(c - a));
        if area.abs() < 1e-9 {
            return;
        }
        let last = self.size as f64 - 1.0;
        let range = |axis: usize| {
            let [a, b, c] = [a, b, c].map(|p| p[axis]);
            let low = a.min(b).min(c).ceil().max(0.0);
            let high = a.max(b).max(c).floor().min(last);
            (low <= high).then_some((low as usize, high as usize))
        };
        let (Some((left, right)), Some((top, bottom))) = (range(0), range(1)) else {
            return;
        };
        // Weight of each corner, and 1/z: linear in the row and the column, f = f0 + fu·u + fv·v.
        let weight = |from: Point2<f64>, to: Point2<f64>| {
            let (du, dv) = ((to.x - from.x) / area, (to.y - from.y) / area);
            [dv * from.x - du * from.y, -dv, du]
        };
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let near = corners.map(|corner| 1.0 / corner.point.z);
        let nearness: [f64; 3] =
            std::array::from_fn(|i| (0..3).map(|corner| near[corner] * weights[corner][i]).sum());
        for row in top..=bottom {
            let v = row as f64;
            let begin = |[f, fu, fv]: [f64; 3]| f + fv * v + fu * left as f64;
            let [mut wa, mut wb, mut wc] = weights.map(begin);
            let mut near = begin(nearness);
            let line = row * self.size;
            for index in line + left..=line + right {
                if wa >= 0.0 && wb >= 0.0 && wc >= 0.0 && near as f32 > self.nearness[index] {
                    self.nearness[index] = near as f32;
                    self.labels[index] = label;
                }
                wa += weights[0][1];
                wb += weights[1][1];
                wc += weights[2][1];
                near += nearness[1];
            }
        }
    }

    /// Index of the pixel nearest to a place in the picture, if it is one.
    pub fn index(&self, at: Point2<f64>) -> Option<usize> {
        let (u, v) = (at.x + 0.5, at.y + 0.5);
        let inside = |x: f64| x >= 0.0 && x < self.size as f64;
        (inside(u) && inside(v)).then(|| v as usize * self.size + u as usize)
    }

    /// What a pixel shows.
    pub fn label(&self, index: usize) -> u8 {
        self.labels[index]
    }

    /// How far away is what it shows, metres; infinite for the background.
    pub fn depth(&self, index: usize) -> f64 {
        1.0 / f64::from(self.nearness[index])
    }

    /// What all pixels show.
    pub fn labels(&self) -> &[u8] {
        &self.labels
    }
}
