//! The inner loops, for some queries of one batch on one thread.
//!
//! Both are written for the compiler's vectoriser: where to read is found for [`LANES`] taps at
//! once ([`super::places`]), and channels are walked in blocks of 16, 8 or 1 whose length is known at compile time
//! and so stays in registers. On x86-64 all is compiled a second time for AVX2, chosen at run time;
//! what arrays' `map` calls is not, so that there are loops in its place. Not for AVX-512: there the
//! compiler shuffles lanes of several taps together, which takes longer than what it saves.

use std::ops::Range;

use super::places::{Footprints, Group, LANES, Lanes, filled_up};
use super::{Gradients, Level};
use crate::dispatch;

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
            groups[tap / LANES].set(tap % LANES, level);
        }
        groups
    }
}

/// `out`: `[queries, H, D]`, overwritten.
pub(super) fn forward(job: &Job<'_>, out: &mut [f32]) {
    dispatch!(
        ["avx2" & "fma"],
        forward_fused(job: &Job<'_>, out: &mut [f32]) -> (),
        else forward_portable
    )
}

/// `grad_out`: `[queries, H, D]`; adds to the gradients.
pub(super) fn backward(job: &Job<'_>, grad_out: &[f32], gradients: Gradients<'_>) {
    dispatch!(
        ["avx2" & "fma"],
        backward_fused(job: &Job<'_>, grad_out: &[f32], gradients: Gradients<'_>) -> (),
        else backward_portable
    )
}

#[inline(always)]
fn forward_fused(job: &Job<'_>, out: &mut [f32]) {
    forward_by::<true>(job, out);
}

fn forward_portable(job: &Job<'_>, out: &mut [f32]) {
    forward_by::<false>(job, out);
}

#[inline(always)]
fn forward_by<const FUSED: bool>(job: &Job<'_>, out: &mut [f32]) {
    if job.head_dim == 0 || job.taps() == 0 {
        return out.fill(0.0);
    }
    let (groups, stride) = (job.groups(), job.heads * job.head_dim);
    // All of a query's taps are looked up before the first is read, so that reading does not wait.
    let mut reads = vec![Reads::default(); groups.len()];
    let queries = job.weights.chunks_exact(job.taps());
    let queries = queries.zip(job.locations.chunks_exact(2 * job.taps()));
    for ((weights, locations), out) in queries.zip(out.chunks_exact_mut(stride)) {
        let of_groups = weights.chunks(LANES).zip(locations.chunks(2 * LANES));
        for ((group, (weights, locations)), reads) in groups.iter().zip(of_groups).zip(&mut reads) {
            *reads = Reads::new(&Footprints::new(group, locations), weights, stride);
        }
        for (head, out) in out.chunks_exact_mut(job.head_dim).enumerate() {
            let taps = head * job.taps_of_head()..(head + 1) * job.taps_of_head();
            let mut done = 0;
            while done < job.head_dim {
                let (channel, out) = (head * job.head_dim + done, &mut out[done..]);
                done += match out.len() {
                    16.. => read::<16, FUSED>(job, channel, taps.clone(), &reads, out),
                    8.. => read::<8, FUSED>(job, channel, taps.clone(), &reads, out),
                    _ => read::<1, FUSED>(job, channel, taps.clone(), &reads, out),
                }
            }
        }
    }
}

/// What a group of taps reads: where cells begin in the value, and how much of each, its weight
/// included.
#[derive(Clone, Default)]
struct Reads {
    weights: Lanes<f32>,
    starts: [Lanes<u32>; 4],
    shares: [Lanes<f32>; 4],
}

impl Reads {
    /// - `weights`: at most [`LANES`]
    /// - `stride`: numbers of a cell
    #[inline(always)]
    fn new(at: &Footprints, weights: &[f32], stride: usize) -> Self {
        let mut reads = Self {
            weights: filled_up(weights),
            starts: [[0; LANES]; 4],
            shares: Footprints::product(&at.y.shares, &at.x.shares),
        };
        for shares in &mut reads.shares {
            for (share, weight) in shares.iter_mut().zip(&reads.weights) {
                *share *= weight;
            }
        }
        for (starts, cells) in reads.starts.iter_mut().zip(&at.cells) {
            for (start, &cell) in starts.iter_mut().zip(cells) {
                *start = cell * stride as u32;
            }
        }
        reads
    }
}

/// Puts what some taps read into the first `W` channels of `out`; `channel` is their place in a row
/// of H·D. Returns `W`.
#[inline(always)]
fn read<const W: usize, const FUSED: bool>(
    job: &Job<'_>,
    channel: usize,
    taps: Range<usize>,
    reads: &[Reads],
    out: &mut [f32],
) -> usize {
    // One for each corner, so that no sum waits for another.
    let mut sums = [[0.0f32; W]; 4];
    for tap in taps {
        let (reads, lane) = (&reads[tap / LANES], tap % LANES);
        if reads.weights[lane] == 0.0 {
            continue;
        }
        for (corner, sums) in sums.iter_mut().enumerate() {
            let from = reads.starts[corner][lane] as usize + channel;
            debug_assert!(from + W <= job.value.len());
            // SAFETY: the start is that of a cell which `Axis::at` keeps within its level and so
            // within the value, and these are W channels of one head of it.
            let value = unsafe { job.value.get_unchecked(from..from + W) };
            let share = reads.shares[corner][lane];
            for i in 0..W {
                sums[i] = sum_of_product::<FUSED>(share, value[i], sums[i]);
            }
        }
    }
    let [a, b, c, d] = &sums;
    for i in 0..W {
        out[i] = (a[i] + b[i]) + (c[i] + d[i]);
    }
    W
}

#[inline(always)]
fn backward_fused(job: &Job<'_>, grad_out: &[f32], gradients: Gradients<'_>) {
    backward_by::<true>(job, grad_out, gradients);
}

fn backward_portable(job: &Job<'_>, grad_out: &[f32], gradients: Gradients<'_>) {
    backward_by::<false>(job, grad_out, gradients);
}

#[inline(always)]
fn backward_by<const FUSED: bool>(job: &Job<'_>, grad_out: &[f32], gradients: Gradients<'_>) {
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
                    16.. => scatter::<16, FUSED>(job, c, t, w, &places, s, grad, v, r),
                    8.. => scatter::<8, FUSED>(job, c, t, w, &places, s, grad, v, r),
                    _ => scatter::<1, FUSED>(job, c, t, w, &places, s, grad, v, r),
                };
            }
        }
        let of_weights = gradients.weights[taps].chunks_mut(LANES);
        let of_locations = gradients.locations[coordinates].chunks_mut(2 * LANES);
        let gradients = of_weights.zip(of_locations).zip(weights.chunks(LANES));
        for (group, ((of_weights, of_locations), weights)) in gradients.enumerate() {
            let (at, reads) = (&places[group], &reads[group]);
            let along_x = Footprints::product(&at.y.shares, &at.x.slopes(&groups[group].x));
            let along_y = Footprints::product(&at.y.slopes(&groups[group].y), &at.x.shares);
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
fn scatter<const W: usize, const FUSED: bool>(
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
            reads[group][corner][lane] += dot::<W, FUSED>(&row, &job.value[from..from + W]);
            let share = weights[tap] * shares[group][corner][lane];
            let grad_value = &mut grad_value[from..from + W];
            for i in 0..W {
                grad_value[i] = sum_of_product::<FUSED>(share, row[i], grad_value[i]);
            }
        }
    }
    W
}

/// `a * b + c`.
///
/// - `FUSED`: whether the processor has an instruction for it; without, `mul_add` is slow
#[inline(always)]
fn sum_of_product<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    match FUSED {
        true => a.mul_add(b, c),
        false => a * b + c,
    }
}

/// Dot product in the order of a vector register: the compiler may not reorder a plain sum.
#[inline(always)]
fn dot<const W: usize, const FUSED: bool>(a: &[f32; W], b: &[f32]) -> f32 {
    let mut half = W / 2;
    let mut sums = [0.0f32; W];
    for i in 0..half.max(1) {
        sums[i] = a[i] * b[i];
    }
    for i in half.max(1)..W {
        sums[i - half] = sum_of_product::<FUSED>(a[i], b[i], sums[i - half]);
    }
    half /= 2;
    while half > 0 {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
        half /= 2;
    }
    sums[0]
}
