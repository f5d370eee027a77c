//! The inner loops, for some queries of one batch on one thread.
//!
//! Both are written for the compiler's vectoriser: where to read is found for [`LANES`] taps at
//! once, and channels are walked in blocks of 32, 16, 8 or 1 whose length is known at compile time
//! and so stays in registers. On x86-64 all is compiled a second time for AVX2, chosen at run time;
//! what arrays' `map` calls is not, so that there are loops in its place.

use std::array::from_fn;
use std::ops::Range;

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
    fn taps_of_head(&self) -> usize {
        self.levels.len() * self.points
    }

    /// Taps of one query.
    fn taps(&self) -> usize {
        self.heads * self.taps_of_head()
    }

    /// The levels that the taps of a query read, in groups of lanes; the last group is filled up with
    /// taps of a 1 x 1 level.
    fn groups(&self) -> Vec<Group> {
        let mut groups = vec![Group::default(); self.taps().div_ceil(LANES)];
        for tap in 0..self.taps() {
            let level = &self.levels[tap / self.points % self.levels.len()];
            let (group, lane) = (&mut groups[tap / LANES], tap % LANES);
            group.width[lane] = level.width as f32;
            group.height[lane] = level.height as f32;
            group.row[lane] = level.width as u32;
            group.first_cell[lane] = level.first_cell as u32;
        }
        groups
    }
}

/// The levels that a group of taps reads.
#[derive(Clone)]
struct Group {
    width: Lanes<f32>,
    height: Lanes<f32>,
    /// Cells from one row to the next: the width again.
    row: Lanes<u32>,
    first_cell: Lanes<u32>,
}

impl Default for Group {
    fn default() -> Self {
        Self {
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
#[derive(Clone, Default)]
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
        let last: Lanes<f32> = from_fn(|i| lengths[i] - 1.0);
        let places: Lanes<f32> = from_fn(|i| locations[i] * lengths[i] - 0.5);
        let cells: Lanes<f32> = from_fn(|i| places[i].floor());
        let parts: Lanes<f32> = from_fn(|i| places[i] - cells[i]);
        // Comparisons with NaN are false: such a location ends up outside, at cell 0.
        let inside: [Lanes<bool>; 2] = [
            from_fn(|i| cells[i] >= 0.0 && cells[i] <= last[i]),
            from_fn(|i| cells[i] >= -1.0 && cells[i] < last[i]),
        ];
        let clamp = |cell: f32, last: f32| {
            let cell = if cell > 0.0 { cell } else { 0.0 };
            let cell = if cell < last { cell } else { last };
            // SAFETY: from 0 to `last`, which is below 2^24.
            unsafe { cell.to_int_unchecked::<i32>() as u32 }
        };
        let known = |inside: bool, number: f32| if inside { number } else { 0.0 };
        Self {
            cells: [
                from_fn(|i| clamp(cells[i], last[i])),
                from_fn(|i| clamp(cells[i] + 1.0, last[i])),
            ],
            shares: [
                from_fn(|i| known(inside[0][i], 1.0 - parts[i])),
                from_fn(|i| known(inside[1][i], parts[i])),
            ],
            slopes: [
                from_fn(|i| known(inside[0][i], -lengths[i])),
                from_fn(|i| known(inside[1][i], lengths[i])),
            ],
        }
    }
}

/// Where a group of taps reads, in the order (y0, x0), (y0, x1), (y1, x0), (y1, x1).
#[derive(Clone, Default)]
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
    if job.head_dim == 0 || job.taps() == 0 {
        return;
    }
    let groups = job.groups();
    // All of a query's taps are looked up before the first is read, so that reading does not wait.
    let mut reads = vec![Reads::default(); groups.len()];
    let queries = job.weights.chunks_exact(job.taps());
    let queries = queries.zip(job.locations.chunks_exact(2 * job.taps()));
    for ((weights, locations), out) in queries.zip(out.chunks_exact_mut(job.heads * job.head_dim)) {
        let of_groups = weights.chunks(LANES).zip(locations.chunks(2 * LANES));
        for ((group, (weights, locations)), reads) in groups.iter().zip(of_groups).zip(&mut reads) {
            *reads = Reads::new(&Footprints::new(group, locations), weights);
        }
        for (head, out) in out.chunks_exact_mut(job.head_dim).enumerate() {
            let taps = head * job.taps_of_head()..(head + 1) * job.taps_of_head();
            let mut done = 0;
            while done < job.head_dim {
                let (channel, out) = (head * job.head_dim + done, &mut out[done..]);
                done += match out.len() {
                    32.. => read::<32>(job, channel, taps.clone(), &reads, out),
                    16.. => read::<16>(job, channel, taps.clone(), &reads, out),
                    8.. => read::<8>(job, channel, taps.clone(), &reads, out),
                    _ => read::<1>(job, channel, taps.clone(), &reads, out),
                }
            }
        }
    }
}

/// What a group of taps reads: cells, and how much of each, its weight included.
#[derive(Clone, Default)]
struct Reads {
    weights: Lanes<f32>,
    cells: [Lanes<u32>; 4],
    shares: [Lanes<f32>; 4],
}

impl Reads {
    /// - `weights`: at most [`LANES`]
    #[inline(always)]
    fn new(at: &Footprints, weights: &[f32]) -> Self {
        let mut reads = Self {
            weights: [0.0; LANES],
            cells: at.cells,
            shares: Footprints::product(&at.y.shares, &at.x.shares),
        };
        reads.weights[..weights.len()].copy_from_slice(weights);
        for shares in &mut reads.shares {
            for (share, weight) in shares.iter_mut().zip(&reads.weights) {
                *share *= weight;
            }
        }
        reads
    }
}

/// Adds what some taps read to the first `W` channels of `out`; `channel` is their place in a row
/// of H·D. Returns `W`.
#[inline(always)]
fn read<const W: usize>(
    job: &Job<'_>,
    channel: usize,
    taps: Range<usize>,
    reads: &[Reads],
    out: &mut [f32],
) -> usize {
    let stride = job.heads * job.head_dim;
    let mut sum = [0.0f32; W];
    sum.copy_from_slice(&out[..W]);
    for tap in taps {
        let (reads, lane) = (&reads[tap / LANES], tap % LANES);
        if reads.weights[lane] == 0.0 {
            continue;
        }
        let value = |corner: usize| {
            let from = reads.cells[corner][lane] as usize * stride + channel;
            &job.value[from..from + W]
        };
        let (a, b, c, d) = (value(0), value(1), value(2), value(3));
        let share = |corner: usize| reads.shares[corner][lane];
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
    if job.head_dim == 0 || job.taps() == 0 {
        return;
    }
    let groups = job.groups();
    // Of a query's taps: where they read, how much, and what each corner would add to the loss if it
    // were read with share 1.
    let mut places = vec![Footprints::default(); groups.len()];
    let mut shares = vec![[[0.0; LANES]; 4]; groups.len()];
    let mut reads = shares.clone();
    for (query, grad_out) in grad_out.chunks_exact(job.heads * job.head_dim).enumerate() {
        let taps = query * job.taps()..(query + 1) * job.taps();
        let coordinates = 2 * taps.start..2 * taps.end;
        let locations = job.locations[coordinates.clone()].chunks(2 * LANES);
        for (group, locations) in locations.enumerate() {
            places[group] = Footprints::new(&groups[group], locations);
            let at = &places[group];
            shares[group] = Footprints::product(&at.y.shares, &at.x.shares);
            reads[group] = [[0.0; LANES]; 4];
        }
        let weights = &job.weights[taps.clone()];
        for (head, grad_out) in grad_out.chunks_exact(job.head_dim).enumerate() {
            let taps = head * job.taps_of_head()..(head + 1) * job.taps_of_head();
            let mut done = 0;
            while done < job.head_dim {
                let (c, grad) = (head * job.head_dim + done, &grad_out[done..]);
                let (t, w, s) = (taps.clone(), weights, &shares[..]);
                let (v, r) = (&mut *gradients.value, &mut reads[..]);
                done += match grad.len() {
                    32.. => scatter::<32>(job, c, t, w, &places, s, grad, v, r),
                    16.. => scatter::<16>(job, c, t, w, &places, s, grad, v, r),
                    8.. => scatter::<8>(job, c, t, w, &places, s, grad, v, r),
                    _ => scatter::<1>(job, c, t, w, &places, s, grad, v, r),
                };
            }
        }
        let of_weights = gradients.weights[taps].chunks_mut(LANES);
        let of_locations = gradients.locations[coordinates].chunks_mut(2 * LANES);
        let gradients = of_weights.zip(of_locations).zip(weights.chunks(LANES));
        for (group, ((of_weights, of_locations), weights)) in gradients.enumerate() {
            let (at, reads) = (&places[group], &reads[group]);
            let along_x = Footprints::product(&at.y.shares, &at.x.slopes);
            let along_y = Footprints::product(&at.y.slopes, &at.x.shares);
            let sum = |factors: &[Lanes<f32>; 4], i: usize| {
                (0..4)
                    .map(|corner| factors[corner][i] * reads[corner][i])
                    .sum::<f32>()
            };
            for (i, &weight) in weights.iter().enumerate() {
                of_weights[i] += sum(&shares[group], i);
                of_locations[2 * i] += weight * sum(&along_x, i);
                of_locations[2 * i + 1] += weight * sum(&along_y, i);
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
    taps: Range<usize>,
    weights: &[f32],
    places: &[Footprints],
    shares: &[[Lanes<f32>; 4]],
    grad: &[f32],
    grad_value: &mut [f32],
    reads: &mut [[Lanes<f32>; 4]],
) -> usize {
    let stride = job.heads * job.head_dim;
    let mut row = [0.0f32; W];
    row.copy_from_slice(&grad[..W]);
    for tap in taps {
        let (group, lane) = (tap / LANES, tap % LANES);
        for corner in 0..4 {
            let from = places[group].cells[corner][lane] as usize * stride + channel;
            reads[group][corner][lane] += dot(&row, &job.value[from..from + W]);
            let share = weights[tap] * shares[group][corner][lane];
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
