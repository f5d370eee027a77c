//! The inner loops, for some queries of one batch on one thread.
//!
//! Both are written for the compiler's vectoriser: where to read is found for [`LANES`] taps at
//! once, and channels are walked in blocks of 32, 16, 8 or 1 whose length is known at compile time
//! and so stays in registers. On x86-64 all is compiled a second time for AVX2, chosen at run time.

use super::{Gradients, Level};
use crate::dispatch;

/// Taps that are looked up together.
const LANES: usize = 8;

type Lanes<T> = [T; LANES];

/// Inputs of one batch and a run of its queries.
pub(super) struct Job<'a> {
    pub levels: &'a [Level],
    pub heads: usize,
    pub head_dim: usize,
    pub points: usize,
    /// `[N, H, D]`
    pub value: &'a [f32],
    /// `[queries, H, L, K, 2]`
    pub locations: &'a [f32],
    /// `[queries, H, L, K]`
    pub weights: &'a [f32],
}

impl Job<'_> {
    /// Taps of one query and head.
    fn taps(&self) -> usize {
        self.levels.len() * self.points
    }

    /// The levels that the taps of a query and head read, in groups of lanes; the last group is
    /// filled up with taps of a 1 x 1 level.
    fn groups(&self) -> Vec<Group> {
        let mut groups = vec![Group::default(); self.taps().div_ceil(LANES)];
        let levels = self
            .levels
            .iter()
            .flat_map(|level| std::iter::repeat_n(level, self.points));
        for (tap, level) in levels.enumerate() {
            let (group, lane) = (&mut groups[tap / LANES], tap % LANES);
            group.width[lane] = level.width as f32;
            group.height[lane] = level.height as f32;
            group.row[lane] = level.width as u32;
            group.first_cell[lane] = level.first_cell as u32;
            group.taps = lane + 1;
        }
        groups
    }
}

/// The levels that a group of taps reads.
#[derive(Clone)]
struct Group {
    taps: usize,
    width: Lanes<f32>,
    height: Lanes<f32>,
    /// Cells from one row to the next: the width again.
    row: Lanes<u32>,
    first_cell: Lanes<u32>,
}

impl Default for Group {
    fn default() -> Self {
        Self {
            taps: 0,
            width: [1.0; LANES],
            height: [1.0; LANES],
            row: [1; LANES],
            first_cell: [0; LANES],
        }
    }
}

/// Linear interpolation along one axis: the two nearest cells, and for each its share and how fast
/// that grows with the location. Both are 0 for a cell outside the map, whose place the nearest
/// inside cell takes, and for locations that are not finite.
#[derive(Default)]
struct Axis {
    cells: [Lanes<u32>; 2],
    shares: [Lanes<f32>; 2],
    slopes: [Lanes<f32>; 2],
}

impl Axis {
    /// - `locations`: 0 to 1 over the axis
    /// - `lengths`: of the axis, in cells
    #[inline(always)]
    fn at(locations: &Lanes<f32>, lengths: &Lanes<f32>) -> Self {
        let mut axis = Self::default();
        for i in 0..LANES {
            let length = lengths[i];
            let last = length - 1.0;
            let place = locations[i] * length - 0.5;
            let cell = place.floor();
            let part = place - cell;
            // Comparisons with NaN are false: such a location ends up outside, at cell 0.
            let inside = [cell >= 0.0 && cell <= last, cell >= -1.0 && cell < last];
            let clamp = |cell: f32| {
                let cell = if cell > 0.0 { cell } else { 0.0 };
                let cell = if cell < last { cell } else { last };
                // SAFETY: from 0 to `last`, which is below 2^24.
                unsafe { cell.to_int_unchecked::<i32>() as u32 }
            };
            axis.cells[0][i] = clamp(cell);
            axis.cells[1][i] = clamp(cell + 1.0);
            axis.shares[0][i] = if inside[0] { 1.0 - part } else { 0.0 };
            axis.shares[1][i] = if inside[1] { part } else { 0.0 };
            axis.slopes[0][i] = if inside[0] { -length } else { 0.0 };
            axis.slopes[1][i] = if inside[1] { length } else { 0.0 };
        }
        axis
    }
}

/// Where a group of taps reads, in the order (y0, x0), (y0, x1), (y1, x0), (y1, x1).
struct Footprints {
    x: Axis,
    y: Axis,
    cells: [Lanes<u32>; 4],
}

impl Footprints {
    /// - `locations`: `[taps, 2]`, at most [`LANES`]
    #[inline(always)]
    fn new(group: &Group, locations: &[f32]) -> Self {
        let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
        for (i, location) in locations.chunks_exact(2).take(LANES).enumerate() {
            (x[i], y[i]) = (location[0], location[1]);
        }
        let (x, y) = (Axis::at(&x, &group.width), Axis::at(&y, &group.height));
        let mut cells = [[0; LANES]; 4];
        for (corner, cells) in cells.iter_mut().enumerate() {
            let (rows, columns) = (&y.cells[corner / 2], &x.cells[corner % 2]);
            for (i, cell) in cells.iter_mut().enumerate() {
                *cell = group.first_cell[i] + rows[i] * group.row[i] + columns[i];
            }
        }
        Self { x, y, cells }
    }

    /// `along_y` times `along_x`, for each corner.
    #[inline(always)]
    fn product(along_y: &[Lanes<f32>; 2], along_x: &[Lanes<f32>; 2]) -> [Lanes<f32>; 4] {
        let mut product = [[0.0; LANES]; 4];
        for (corner, product) in product.iter_mut().enumerate() {
            for i in 0..LANES {
                product[i] = along_y[corner / 2][i] * along_x[corner % 2][i];
            }
        }
        product
    }
}

/// `out`: `[queries, H, D]`, overwritten.
pub(super) fn forward(job: &Job<'_>, out: &mut [f32]) {
    dispatch!(["avx2"], forward_portable(job: &Job<'_>, out: &mut [f32]) -> ())
}

/// `grad_out`: `[queries, H, D]`; adds to the gradients.
pub(super) fn backward(job: &Job<'_>, grad_out: &[f32], gradients: Gradients<'_>) {
    dispatch!(
        ["avx2"],
        backward_portable(job: &Job<'_>, grad_out: &[f32], gradients: Gradients<'_>) -> ()
    )
}

#[inline(always)]
fn forward_portable(job: &Job<'_>, out: &mut [f32]) {
    out.fill(0.0);
    if job.head_dim == 0 {
        return;
    }
    let groups = job.groups();
    for (row, out) in out.chunks_exact_mut(job.head_dim).enumerate() {
        let head = (row % job.heads) * job.head_dim;
        let mut first = row * job.taps();
        for group in &groups {
            let weights = &job.weights[first..first + group.taps];
            let locations = &job.locations[2 * first..2 * (first + group.taps)];
            first += group.taps;
            let at = Footprints::new(group, locations);
            let shares = Footprints::product(&at.y.shares, &at.x.shares);
            let mut done = 0;
            while done < job.head_dim {
                let (channel, out) = (head + done, &mut out[done..]);
                done += match out.len() {
                    32.. => read::<32>(job, channel, weights, &at.cells, &shares, out),
                    16.. => read::<16>(job, channel, weights, &at.cells, &shares, out),
                    8.. => read::<8>(job, channel, weights, &at.cells, &shares, out),
                    _ => read::<1>(job, channel, weights, &at.cells, &shares, out),
                }
            }
        }
    }
}

/// Adds what some taps read to the first `W` channels of `out`; `channel` is their place in a row
/// of H·D. Returns `W`.
#[inline(always)]
fn read<const W: usize>(
    job: &Job<'_>,
    channel: usize,
    weights: &[f32],
    cells: &[Lanes<u32>; 4],
    shares: &[Lanes<f32>; 4],
    out: &mut [f32],
) -> usize {
    let stride = job.heads * job.head_dim;
    let mut sum = [0.0f32; W];
    sum.copy_from_slice(&out[..W]);
    for (tap, &weight) in weights.iter().enumerate().take(LANES) {
        if weight == 0.0 {
            continue;
        }
        let value =
            |corner: usize| &job.value[cells[corner][tap] as usize * stride + channel..][..W];
        let (a, b, c, d) = (value(0), value(1), value(2), value(3));
        let share = |corner: usize| weight * shares[corner][tap];
        let (sa, sb, sc, sd) = (share(0), share(1), share(2), share(3));
        for i in 0..W {
            // In pairs, so that the sums of one tap do not wait for each other.
            sum[i] += (sa * a[i] + sb * b[i]) + (sc * c[i] + sd * d[i]);
        }
    }
    out[..W].copy_from_slice(&sum);
    W
}

#[inline(always)]
fn backward_portable(job: &Job<'_>, grad_out: &[f32], gradients: Gradients<'_>) {
    if job.head_dim == 0 {
        return;
    }
    let groups = job.groups();
    for (row, grad_out) in grad_out.chunks_exact(job.head_dim).enumerate() {
        let head = (row % job.heads) * job.head_dim;
        let mut first = row * job.taps();
        for group in &groups {
            let taps = first..first + group.taps;
            let places = 2 * taps.start..2 * taps.end;
            first += group.taps;
            let at = Footprints::new(group, &job.locations[places.clone()]);
            let shares = Footprints::product(&at.y.shares, &at.x.shares);
            // What each corner of each tap would add to the loss if it were read with share 1.
            let mut reads = [[0.0; LANES]; 4];
            let weights = &job.weights[taps.clone()];
            let grad_value = &mut *gradients.value;
            let mut done = 0;
            while done < job.head_dim {
                let (c, grad) = (head + done, &grad_out[done..]);
                let (w, s, v, r) = (weights, &shares, &mut *grad_value, &mut reads);
                done += match grad.len() {
                    32.. => scatter::<32>(job, c, w, &at.cells, s, grad, v, r),
                    16.. => scatter::<16>(job, c, w, &at.cells, s, grad, v, r),
                    8.. => scatter::<8>(job, c, w, &at.cells, s, grad, v, r),
                    _ => scatter::<1>(job, c, w, &at.cells, s, grad, v, r),
                };
            }

            let along_x = Footprints::product(&at.y.shares, &at.x.slopes);
            let along_y = Footprints::product(&at.y.slopes, &at.x.shares);
            let sum = |factors: &[Lanes<f32>; 4], i: usize| {
                (0..4)
                    .map(|corner| factors[corner][i] * reads[corner][i])
                    .sum::<f32>()
            };
            let grad_weights = &mut gradients.weights[taps];
            let grad_locations = &mut gradients.locations[places];
            for (i, &weight) in weights.iter().enumerate().take(LANES) {
                grad_weights[i] += sum(&shares, i);
                grad_locations[2 * i] += weight * sum(&along_x, i);
                grad_locations[2 * i + 1] += weight * sum(&along_y, i);
            }
        }
    }
}

/// Adds what the first `W` channels of `grad` give to the gradient of the value and to `reads`.
/// Returns `W`.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // One struct for them would be used here only.
fn scatter<const W: usize>(
    job: &Job<'_>,
    channel: usize,
    weights: &[f32],
    cells: &[Lanes<u32>; 4],
    shares: &[Lanes<f32>; 4],
    grad: &[f32],
    grad_value: &mut [f32],
    reads: &mut [Lanes<f32>; 4],
) -> usize {
    let stride = job.heads * job.head_dim;
    let mut row = [0.0f32; W];
    row.copy_from_slice(&grad[..W]);
    for (tap, &weight) in weights.iter().enumerate().take(LANES) {
        for corner in 0..4 {
            let from = cells[corner][tap] as usize * stride + channel;
            reads[corner][tap] += dot(&row, &job.value[from..from + W]);
            let share = weight * shares[corner][tap];
            let grad_value = &mut grad_value[from..from + W];
            for i in 0..W {
                grad_value[i] += share * row[i];
            }
        }
    }
    W
}

/// Dot product in the order of a vector register: the compiler may not reorder a plain sum.
#[inline(always)]
fn dot<const W: usize>(a: &[f32; W], b: &[f32]) -> f32 {
    let mut products = [0.0f32; W];
    for i in 0..W {
        products[i] = a[i] * b[i];
    }
    let mut half = W / 2;
    while half > 0 {
        for i in 0..half {
            products[i] += products[i + half];
        }
        half /= 2;
    }
    products[0]
}
