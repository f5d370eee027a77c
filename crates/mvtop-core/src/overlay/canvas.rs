//! Antialiased lines, dots and text on an RGB image. Whatever lies outside is cut off.

use image::RgbImage;
use nalgebra::Point2;

use super::font;

pub type Color = [u8; 3];

/// An image to draw on; coordinates are pixels, integers being pixel centers.
pub struct Canvas {
    pub image: RgbImage,
}

impl Canvas {
    /// Lines through `points`, `width` px thick; `alpha` is the opacity, 0 to 1.
    pub fn polyline(&mut self, points: &[Point2<f64>], width: f64, color: Color, alpha: f64) {
        // The distance to the whole line, so that joints are not painted twice.
        let distance = |pixel: Point2<f64>| {
            points
                .windows(2)
                .map(|ends| to_segment(&pixel, ends))
                .fold(f64::INFINITY, f64::min)
        };
        self.paint(points, width / 2.0, color, alpha, distance);
    }

    pub fn dot(&mut self, center: Point2<f64>, radius: f64, color: Color, alpha: f64) {
        self.paint(&[center], radius, color, alpha, |pixel| {
            (pixel - center).norm()
        });
    }

    /// Text on a dark ground, its top left corner at `(x, y)` or as near as the image allows.
    pub fn text(&mut self, text: &str, x: f64, y: f64, scale: u32, color: Color) {
        let (width, height) = text_size(text, scale);
        let place = |at: f64, size: u32, limit: u32| {
            // A saturating cast: NaN becomes 0.
            (at.round().max(0.0) as u32).min(limit.saturating_sub(size))
        };
        let left = place(x, width, self.image.width());
        let top = place(y, height, self.image.height());
        for row in 0..height {
            for column in 0..width {
                self.blend(left + column, top + row, [16, 16, 16], 0.65);
            }
        }
        for (i, character) in text.chars().enumerate() {
            let glyph = font::glyph(character);
            let origin = left + scale * (2 + i as u32 * (font::WIDTH as u32 + 1));
            for row in 0..font::HEIGHT as u32 * scale {
                for column in 0..font::WIDTH as u32 * scale {
                    let bits = glyph[(row / scale) as usize];
                    if bits >> (font::WIDTH as u32 - 1 - column / scale) & 1 == 1 {
                        self.blend(origin + column, top + 2 * scale + row, color, 1.0);
                    }
                }
            }
        }
    }

    /// Paints the pixels nearer than `radius`, with an edge one pixel wide. `distance` is that to
    /// a figure whose corners are `points`.
    fn paint(
        &mut self,
        points: &[Point2<f64>],
        radius: f64,
        color: Color,
        alpha: f64,
        distance: impl Fn(Point2<f64>) -> f64,
    ) {
        let margin = radius + 1.0;
        let range = |axis: usize, size: u32| {
            let coordinates = || points.iter().map(|point| point[axis]);
            let from = coordinates().fold(f64::INFINITY, f64::min) - margin;
            let to = coordinates().fold(f64::NEG_INFINITY, f64::max) + margin;
            // Saturating casts: from 0 to the image's edge, empty where it lies outside.
            (from.floor() as u32)..(to.ceil().min(f64::from(size)) as u32)
        };
        for y in range(1, self.image.height()) {
            for x in range(0, self.image.width()) {
                let pixel = Point2::new(f64::from(x), f64::from(y));
                let cover = (radius + 0.5 - distance(pixel)).clamp(0.0, 1.0);
                self.blend(x, y, color, alpha * cover);
            }
        }
    }

    fn blend(&mut self, x: u32, y: u32, color: Color, alpha: f64) {
        if let Some(pixel) = self.image.get_pixel_mut_checked(x, y) {
            for (channel, target) in pixel.0.iter_mut().zip(color) {
                let value = f64::from(*channel) * (1.0 - alpha) + f64::from(target) * alpha;
                *channel = value.round() as u8;
            }
        }
    }
}

/// Width and height of a text with its ground, px.
pub fn text_size(text: &str, scale: u32) -> (u32, u32) {
    let columns = text.chars().count() as u32 * (font::WIDTH as u32 + 1) + 3;
    (columns * scale, (font::HEIGHT as u32 + 4) * scale)
}

fn to_segment(pixel: &Point2<f64>, ends: &[Point2<f64>]) -> f64 {
    let along = ends[1] - ends[0];
    let length_squared = along.norm_squared();
    let share = if length_squared > 0.0 {
        ((pixel - ends[0]).dot(&along) / length_squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (ends[0] + along * share - pixel).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn black(width: u32, height: u32) -> Canvas {
        Canvas {
            image: RgbImage::new(width, height),
        }
    }

    #[test]
    fn line_covers_its_pixels_fully_and_its_neighbours_not() {
        let mut canvas = black(10, 7);
        let ends = [Point2::new(2.0, 3.0), Point2::new(7.0, 3.0)];
        canvas.polyline(&ends, 1.0, [200, 100, 0], 1.0);
        assert_eq!(canvas.image.get_pixel(5, 3), &Rgb([200, 100, 0]));
        assert_eq!(canvas.image.get_pixel(5, 2), &Rgb([0, 0, 0]));
        assert_eq!(canvas.image.get_pixel(9, 3), &Rgb([0, 0, 0]));
    }

    #[test]
    fn half_opaque_joint_is_painted_once() {
        let mut canvas = black(9, 9);
        let corner = [
            Point2::new(0., 4.),
            Point2::new(4., 4.),
            Point2::new(4., 8.),
        ];
        canvas.polyline(&corner, 2.0, [200, 200, 200], 0.5);
        assert_eq!(canvas.image.get_pixel(4, 4), &Rgb([100, 100, 100]));
        assert_eq!(canvas.image.get_pixel(2, 4), &Rgb([100, 100, 100]));
    }

    #[test]
    fn figures_outside_the_image_or_not_finite_leave_it_alone() {
        let mut canvas = black(6, 5);
        for at in [-1e12, 1e12, f64::NAN, f64::INFINITY] {
            canvas.dot(Point2::new(at, at), 3.0, [255; 3], 1.0);
            canvas.polyline(
                &[Point2::new(at, 0.), Point2::new(at, 9.)],
                2.0,
                [255; 3],
                1.0,
            );
        }
        canvas.polyline(&[], 2.0, [255; 3], 1.0);
        assert!(canvas.image.pixels().all(|pixel| pixel.0 == [0; 3]));
    }

    #[test]
    fn text_is_moved_into_the_image_and_cut_where_it_is_too_small() {
        let mut canvas = black(60, 40);
        canvas.text("T", 1000.0, -50.0, 2, [255; 3]);
        let (width, height) = text_size("T", 2);
        let lit: Vec<(u32, u32)> = canvas
            .image
            .enumerate_pixels()
            .filter(|(_, _, pixel)| pixel.0 == [255; 3])
            .map(|(x, y, _)| (x, y))
            .collect();
        assert_eq!(lit.len(), (5 + 6) * 4, "bar and stem of a T");
        assert!(lit.iter().all(|&(x, y)| x >= 60 - width && y < height));

        let mut tiny = black(3, 3);
        tiny.text("TOO LONG", f64::NAN, 0.0, 3, [255; 3]);
    }
}
