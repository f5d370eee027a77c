//! What each pixel of a close-up shows of a mesh.

use std::ops::Range;

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
    /// 1/z, 1/m.
    near: f64,
}

/// The mesh, drawn into a square picture. Its memory is used again.
#[derive(Default, Clone)]
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
            let near = 1.0 / point.z;
            let (u, v) = (point.x * near * focal + cx, point.y * near * focal + cy);
            Seen {
                point,
                pixel: Point2::new(u, v),
                near,
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
            self.fill(triangle.map(|v| self.seen[v as usize]), label, part.closed);
        }
        true
    }

    /// Draws a triangle: within it, 1/z is linear in the picture.
    ///
    /// - `closed`: of a closed surface, whose triangles that face away lie behind others
    fn fill(&mut self, corners: [Seen; 3], label: u8, closed: bool) {
        let [a, b, c] = corners.map(|corner| corner.pixel);
        let area = (b - a).perp(&(c - a));
        if area.abs() < 1e-9 || (closed && area > 0.0) {
            return;
        }
        let last = self.size as f64 - 1.0;
        let range = |axis: usize| {
            let [a, b, c] = [a, b, c].map(|p| p[axis]);
            (a.min(b).min(c).max(0.0), a.max(b).max(c).min(last))
        };
        let ((left, right), (top, bottom)) = (range(0), range(1));
        // Weight of each corner, and 1/z: linear in the row and the column, f = f0 + fu·u + fv·v.
        let (by_area, near) = (1.0 / area, corners.map(|corner| corner.near));
        let weight = |from: Point2<f64>, to: Point2<f64>| {
            let (du, dv) = ((to.x - from.x) * by_area, (to.y - from.y) * by_area);
            [dv * from.x - du * from.y, -dv, du]
        };
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let by_slope = weights.map(|[_, fu, _]| 1.0 / fu);
        let nearness: [f64; 3] =
            std::array::from_fn(|i| (0..3).map(|corner| near[corner] * weights[corner][i]).sum());
        for row in whole(top, bottom) {
            let v = row as f64;
            // The columns in which no weight is negative.
            let (mut left, mut right) = (left, right);
            for ([f, _, fv], by_slope) in weights.iter().zip(by_slope) {
                let zero = -(f + fv * v) * by_slope;
                if by_slope > 0.0 {
                    left = left.max(zero);
                } else {
                    right = right.min(zero);
                }
            }
            let columns = whole(left, right);
            if columns.is_empty() {
                continue;
            }
            let mut near = nearness[0] + nearness[2] * v + nearness[1] * columns.start as f64;
            let line = row * self.size;
            let span = line + columns.start..line + columns.end;
            let pixels = self.nearness[span.clone()].iter_mut();
            for (nearest, shown) in pixels.zip(&mut self.labels[span]) {
                if near as f32 > *nearest {
                    (*nearest, *shown) = (near as f32, label);
                }
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

    /// How far away is what is nearest of all, metres; infinite where nothing is shown.
    pub fn nearest(&self) -> f64 {
        1.0 / f64::from(self.nearness.iter().copied().fold(0.0, f32::max))
    }

    /// What all pixels show.
    pub fn labels(&self) -> &[u8] {
        &self.labels
    }

    /// Neighbouring pixels that show the same part of the object: its label, and their indices.
    pub fn runs(&self) -> impl Iterator<Item = (u8, Range<usize>)> {
        let mut end = 0;
        let runs = self.labels.chunk_by(|a, b| a == b).map(move |run| {
            let start = end;
            end += run.len();
            (run[0], start..end)
        });
        runs.filter(|(label, _)| *label != BACKGROUND)
    }
}

/// The whole numbers from one number, at least 0, to another, if it is greater. (Casts, as rounding is
/// a call on processors without SSE4.1, for which wheels are built.)
fn whole(from: f64, to: f64) -> Range<usize> {
    if from > to {
        return 0..0;
    }
    let below = from as u32;
    let first = below + u32::from(f64::from(below) < from);
    first as usize..(to + 1.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::{Intrinsics, Projection};

    type Triangle = [[f64; 2]; 3];

    /// Labels of a square picture of 8 px that shows triangles, one color each, whose corners lie at
    /// these pixels, so far away.
    fn drawn(triangles: &[(Triangle, f64)]) -> Vec<String> {
        let pinhole = Intrinsics::new(1.0, 1.0, 0.0, 0.0, Projection::Pinhole).unwrap();
        let (mut vertices, mut colors, mut indices) = (Vec::new(), Vec::new(), Vec::new());
        for (i, (corners, z)) in (0..).zip(triangles) {
            vertices.extend(corners.map(|[u, v]| Point3::new(u * z, v * z, *z)));
            colors.extend([[100 * i as u8; 3]; 3]);
            indices.push([3 * i, 3 * i + 1, 3 * i + 2]);
        }
        let mesh = Mesh::new(vertices, colors, indices).unwrap();
        let mut raster = Raster::default();
        assert!(raster.draw(&Part::new(&mesh), &Isometry3::identity(), &pinhole, 8));
        let row = |row: &[u8]| row.iter().map(u8::to_string).collect();
        raster.labels().chunks(8).map(row).collect()
    }

    #[test]
    fn triangle_covers_the_pixels_within_it() {
        let corners = [[1.0, 1.0], [7.5, 1.0], [1.0, 4.25]];
        let mut expected = ["00000000"; 8];
        expected[1..5].copy_from_slice(&["01111111", "01111100", "01110000", "01000000"]);
        let [a, b, c] = corners;
        for corners in [[a, b, c], [a, c, b], [c, b, a]] {
            assert_eq!(drawn(&[(corners, 2.0)]), expected, "{corners:?}");
        }
    }

    #[test]
    fn triangle_beyond_the_picture_covers_what_it_reaches_of_it() {
        let all = [[-100.0, -100.0], [300.0, -100.0], [-100.0, 300.0]];
        assert_eq!(drawn(&[(all, 1.0)]), ["11111111"; 8]);
        for [right, down] in [[-30.0, 0.0], [30.0, 0.0], [0.0, -30.0], [0.0, 30.0]] {
            let beside = all.map(|[u, v]| [u / 100.0 + right, v / 100.0 + down]);
            assert_eq!(drawn(&[(beside, 1.0)]), ["00000000"; 8]);
        }
        // Its lower side is the picture's first row, to within a hair.
        let above = [[-0.5, -3.0], [7.5, -3.0], [3.5, -1e-9]];
        assert_eq!(drawn(&[(above, 1.0)]), ["00000000"; 8]);
    }

    #[test]
    fn nearest_triangle_is_shown() {
        let upper = [[-100.0, 4.5], [100.0, 4.5], [0.0, -300.0]];
        let lower = [[-100.0, 2.5], [100.0, 2.5], [0.0, 300.0]];
        for (z, shown) in [(1.0, "11111111"), (3.0, "22222222")] {
            let rows = drawn(&[(upper, z), (lower, 2.0)]);
            assert_eq!([&rows[0], &rows[7]], ["11111111", "22222222"]);
            assert_eq!(rows[3], shown, "{z}");
        }
    }

    #[test]
    fn backs_of_closed_surfaces_are_not_drawn_and_the_picture_is_the_same() {
        let corner = |i: usize| [i & 1, i >> 1 & 1, i >> 2].map(|x| x as f64 - 0.5);
        let corners: Vec<Point3<f64>> = (0..8).map(|i| corner(i).into()).collect();
        // Counterclockwise as seen from outside, two for each side.
        let sides = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        let cube: Vec<[u32; 3]> = sides
            .iter()
            .flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]])
            .collect();
        let part = |triangles: &[[u32; 3]]| {
            let colors = (0..8)
                .map(|i| [0, 100, 200][i % 3])
                .map(|x| [x; 3])
                .collect();
            Part::new(&Mesh::new(corners.clone(), colors, triangles.to_vec()).unwrap())
        };
        let closed = part(&cube);
        assert!(closed.closed);
        assert!(!part(&cube[1..]).closed, "with a hole");
        let inwards: Vec<[u32; 3]> = cube.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
        assert!(!part(&inwards).closed, "inside out");
        let mut one = cube.clone();
        one[5] = inwards[5];
        assert!(!part(&one).closed, "one is turned");

        let open = Part {
            closed: false,
            ..part(&cube)
        };
        let pinhole = Intrinsics::new(60.0, 60.0, 31.5, 31.5, Projection::Pinhole).unwrap();
        for turn in 0..40 {
            let turn = f64::from(turn);
            let axis = nalgebra::Vector3::new(turn.sin(), (2.0 * turn).cos(), 0.3) * turn;
            let pose = Isometry3::new(nalgebra::Vector3::new(0.1, -0.2, 2.5), axis);
            let drawn = |part: &Part| {
                let mut raster = Raster::default();
                assert!(raster.draw(part, &pose, &pinhole, 64));
                raster
            };
            let (one, other) = (drawn(&closed), drawn(&open));
            let differ = one.labels.iter().zip(&other.labels).filter(|(a, b)| a != b);
            // Where an edge runs through the middle of a pixel, either side may be shown.
            assert!(differ.count() <= 3);
            let shown = one.labels.iter().filter(|label| **label != BACKGROUND);
            assert!(shown.count() > 300);
        }
    }
}
