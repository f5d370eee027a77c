//! Pixels of a crop: colors, histogram bins and chromaticities.

use std::sync::OnceLock;

use nalgebra::{Point2, Vector2, Vector3};

/// Levels of each channel in a color histogram, as many as in M3T.
pub const LEVELS: usize = 16;
pub const BINS: usize = LEVELS * LEVELS * LEVELS;
/// Bin of a pixel outside the image.
pub const UNKNOWN: u16 = u16::MAX;
/// Least sum of R, G and B of a pixel with a chromaticity.
const MIN_BRIGHTNESS: f32 = 30.0;

/// Log brightness, and the shares of R and G in the brightness.
pub type ColorDescriptor = [f32; 3];

/// Pixels of a crop.
pub struct CropPixels {
    pub size: usize,
    /// R, G and B of each pixel, 0 to 255, and 0; NaN outside the image. Four numbers are one vector.
    colors: Vec<[f32; 4]>,
    /// Histogram bin of each pixel.
    pub bins: Vec<u16>,
    chromaticities: OnceLock<Vec<Vector3<f32>>>,
}

impl CropPixels {
    /// - `colors`: R, G and B, 0 to 255, row by row
    pub fn new(size: usize, colors: Vec<Option<[f32; 3]>>) -> Self {
        let bin = |rgb: &Option<[f32; 3]>| {
            rgb.map_or(UNKNOWN, |rgb| {
                let [r, g, b] = rgb.map(|x| x as i32 * LEVELS as i32 / 256);
                ((r * LEVELS as i32 + g) * LEVELS as i32 + b) as u16
            })
        };
        Self {
            size,
            bins: colors.iter().map(bin).collect(),
            colors: colors.into_iter().map(padded).collect(),
            chromaticities: OnceLock::new(),
        }
    }

    /// Shares of R, G and B in each pixel's brightness; 0 outside the image and in dark pixels.
    pub fn chromaticities(&self) -> &[Vector3<f32>] {
        let one = |color: &[f32; 4]| {
            let known = brightness_and_chromaticity(rgb(color));
            known.map_or(Vector3::zeros(), |(_, shares)| shares.into())
        };
        self.chromaticities
            .get_or_init(|| self.colors.iter().map(one).collect())
    }

    /// Descriptors of every n-th pixel along each axis; NaN outside the image and in dark pixels.
    pub fn descriptors(&self, every: usize) -> Vec<ColorDescriptor> {
        let one = |color: &[f32; 4]| descriptor(rgb(color)).unwrap_or([f32::NAN; 3]);
        let rows = self.colors.chunks(self.size).step_by(every);
        rows.flat_map(|row| row.iter().step_by(every))
            .map(one)
            .collect()
    }

    /// Squared color gradients at `N` places along a line around `at`: differences over one step, mean
    /// over R, G and B, of 1; 0 outside the image.
    ///
    /// - `along`: unit vector
    pub fn squared_gradients<const N: usize>(
        &self,
        at: Point2<f64>,
        along: Vector2<f64>,
        step: f64,
    ) -> [f64; N] {
        let side = |i: usize| {
            let place = (i as f64 - N as f64 / 2.0) * step;
            self.interpolated(at + along * place)
        };
        let mut before = side(0);
        std::array::from_fn(|i| {
            let behind = side(i + 1);
            let squares = [0, 1, 2].map(|c| (behind[c] - before[c]).powi(2));
            before = behind;
            let square = f64::from(squares[0] + squares[1] + squares[2]);
            // `max` gives 0 of NaN.
            square.max(0.0) / (3.0 * 255.0 * 255.0)
        })
    }

    /// R, G and B, 0 to 255, and 0, bilinear; NaN outside the image.
    fn interpolated(&self, at: Point2<f64>) -> [f32; 4] {
        let last = self.size as f64 - 1.0;
        if !(at.x >= 0.0 && at.y >= 0.0 && at.x < last && at.y < last) {
            return [f32::NAN; 4];
        }
        let (u, v) = (at.x as usize, at.y as usize);
        let (right, below) = ((at.x - u as f64) as f32, (at.y - v as f64) as f32);
        let first = v * self.size + u;
        let [above, under] = [first, first + self.size].map(|index| {
            let [a, b] = [self.colors[index], self.colors[index + 1]];
            between(&a, &b, right)
        });
        between(&above, &under, below)
    }
}

/// - `color`: `None` outside the image
fn padded(color: Option<[f32; 3]>) -> [f32; 4] {
    color.map_or([f32::NAN; 4], |[r, g, b]| [r, g, b, 0.0])
}

fn rgb(&[r, g, b, _]: &[f32; 4]) -> [f32; 3] {
    [r, g, b]
}

/// From some numbers to others, by a share of the way.
fn between(from: &[f32; 4], to: &[f32; 4], share: f32) -> [f32; 4] {
    std::array::from_fn(|i| from[i] + share * (to[i] - from[i]))
}

/// Descriptor of a color; `None` if it is too dark.
pub fn descriptor(rgb: [f32; 3]) -> Option<ColorDescriptor> {
    let (brightness, [r, g, _]) = brightness_and_chromaticity(rgb)?;
    Some([brightness.ln(), r, g])
}

fn brightness_and_chromaticity(rgb: [f32; 3]) -> Option<(f32, [f32; 3])> {
    let sum: f32 = rgb.iter().sum();
    (sum >= MIN_BRIGHTNESS).then(|| (sum, rgb.map(|x| x / sum)))
}

/// Means over squares of `2 half + 1` px of the known descriptors in them.
pub fn box_blur(descriptors: &[ColorDescriptor], size: usize, half: usize) -> Vec<ColorDescriptor> {
    // An integral image, with the number of known pixels as fourth channel.
    let side = size + 1;
    let mut sums = vec![[0.0_f64; 4]; side * side];
    for row in 0..size {
        let mut line = [0.0; 4];
        for column in 0..size {
            let one = descriptors[row * size + column];
            if one[0].is_finite() {
                (0..3).for_each(|i| line[i] += f64::from(one[i]));
                line[3] += 1.0;
            }
            let above = sums[row * side + column + 1];
            sums[(row + 1) * side + column + 1] = std::array::from_fn(|i| above[i] + line[i]);
        }
    }
    let mean = |index: usize| {
        let [row, column] = [index / size, index % size];
        let [top, left] = [row, column].map(|x| x.saturating_sub(half));
        let [bottom, right] = [row, column].map(|x| (x + half + 1).min(size));
        let corner = |row: usize, column: usize| sums[row * side + column];
        let (a, b) = (corner(top, left), corner(top, right));
        let (c, d) = (corner(bottom, left), corner(bottom, right));
        let sum: [f64; 4] = std::array::from_fn(|i| d[i] - b[i] - c[i] + a[i]);
        [0, 1, 2].map(|i| (sum[i] / sum[3]) as f32)
    };
    (0..size * size).map(mean).collect()
}
