//! What a close-up shows: colors, and how they look whatever the light.

use std::sync::OnceLock;

use nalgebra::{Point2, Vector2, Vector3};

/// Levels of each channel that colors are counted in.
pub const LEVELS: usize = 16;
pub const BINS: usize = LEVELS * LEVELS * LEVELS;
/// Bin of a pixel that is off the image.
pub const UNKNOWN: u16 = u16::MAX;
/// Sum of R, G and B below which a pixel's tint is not known.
const DARK: f32 = 30.0;

/// Logarithm of a color's brightness, and the shares of R and G in it.
pub type Look = [f32; 3];

/// What the real image shows in a close-up.
pub struct Picture {
    pub size: usize,
    /// Of each pixel: R, G and B, 0 to 255; `None` where it is off the image.
    pixels: Vec<Option<[f32; 3]>>,
    /// Of each pixel: its color, in levels of each channel.
    pub bins: Vec<u16>,
    /// See [`Picture::tints`].
    tints: OnceLock<Vec<Vector3<f32>>>,
}

impl Picture {
    /// - `pixels`: R, G and B, 0 to 255, row by row
    pub fn new(size: usize, pixels: Vec<Option<[f32; 3]>>) -> Self {
        let bin = |rgb: &Option<[f32; 3]>| {
            rgb.map_or(UNKNOWN, |rgb| {
                let [r, g, b] = rgb.map(|x| x as i32 * LEVELS as i32 / 256);
                ((r * LEVELS as i32 + g) * LEVELS as i32 + b) as u16
            })
        };
        Self {
            size,
            bins: pixels.iter().map(bin).collect(),
            pixels,
            tints: OnceLock::new(),
        }
    }

    /// Of each pixel: shares of R, G and B in its brightness; 0 where nothing is known, or it is too dark.
    pub fn tints(&self) -> &[Vector3<f32>] {
        let tint = |rgb: &Option<[f32; 3]>| {
            let known = rgb.and_then(brightness_and_tint);
            known.map_or(Vector3::zeros(), |(_, tint)| tint.into())
        };
        self.tints
            .get_or_init(|| self.pixels.iter().map(tint).collect())
    }

    /// Of every so many pixels along each axis; not finite where nothing is known, or where it is too
    /// dark.
    pub fn looks(&self, every: usize) -> Vec<Look> {
        let look = |rgb: &Option<[f32; 3]>| rgb.and_then(look).unwrap_or([f32::NAN; 3]);
        let rows = self.pixels.chunks(self.size).step_by(every);
        rows.flat_map(|row| row.iter().step_by(every))
            .map(look)
            .collect()
    }

    /// At `N` places along a line, around `at`: the square of the change of color, of 1, from half a step
    /// before to as far behind it, mean over R, G and B; 0 where it is not known.
    ///
    /// - `along`: unit vector
    pub fn changes<const N: usize>(
        &self,
        at: Point2<f64>,
        along: Vector2<f64>,
        step: f64,
    ) -> [f64; N] {
        let side = |i: usize| {
            let place = (i as f64 - N as f64 / 2.0) * step;
            self.between(at + along * place)
        };
        let mut before = side(0);
        std::array::from_fn(|i| {
            let behind = side(i + 1);
            let change = behind.zip(before).map(|(a, b)| a - b);
            before = behind;
            change.map_or(0.0, |change| {
                f64::from(change.norm_squared()) / (3.0 * 255.0 * 255.0)
            })
        })
    }

    /// R, G and B, 0 to 255, between four pixels.
    fn between(&self, at: Point2<f64>) -> Option<Vector3<f32>> {
        let last = self.size as f64 - 1.0;
        if !(at.x >= 0.0 && at.y >= 0.0 && at.x < last && at.y < last) {
            return None;
        }
        let (u, v) = (at.x as usize, at.y as usize);
        let (right, below) = ((at.x - u as f64) as f32, (at.y - v as f64) as f32);
        let pixel = |index: usize| self.pixels[index].map(Vector3::from);
        let row = |first: usize| Some(pixel(first)?.lerp(&pixel(first + 1)?, right));
        let first = v * self.size + u;
        Some(row(first)?.lerp(&row(first + self.size)?, below))
    }
}

/// How a color looks; `None` where it is too dark to tell.
pub fn look(rgb: [f32; 3]) -> Option<Look> {
    let (brightness, [r, g, _]) = brightness_and_tint(rgb)?;
    Some([brightness.ln(), r, g])
}

/// Sum of R, G and B, and their shares in it; `None` where it is too dark to tell.
fn brightness_and_tint(rgb: [f32; 3]) -> Option<(f32, [f32; 3])> {
    let sum: f32 = rgb.iter().sum();
    (sum >= DARK).then(|| (sum, rgb.map(|x| x / sum)))
}
