//! What a close-up shows of the real camera's image: its inner loop, in lanes of a few pixels that
//! compilers turn into vectors, compiled for AVX2 as well.

use std::borrow::Cow;

use image::RgbImage;
use nalgebra::Point2;

use super::{Directions, is_on_image};
use crate::camera::Camera;
use crate::dispatch;

/// Pixels of a row that are computed side by side.
const LANES: usize = 8;
/// Bytes that are read at once: two pixels, and two bytes more.
const READ: usize = 8;

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
    for (block, pixels) in pixels.chunks_mut(LANES).enumerate() {
        let u = (block * LANES) as f64;
        let middle = Places::of(job, u, v);
        let shown = middle.are_on_image(job.real);
        if shown == [false; LANES] {
            pixels.fill(None);
            continue;
        }
        let colors = match job.taps {
            1 => job.image.of(&middle),
            _ => mean(job, u, v),
        };
        for (lane, pixel) in pixels.iter_mut().enumerate() {
            let color = colors.map(|channel| channel[lane]);
            // NaN where the lens images none of the samples.
            *pixel = (shown[lane] && !color[0].is_nan()).then_some(color);
        }
    }
}

/// Of the samples of each pixel that the lens images.
#[inline(always)]
fn mean(job: &Job<'_>, u: f64, v: f64) -> [[f32; LANES]; 3] {
    let (mut sum, mut count) = ([[0.0_f32; LANES]; 3], [0.0_f32; LANES]);
    for row in 0..job.taps {
        for column in 0..job.taps {
            let [right, below] = [offset(job, column), offset(job, row)];
            let places = Places::of(job, u + right, v + below);
            let colors = job.image.of(&places);
            let imaged = places.are_imaged();
            for (sum, color) in sum.iter_mut().zip(&colors) {
                for lane in 0..LANES {
                    sum[lane] += if imaged[lane] { color[lane] } else { 0.0 };
                }
            }
            for lane in 0..LANES {
                count[lane] += if imaged[lane] { 1.0 } else { 0.0 };
            }
        }
    }
    for sum in &mut sum {
        for lane in 0..LANES {
            sum[lane] /= count[lane];
        }
    }
    sum
}

/// Of a sample from the middle of its pixel.
#[inline(always)]
fn offset(job: &Job<'_>, tap: u32) -> f64 {
    (f64::from(tap) + 0.5) / f64::from(job.taps) - 0.5
}

/// Where the image shows what some neighbors in a row look at; not finite where the lens images
/// nothing.
struct Places {
    x: [f64; LANES],
    y: [f64; LANES],
}

impl Places {
    /// Of the samples at (u, v), (u + 1, v) and so on.
    #[inline(always)]
    fn of(job: &Job<'_>, u: f64, v: f64) -> Self {
        let lens = job.real.intrinsics();
        let direction = |lane: usize| job.directions.of(u + lane as f64, v);
        if let Some(lens) = lens.as_branchless() {
            let [x, y] = lens.project(direction);
            return Self { x, y };
        }
        let (mut x, mut y) = ([f64::NAN; LANES], [f64::NAN; LANES]);
        for lane in 0..LANES {
            if let Some(at) = lens.project(&direction(lane)) {
                [x[lane], y[lane]] = [at.x, at.y];
            }
        }
        Self { x, y }
    }

    #[inline(always)]
    fn are_imaged(&self) -> [bool; LANES] {
        std::array::from_fn(|lane| self.x[lane].is_finite() && self.y[lane].is_finite())
    }

    #[inline(always)]
    fn are_on_image(&self, camera: &Camera) -> [bool; LANES] {
        std::array::from_fn(|lane| is_on_image(camera, &Point2::new(self.x[lane], self.y[lane])))
    }
}

/// A place along an axis, moved to 0 to `last`, as a whole number and the rest; 0 of NaN. (Processors
/// before AVX-512 have no instruction that makes integers of several doubles as Rust's cast does.)
#[inline(always)]
fn split(x: f64, last: f64) -> (u32, f64) {
    /// The doubles from here on are whole numbers, the lower half of whose bits are theirs.
    const WHOLE: f64 = (1_u64 << 52) as f64;
    let x = if x > 0.0 { x } else { 0.0 };
    let x = if x < last { x } else { last };
    let nearest = (x + WHOLE) - WHOLE;
    let whole = nearest - if nearest > x { 1.0 } else { 0.0 };
    ((whole + WHOLE).to_bits() as u32, x - whole)
}

/// The byte of each number that begins at this bit.
#[inline(always)]
fn byte(words: &[u32; LANES], bit: usize) -> [f32; LANES] {
    words.map(|word| (word >> bit & 0xff) as i32 as f32) // as processors convert it
}

/// From some numbers to others, by a share of the way.
#[inline(always)]
fn across(from: &[f32; LANES], to: &[f32; LANES], share: &[f32; LANES]) -> [f32; LANES] {
    std::array::from_fn(|lane| from[lane] + share[lane] * (to[lane] - from[lane]))
}

/// An image, read between its pixels.
pub(super) struct Between<'a> {
    /// Of its pixels, and zeros where these are fewer than are read at once.
    bytes: Cow<'a, [u8]>,
    /// Bytes of a row.
    row: usize,
    /// The first byte of the last row.
    last_row: usize,
    /// The last column and row.
    last: [f64; 2],
    /// Its pixels per pixel of the real camera's image.
    scale: f64,
}

impl<'a> Between<'a> {
    /// - `scale`: pixels of `image` per pixel of the real camera's
    pub fn new(image: &'a RgbImage, scale: f64) -> Self {
        let mut bytes = Cow::Borrowed(image.as_raw().as_slice());
        let row = 3 * image.width() as usize;
        let last_row = bytes.len() - row;
        if bytes.len() < READ {
            bytes.to_mut().resize(READ, 0);
        }
        Self {
            bytes,
            row,
            last_row,
            last: [image.width(), image.height()].map(|side| f64::from(side) - 1.0),
            scale,
        }
    }

    /// R, G and B, 0 to 255, of each place between the four pixels around it; beyond the image its
    /// outermost pixels go on.
    #[inline(always)]
    fn of(&self, places: &Places) -> [[f32; LANES]; 3] {
        let (mut columns, mut rows) = ([0_u32; LANES], [0_u32; LANES]);
        let (mut right, mut below) = ([0.0; LANES], [0.0; LANES]);
        let offset = 0.5 * self.scale - 0.5; // centers of pixels are whole numbers in both
        for lane in 0..LANES {
            let [x, y] = [places.x[lane], places.y[lane]].map(|at| at * self.scale + offset);
            let (column, from_column) = split(x, self.last[0]);
            let (row, from_row) = split(y, self.last[1]);
            (columns[lane], rows[lane]) = (column, row);
            (right[lane], below[lane]) = (from_column as f32, from_row as f32);
        }
        // The pixel above and left of each place, the one right of it, and those below.
        let mut corners = [[0; LANES]; 4];
        for lane in 0..LANES {
            let start = rows[lane] as usize * self.row;
            let first = start + 3 * columns[lane] as usize;
            // What comes after the last column, or the last row, has no weight.
            let second = first + if start < self.last_row { self.row } else { 0 };
            let [above, under] = [first, second].map(|start| self.read(start));
            let words = [above, above >> 24, under, under >> 24];
            for (corner, word) in corners.iter_mut().zip(words) {
                corner[lane] = word as u32;
            }
        }
        let mut colors = [[0.0; LANES]; 3];
        for (channel, color) in colors.iter_mut().enumerate() {
            let [a, b, c, d] = corners.map(|corner| byte(&corner, 8 * channel));
            let (above, under) = (across(&a, &b, &right), across(&c, &d, &right));
            *color = across(&above, &under, &below);
        }
        colors
    }

    /// The bytes from `start` on, the first one lowest; zeros after the image.
    #[inline(always)]
    fn read(&self, start: usize) -> u64 {
        let from = start.min(self.bytes.len() - READ);
        let bytes = self.bytes[from..]
            .first_chunk()
            .expect("not so near the end");
        u64::from_le_bytes(*bytes) >> (8 * (start - from))
    }
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};
    use nalgebra::Isometry3;

    use super::super::{CloseUp, SHARP};
    use crate::camera::{Camera, Intrinsics, Projection};
    use crate::image::Pyramid;

    /// R, G and B of one sample, from the definition of a bilinear one.
    fn sample(image: &RgbImage, x: f64, y: f64) -> [f64; 3] {
        let [right, bottom] = [image.width(), image.height()].map(|side| side - 1);
        let (x, y) = (
            x.clamp(0.0, f64::from(right)),
            y.clamp(0.0, f64::from(bottom)),
        );
        let mut sum = [0.0; 3];
        for (column, row) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (u, v) = (x as u32 + column, y as u32 + row);
            let weight = (1.0 - (x - f64::from(u)).abs()) * (1.0 - (y - f64::from(v)).abs());
            let Rgb(color) = image.get_pixel(u.min(right), v.min(bottom));
            for (sum, color) in sum.iter_mut().zip(color) {
                *sum += weight * f64::from(*color);
            }
        }
        sum
    }

    /// Pixel (u, v) of a close-up, from the definition.
    fn pixel(
        closeup: &CloseUp,
        real: &Camera,
        image: &RgbImage,
        u: f64,
        v: f64,
    ) -> Option<[f64; 3]> {
        let directions = closeup.directions();
        super::super::on_image(real, &directions.of(u, v))?;
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        let pyramid = Pyramid::new(image);
        let job = closeup.job(real, &pyramid, SHARP);
        let (image, halved) = pyramid.of_step(closeup.step, SHARP);
        let smaller = |x: f64| (x + 0.5) / 2_f64.powi(halved as i32) - 0.5;
        let taps = f64::from(job.taps);
        for tap in 0..job.taps.pow(2) {
            let [column, row] =
                [tap % job.taps, tap / job.taps].map(|tap| (f64::from(tap) + 0.5) / taps - 0.5);
            let direction = directions.of(u + column, v + row);
            if let Some(at) = real.intrinsics().project(&direction) {
                let color = sample(image, smaller(at.x), smaller(at.y));
                sum.iter_mut()
                    .zip(color)
                    .for_each(|(sum, color)| *sum += color);
                count += 1.0;
            }
        }
        Some(sum.map(|sum| sum / count))
    }

    /// Every pixel of the close-up of a box is what the definition says; how many there are.
    fn pixels_agree(real: &Camera, image: &RgbImage, bbox: [f64; 4]) -> usize {
        // Not a multiple of what is computed side by side.
        const SIZE: u32 = 21;
        let Some(closeup) = CloseUp::new(real, bbox.into(), SIZE) else {
            return 0;
        };
        let pixels = closeup.pixels(real, &Pyramid::new(image));
        let places = (0..SIZE).flat_map(|v| (0..SIZE).map(move |u| (f64::from(u), f64::from(v))));
        for (got, (u, v)) in pixels.iter().zip(places) {
            let place = format!("{real:?} {bbox:?} {u} {v}");
            let expected = pixel(&closeup, real, image, u, v);
            assert_eq!(got.is_some(), expected.is_some(), "{place}");
            for (got, expected) in got.iter().flatten().zip(expected.iter().flatten()) {
                let off = (f64::from(*got) - expected).abs();
                assert!(off < 1e-4, "{got}, not {expected}: {place}");
            }
        }
        pixels.len()
    }

    #[test]
    fn pixels_are_the_means_of_bilinear_samples_for_every_lens_and_image() {
        // For an image of 90x76 px, and of smaller ones.
        let lens = |scale: f64, family, params: &[f64]| {
            let projection = Projection::from_params(family, None, params).unwrap();
            let [fx, fy, cx, cy] = [90.0, 95.0, 45.3, 38.1].map(|x| x * scale);
            Intrinsics::new(fx, fy, cx, cy, projection).unwrap()
        };
        // Boxes within the image, across its corner, and so wide that a pixel is several samples.
        let boxes = [
            [30.0, 20.0, 50.0, 44.0],
            [60.0, 50.0, 120.0, 90.0],
            [-4.0, -4.0, 88.0, 76.0],
        ];
        for [width, height] in [[90_u32, 76], [1, 1], [2, 1]] {
            let image = RgbImage::from_fn(width, height, |u, v| {
                Rgb([u * 77 + v * 131, u * 13 + v * 7, u ^ v].map(|x| (x % 256) as u8))
            });
            let scale = f64::from(width) / 90.0;
            let pinhole = lens(scale, "pinhole", &[]);
            let lenses = [
                pinhole.clone(),
                pinhole.clone().with_skew(3.0 * scale).unwrap(),
                pinhole.with_max_angle(25.0).unwrap(),
                lens(scale, "pinhole", &[-0.3, 0.1, 0.01, -0.01, 0.0]),
                lens(scale, "fisheye", &[-0.006, 0.016, -0.024, 0.0155]),
            ];
            for lens in lenses {
                let size = [width, height];
                let real = Camera::new("real", size, lens, Isometry3::identity()).unwrap();
                let boxes = boxes.map(|bbox| bbox.map(|side| side * scale));
                let compared = boxes.map(|bbox| pixels_agree(&real, &image, bbox));
                assert_ne!(compared, [0; 3], "{real:?}");
            }
        }
    }
}
