//! The inner loops, for one batch on one thread.
//!
//! The channels of a head are walked in blocks of 32, 16, 8 or 1 whose length is known at compile
//! time, so that LLVM keeps a block in vector registers; on x86-64 the loops are compiled a second
//! time for AVX2, chosen at run time.

use super::{Gradients, Level};

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

/// The four cells around a location, in the order (y0,x0), (y0,x1), (y1,x0), (y1,x1).
struct Corners {
    cells: [usize; 4],
    /// 1 inside the map, 0 outside, where `cells` holds the nearest inside cell instead.
    inside: [f32; 4],
    fx: f32,
    fy: f32,
}

impl Corners {
    /// None where no corner is inside the map, which includes locations that are not finite.
    #[inline(always)]
    fn at(level: &Level, x: f32, y: f32) -> Option<Self> {
        let (width, height) = (level.width as f32, level.height as f32);
        let (px, py) = (x * width - 0.5, y * height - 0.5);
        // Written so that NaN fails.
        if !(px > -1.0 && px < width && py > -1.0 && py < height) {
            return None;
        }
        let (x0, y0) = (px.floor(), py.floor());
        let (column, row) = (x0 as i32, y0 as i32);
        let (last_column, last_row) = (level.width as i32 - 1, level.height as i32 - 1);
        let (left, right) = (
            column.max(0) as usize,
            (column + 1).min(last_column) as usize,
        );
        let (top, bottom) = (row.max(0) as usize, (row + 1).min(last_row) as usize);
        let one_if = |inside: bool| if inside { 1.0 } else { 0.0 };
        let (in_left, in_right) = (one_if(column >= 0), one_if(column < last_column));
        let (in_top, in_bottom) = (one_if(row >= 0), one_if(row < last_row));
        let (top, bottom) = (
            level.first_cell + top * level.width,
            level.first_cell + bottom * level.width,
        );
        Some(Self {
            cells: [top + left, top + right, bottom + left, bottom + right],
            inside: [
                in_top * in_left,
                in_top * in_right,
                in_bottom * in_left,
                in_bottom * in_right,
            ],
            fx: px - x0,
            fy: py - y0,
        })
    }

    /// Bilinear weight of each corner, zero outside the map.
    #[inline(always)]
    fn shares(&self) -> [f32; 4] {
        let (fx, fy) = (self.fx, self.fy);
        let shares = [
            (1.0 - fy) * (1.0 - fx),
            (1.0 - fy) * fx,
            fy * (1.0 - fx),
            fy * fx,
        ];
        std::array::from_fn(|i| self.inside[i] * shares[i])
    }
}

/// Picks the loops compiled for this processor.
macro_rules! dispatch {
    ($(#[$doc:meta])* $name:ident, $portable:ident, $avx2:ident, ($($arg:ident: $type:ty),*)) => {
        $(#[$doc])*
        pub(super) fn $name($($arg: $type),*) {
            #[cfg(target_arch = "x86_64")]
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has just said that it has AVX2.
                return unsafe { $avx2($($arg),*) };
            }
            $portable($($arg),*)
        }

        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2")]
        fn $avx2($($arg: $type),*) {
            $portable($($arg),*)
        }
    };
}

dispatch!(
    /// `out`: `[queries, H, D]`, overwritten.
    forward, forward_portable, forward_avx2, (job: &Job<'_>, out: &mut [f32])
);

dispatch!(
    /// `grad_out`: `[queries, H, D]`; adds to the gradients.
    backward, backward_portable, backward_avx2,
    (job: &Job<'_>, grad_out: &[f32], gradients: Gradients<'_>)
);

#[inline(always)]
fn forward_portable(job: &Job<'_>, out: &mut [f32]) {
    if job.head_dim == 0 {
        return;
    }
    let taps = job.levels.len() * job.points;
    for (row, out) in out.chunks_exact_mut(job.head_dim).enumerate() {
        let weights = &job.weights[row * taps..(row + 1) * taps];
        let locations = &job.locations[2 * row * taps..2 * (row + 1) * taps];
        let head = (row % job.heads) * job.head_dim;
        let mut done = 0;
        while done < job.head_dim {
            let out = &mut out[done..];
            done += match out.len() {
                32.. => forward_block::<32>(job, head + done, weights, locations, out),
                16.. => forward_block::<16>(job, head + done, weights, locations, out),
                8.. => forward_block::<8>(job, head + done, weights, locations, out),
                _ => forward_block::<1>(job, head + done, weights, locations, out),
            }
        }
    }
}

/// Fills the first `W` channels of `out`; `channel` is their place in a row of H·D. Returns `W`.
#[inline(always)]
fn forward_block<const W: usize>(
    job: &Job<'_>,
    channel: usize,
    weights: &[f32],
    locations: &[f32],
    out: &mut [f32],
) -> usize {
    let stride = job.heads * job.head_dim;
    let mut sum = [0.0f32; W];
    for (l, level) in job.levels.iter().enumerate() {
        for tap in l * job.points..(l + 1) * job.points {
            let weight = weights[tap];
            if weight == 0.0 {
                continue;
            }
            let (x, y) = (locations[2 * tap], locations[2 * tap + 1]);
            let Some(corners) = Corners::at(level, x, y) else {
                continue;
            };
            let shares = corners.shares();
            for (cell, share) in corners.cells.into_iter().zip(shares) {
                let share = weight * share;
                let value = &job.value[cell * stride + channel..][..W];
                for i in 0..W {
                    sum[i] += share * value[i];
                }
            }
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
    let taps = job.levels.len() * job.points;
    for (row, grad_out) in grad_out.chunks_exact(job.head_dim).enumerate() {
        let weights = &job.weights[row * taps..(row + 1) * taps];
        let locations = &job.locations[2 * row * taps..2 * (row + 1) * taps];
        let head = (row % job.heads) * job.head_dim;
        let mut done = 0;
        while done < job.head_dim {
            let grad_out = &grad_out[done..];
            let channel = head + done;
            let gradients = Gradients {
                value: &mut *gradients.value,
                locations: &mut gradients.locations[2 * row * taps..2 * (row + 1) * taps],
                weights: &mut gradients.weights[row * taps..(row + 1) * taps],
            };
            let (w, l) = (weights, locations);
            done += match grad_out.len() {
                32.. => backward_block::<32>(job, channel, w, l, grad_out, gradients),
                16.. => backward_block::<16>(job, channel, w, l, grad_out, gradients),
                8.. => backward_block::<8>(job, channel, w, l, grad_out, gradients),
                _ => backward_block::<1>(job, channel, w, l, grad_out, gradients),
            }
        }
    }
}

/// Adds what the first `W` channels of `grad_out` give to the gradients. Returns `W`.
#[inline(always)]
fn backward_block<const W: usize>(
    job: &Job<'_>,
    channel: usize,
    weights: &[f32],
    locations: &[f32],
    grad_out: &[f32],
    gradients: Gradients<'_>,
) -> usize {
    let stride = job.heads * job.head_dim;
    let mut grad = [0.0f32; W];
    grad.copy_from_slice(&grad_out[..W]);
    for (l, level) in job.levels.iter().enumerate() {
        for tap in l * job.points..(l + 1) * job.points {
            let (x, y) = (locations[2 * tap], locations[2 * tap + 1]);
            let Some(corners) = Corners::at(level, x, y) else {
                continue;
            };
            let shares = corners.shares();
            let weight = weights[tap];
            // What each corner would add to the loss if it were read with share one.
            let mut reads = [0.0f32; 4];
            for corner in 0..4 {
                let from = corners.cells[corner] * stride + channel;
                let value = &job.value[from..from + W];
                reads[corner] = corners.inside[corner] * dot(&grad, value);
                let share = weight * shares[corner];
                let grad_value = &mut gradients.value[from..from + W];
                for i in 0..W {
                    grad_value[i] += share * grad[i];
                }
            }
            let (fx, fy) = (corners.fx, corners.fy);
            let [a, b, c, d] = reads;
            let (width, height) = (level.width as f32, level.height as f32);
            gradients.weights[tap] +=
                (1.0 - fy) * ((1.0 - fx) * a + fx * b) + fy * ((1.0 - fx) * c + fx * d);
            gradients.locations[2 * tap] += weight * width * ((1.0 - fy) * (b - a) + fy * (d - c));
            gradients.locations[2 * tap + 1] +=
                weight * height * ((1.0 - fx) * (c - a) + fx * (d - b));
        }
    }
    W
}

/// Dot product in the order of a vector register: LLVM may not reorder a plain sum of floats.
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
