//! Triangles drawn into a raster, some rows and pixels side by side.

use std::ops::Range;

use nalgebra::Point2;

use super::{ProjectedVertex, Raster};
use crate::dispatch;
use crate::refine::mesh_model::MeshModel;

/// Rows of a triangle that are computed side by side, as a vector.
const ROWS: usize = 4;
/// Pixels of a row that are drawn side by side.
pub const LANES: usize = 8;
/// Side of the squares of which the farthest surface is known, px.
const SQUARE: usize = LANES;
/// Least area of a triangle whose weights are exact enough to say that it is hidden, px².
const HIDDEN_AREA: f64 = 1e-3;

impl Raster {
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
}

/// Renders all triangles, compiled for AVX2 as well.
pub fn draw(raster: &mut Raster, mesh: &MeshModel) {
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
pub fn whole(from: f64, to: f64) -> Range<usize> {
    if from > to {
        return 0..0;
    }
    let below = from as u32;
    let first = below + u32::from(f64::from(below) < from);
    first as usize..(to + 1.0) as usize
}
