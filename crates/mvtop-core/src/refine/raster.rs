//! Depth and segment of each pixel of a crop, rendered from the mesh.

use std::ops::Range;

use nalgebra::{Isometry3, Point2, Point3};

use super::mesh_model::{BACKGROUND, MeshModel};
use crate::Camera;
use crate::dispatch;

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

/// Rows of a triangle that are computed side by side, as a vector.
const ROWS: usize = 4;
/// Pixels of a row that are drawn side by side.
const LANES: usize = 8;
/// Side of the squares of which the farthest surface is known, px.
const SQUARE: usize = LANES;
/// Least area of a triangle whose weights are exact enough to say that it is hidden, px².
const HIDDEN_AREA: f64 = 1e-3;

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

    /// Column, row and 1/z of each.
    #[inline(always)]
    fn corners(&self, triangle: &[u32; 3]) -> [[f64; 3]; 3] {
        triangle.map(|v| {
            let ProjectedVertex { pixel, near, .. } = &self.vertices[v as usize];
            [pixel.x, pixel.y, *near]
        })
    }

    /// Finds [`Raster::farthest`].
    #[inline(always)]
    fn find_farthest(&mut self) {
        let count = self.size.div_ceil(SQUARE);
        self.farthest.resize(count * count, 0.0);
        let [columns, rows] = &self.drawn;
        for top in (rows.start / SQUARE * SQUARE..rows.end).step_by(SQUARE) {
            for left in (columns.start / SQUARE * SQUARE..columns.end).step_by(SQUARE) {
                let mut least = [f32::INFINITY; SQUARE];
                for row in top..(top + SQUARE).min(self.size) {
                    // At the right border also of the next row, which makes it less at most.
                    let line = self.nearness[row * self.size + left..].first_chunk::<SQUARE>();
                    for (least, x) in least.iter_mut().zip(line.unwrap_or(&[0.0; SQUARE])) {
                        *least = if x < least { *x } else { *least };
                    }
                }
                let least = least.into_iter().fold(f32::INFINITY, f32::min);
                self.farthest[top / SQUARE * count + left / SQUARE] = least;
            }
        }
    }

    /// Whether a triangle lies behind [`Raster::farthest`]; `false` where this is not certain.
    #[inline(always)]
    fn hides(&self, corners: &[[f64; 3]; 3]) -> bool {
        let [a, b, c] = corners;
        let count = self.size.div_ceil(SQUARE);
        let squares = |axis: usize| {
            let least = lesser(lesser(a[axis], b[axis]), c[axis]);
            let most = greater(greater(a[axis], b[axis]), c[axis]);
            let square = |px: f64| px as u32 as usize / SQUARE;
            square(least)..=square(most).min(count - 1)
        };
        let nearest = greater(greater(a[2], b[2]), c[2]) * (1.0 + 1e-5);
        let columns = squares(0);
        for row in squares(1) {
            for column in columns.clone() {
                let hidden = f64::from(self.farthest[row * count + column]) > nearest;
                if !hidden {
                    return false; // as NaN hides nothing
                }
            }
        }
        area(corners).abs() > HIDDEN_AREA
    }

    /// Renders a triangle, in which 1/z is linear in the picture.
    ///
    /// - `corners`: column, row and 1/z of each
    /// - `closed`: whether the surface is closed, so that back faces are occluded
    #[inline(always)]
    fn fill(&mut self, corners: [[f64; 3]; 3], label: u8, closed: bool) {
        let [a, b, c] = corners.map(|[u, v, _]| Point2::new(u, v));
        let area = area(&corners);
        if area.abs() < 1e-9 || (closed && area > 0.0) {
            return;
        }
        let last = self.size as f64 - 1.0;
        let range = |axis: usize| {
            let [a, b, c] = [a, b, c].map(|p| p[axis]);
            (
                greater(lesser(lesser(a, b), c), 0.0),
                lesser(greater(greater(a, b), c), last),
            )
        };
        let ((left, right), (top, bottom)) = (range(0), range(1));
        let rows = whole(top, bottom);
        if rows.is_empty() || area.is_nan() {
            return;
        }
        // Weight of each corner, and 1/z: linear in the row and the column, f = f0 + fu·u + fv·v.
        let by_area = 1.0 / area;
        let weight = |from: Point2<f64>, to: Point2<f64>| {
            let (du, dv) = ((to.x - from.x) * by_area, (to.y - from.y) * by_area);
            [dv * from.x - du * from.y, -dv, du]
        };
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let by_slope = weights.map(|[_, fu, _]| 1.0 / fu);
        let [n0, nu, nv]: [f64; 3] = std::array::from_fn(|i| {
            (0..3)
                .map(|corner| corners[corner][2] * weights[corner][i])
                .sum()
        });
        let mut first = rows.start;
        while first < rows.end {
            let v: [f64; ROWS] = std::array::from_fn(|i| f64::from((first + i) as i32));
            // The columns in which no weight is negative.
            let (mut from, mut to) = ([left; ROWS], [right; ROWS]);
            for ([f, _, fv], by_slope) in weights.iter().zip(by_slope) {
                let rises = by_slope > 0.0;
                for i in 0..ROWS {
                    let zero = -(f + fv * v[i]) * by_slope;
                    from[i] = greater(if rises { zero } else { left }, from[i]);
                    to[i] = lesser(if rises { right } else { zero }, to[i]);
                }
            }
            let (mut starts, mut ends, mut near) = ([0; ROWS], [0; ROWS], [0.0; ROWS]);
            for i in 0..ROWS {
                let start = lesser(from[i], last + 1.0);
                let nearest = (start + WHOLE) - WHOLE;
                let start = nearest + if nearest < start { 1.0 } else { 0.0 };
                let end = greater(to[i] + 1.0, 0.0);
                let nearest = (end + WHOLE) - WHOLE;
                let end = nearest - if nearest > end { 1.0 } else { 0.0 };
                let end = if from[i] > to[i] { 0.0 } else { end };
                near[i] = n0 + nv * v[i] + nu * start;
                starts[i] = (start + WHOLE).to_bits() as u32;
                ends[i] = (end + WHOLE).to_bits() as u32;
            }
            for i in 0..ROWS.min(rows.end - first) {
                let line = (first + i) * self.size;
                let (start, end) = (line + starts[i] as usize, line + ends[i] as usize);
                self.fill_row(start, end, [near[i], nu], label);
            }
            first += ROWS;
        }
    }

    /// - `near`: 1/z in the first pixel, and how it changes
    #[inline(always)]
    fn fill_row(&mut self, mut start: usize, end: usize, [mut near, change]: [f64; 2], label: u8) {
        while start < end {
            let (nearness, labels) = (&mut self.nearness[start..], &mut self.labels[start..]);
            let (Some(nearness), Some(labels)) = (
                nearness.first_chunk_mut::<LANES>(),
                labels.first_chunk_mut::<LANES>(),
            ) else {
                return;
            };
            // Copies, as a loop that may store becomes branches.
            let (known, mut named) = (*nearness, *labels);
            let (mut here, mut nearest) = ([0.0_f32; LANES], [0.0_f32; LANES]);
            for here in &mut here {
                *here = near as f32;
                near += change;
            }
            let count = (end - start).min(LANES) as i32;
            for lane in 0..LANES {
                let here = if (lane as i32) < count {
                    here[lane]
                } else {
                    0.0
                };
                let shown = here > known[lane];
                nearest[lane] = if shown { here } else { known[lane] };
                named[lane] = if shown { label } else { named[lane] };
            }
            (*nearness, *labels) = (nearest, named);
            start += LANES;
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

/// Renders all triangles, compiled for AVX2 as well.
fn draw(raster: &mut Raster, mesh: &MeshModel) {
    dispatch!(["avx2"], draw_all(raster: &mut Raster, mesh: &MeshModel) -> ())
}

#[inline(always)]
fn draw_all(raster: &mut Raster, mesh: &MeshModel) {
    // Most surfaces that are not closed are nearly so. Their backs come last: few of these are seen. Where
    // two are as near as each other the first one is shown, so that all must look alike.
    let alike = mesh.labels.iter().all(|label| *label == mesh.labels[0]);
    let backs_last = alike && !mesh.closed;
    let mut backs = std::mem::take(&mut raster.backs);
    backs.clear();
    for (index, (triangle, &label)) in mesh.triangles.iter().zip(&mesh.labels).enumerate() {
        let corners = raster.corners(triangle);
        if backs_last && area(&corners) > 0.0 {
            backs.push(index);
        } else {
            raster.fill(corners, label, mesh.closed);
        }
    }
    if !backs.is_empty() {
        raster.find_farthest();
    }
    for &index in &backs {
        let corners = raster.corners(&mesh.triangles[index]);
        if !raster.hides(&corners) {
            raster.fill(corners, mesh.labels[index], false);
        }
    }
    raster.backs = backs;
}

/// Twice the area of a triangle in the picture, px²; above 0 of a back.
#[inline(always)]
fn area(corners: &[[f64; 3]; 3]) -> f64 {
    let [a, b, c] = corners.map(|[u, v, _]| Point2::new(u, v));
    (b - a).perp(&(c - a))
}

/// The doubles from here on are whole numbers, the lower half of whose bits are theirs.
const WHOLE: f64 = (1_u64 << 52) as f64;

/// The first one unless the second one is greater; one instruction, as it does not look for NaN.
#[inline(always)]
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The lesser one, likewise.
#[inline(always)]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// Integers from one number, at least 0, to another. (Casts, as rounding is a call on processors
/// without SSE4.1, for which wheels are built.)
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
    use crate::refine::RefineConfig;
    use crate::{Intrinsics, Projection};

    type Triangle = [[f64; 2]; 3];

    fn model(mesh: &Mesh) -> MeshModel {
        MeshModel::new(mesh, &RefineConfig::default())
    }

    fn pinhole(focal: f64, middle: f64, size: u32) -> Camera {
        let pinhole = Intrinsics::new(focal, focal, middle, middle, Projection::Pinhole);
        Camera::new("a", [size; 2], pinhole.unwrap(), Isometry3::identity()).unwrap()
    }

    /// Labels of a square picture of 8 px that shows triangles, one color each, whose corners lie at
    /// these pixels, so far away.
    fn drawn(triangles: &[(Triangle, f64)]) -> Vec<String> {
        let camera = pinhole(1.0, 0.0, 8);
        let (mut vertices, mut colors, mut indices) = (Vec::new(), Vec::new(), Vec::new());
        for (i, (corners, z)) in (0..).zip(triangles) {
            vertices.extend(corners.map(|[u, v]| Point3::new(u * z, v * z, *z)));
            colors.extend([[100 * i as u8; 3]; 3]);
            indices.push([3 * i, 3 * i + 1, 3 * i + 2]);
        }
        let mesh = Mesh::new(vertices, colors, indices).unwrap();
        let mut raster = Raster::default();
        assert!(raster.render(&model(&mesh), &camera, &Isometry3::identity()));
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
            model(&Mesh::new(corners.clone(), colors, triangles.to_vec()).unwrap())
        };
        let closed = part(&cube);
        assert!(closed.closed);
        assert!(!part(&cube[1..]).closed, "with a hole");
        let inwards: Vec<[u32; 3]> = cube.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
        assert!(!part(&inwards).closed, "inside out");
        let mut one = cube.clone();
        one[5] = inwards[5];
        assert!(!part(&one).closed, "one is turned");

        let open = MeshModel {
            closed: false,
            ..part(&cube)
        };
        let camera = pinhole(60.0, 31.5, 64);
        for turn in 0..40 {
            let turn = f64::from(turn);
            let axis = nalgebra::Vector3::new(turn.sin(), (2.0 * turn).cos(), 0.3) * turn;
            let pose = Isometry3::new(nalgebra::Vector3::new(0.1, -0.2, 2.5), axis);
            let drawn = |part: &MeshModel| {
                let mut raster = Raster::default();
                assert!(raster.render(part, &camera, &pose));
                raster
            };
            let (one, other) = (drawn(&closed), drawn(&open));
            let differ = one.labels.iter().zip(&other.labels).filter(|(a, b)| a != b);
            // A pixel whose center lies on an edge may show either side.
            assert!(differ.count() <= 3);
            let shown = one.labels.iter().filter(|label| **label != BACKGROUND);
            assert!(shown.count() > 300);
        }
    }

    #[test]
    fn hidden_backs_change_nothing() {
        let mesh = crate::refine::tests::ball();
        let closed = model(&mesh);
        let count = closed.labels.len();
        let open = |labels: Vec<u8>| MeshModel {
            closed: false,
            labels,
            ..model(&mesh)
        };
        // The second one is drawn in the order of its triangles, as its labels differ.
        let each = (0..count).map(|i| 1 + (i % 2) as u8).collect();
        let (one, other) = (open(vec![1; count]), open(each));
        let camera = pinhole(300.0, 99.5, 200);
        let mut raster = [Raster::default(), Raster::default()];
        for turn in 0..20 {
            let turn = f64::from(turn);
            let axis = nalgebra::Vector3::new(turn.sin(), (2.0 * turn).cos(), 0.3) * turn;
            let at = nalgebra::Vector3::new(0.02 * turn.sin(), 0.1 * turn.cos(), 0.3);
            let pose = Isometry3::new(at, axis);
            for (raster, part) in raster.iter_mut().zip([&one, &other]) {
                assert!(raster.render(part, &camera, &pose));
            }
            let [one, other] = &raster;
            assert_eq!(one.nearness, other.nearness);
            let shown = |raster: &Raster| raster.labels().iter().map(|label| *label > 0).collect();
            let (one, other): (Vec<bool>, Vec<bool>) = (shown(one), shown(other));
            assert!(one == other && one.contains(&true));
        }
    }
}
