//! What a close-up shows of the real camera's image: its inner loop, compiled for AVX2 as well.

use image::RgbImage;
use nalgebra::Point2;

use super::{Directions, on_image};
use crate::camera::Camera;
use crate::dispatch;

/// What rows of a close-up are made of.
pub(super) struct Job<'a> {
    /// Where its pixels look.
    pub directions: Directions,
    /// Samples along each axis of a pixel.
    pub taps: u32,
    pub real: &'a Camera,
    pub image: Between<'a>,
}

/// R, G and B, 0 to 255, of the pixels of row `v`; `None` where one's center is off the image.
pub(super) fn row(job: &Job<'_>, v: usize, pixels: &mut [Option<[f32; 3]>]) {
    dispatch!(["avx2"], of_row(job: &Job<'_>, v: usize, pixels: &mut [Option<[f32; 3]>]) -> ())
}

#[inline(always)]
fn of_row(job: &Job<'_>, v: usize, pixels: &mut [Option<[f32; 3]>]) {
    let v = v as f64;
    for (u, pixel) in pixels.iter_mut().enumerate() {
        let u = u as f64;
        *pixel = None;
        if let Some(middle) = on_image(job.real, &job.directions.of(u, v)) {
            let shown = match job.taps {
                1 => Some(job.image.of(middle)),
                _ => mean(job, u, v),
            };
            if let Some([r, g, b, _]) = shown {
                *pixel = Some([r, g, b]);
            }
        }
    }
}

/// Of the samples of a pixel; `None` where the lens images none of them.
#[inline(always)]
fn mean(job: &Job<'_>, u: f64, v: f64) -> Option<[f32; 4]> {
    let (mut sum, mut count) = ([0.0_f32; 4], 0.0);
    for row in 0..job.taps {
        for column in 0..job.taps {
            let [right, below] = [offset(job, column), offset(job, row)];
            let direction = job.directions.of(u + right, v + below);
            if let Some(at) = job.real.intrinsics().project(&direction) {
                let rgb = job.image.of(at);
                for i in 0..4 {
                    sum[i] += rgb[i];
                }
                count += 1.0;
            }
        }
    }
    if count == 0.0 {
        return None;
    }
    for sum in &mut sum {
        *sum /= count;
    }
    Some(sum)
}

/// Of a sample from the middle of its pixel.
#[inline(always)]
fn offset(job: &Job<'_>, tap: u32) -> f64 {
    (f64::from(tap) + 0.5) / f64::from(job.taps) - 0.5
}

/// An image, read between its pixels.
pub(super) struct Between<'a> {
    bytes: &'a [u8],
    /// Bytes of a row.
    row: usize,
    /// The last column and row.
    last: [f64; 2],
}

impl<'a> Between<'a> {
    pub fn new(image: &'a RgbImage) -> Self {
        Self {
            bytes: image.as_raw(),
            row: 3 * image.width() as usize,
            last: [image.width(), image.height()].map(|side| f64::from(side) - 1.0),
        }
    }

    /// R, G and B, 0 to 255, between the four pixels around `at`, and a fourth number without meaning
    /// (processors take four at once); beyond the image its outermost pixels go on.
    #[inline(always)]
    fn of(&self, at: Point2<f64>) -> [f32; 4] {
        let x = at.x.clamp(0.0, self.last[0]);
        let y = at.y.clamp(0.0, self.last[1]);
        let (column, row) = (x as i32, y as i32);
        let right = (x - f64::from(column)) as f32;
        let below = (y - f64::from(row)) as f32;
        let first = row as usize * self.row + 3 * column as usize;
        // What comes after the last column, or the last row, has no weight.
        let second = match first + self.row < self.bytes.len() {
            true => first + self.row,
            false => first,
        };
        let (a, b) = self.pair(first);
        let (c, d) = self.pair(second);
        let mut between = [0.0; 4];
        for i in 0..4 {
            let above = a[i] + right * (b[i] - a[i]);
            let under = c[i] + right * (d[i] - c[i]);
            between[i] = above + below * (under - above);
        }
        between
    }

    /// The pixel that starts at a byte and the next one, with a byte after each.
    #[inline(always)]
    fn pair(&self, start: usize) -> ([f32; 4], [f32; 4]) {
        let bytes = match self.bytes[start..].first_chunk::<7>() {
            Some(bytes) => *bytes,
            None => self.last_bytes(start),
        };
        let (mut one, mut next) = ([0.0; 4], [0.0; 4]);
        for i in 0..4 {
            one[i] = f32::from(bytes[i]);
            next[i] = f32::from(bytes[i + 3]);
        }
        (one, next)
    }

    /// Those from `start` to the end of the image, and zeros.
    #[cold]
    fn last_bytes(&self, start: usize) -> [u8; 7] {
        let mut bytes = [0; 7];
        let rest = &self.bytes[start..];
        bytes[..rest.len()].copy_from_slice(rest);
        bytes
    }
}
