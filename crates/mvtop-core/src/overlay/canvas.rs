//! Antialiased lines, dots and text on an RGB image. Whatever lies outside is cut off.

use font8x8::{BASIC_FONTS, LATIN_FONTS, UnicodeFonts};
use image::{Rgb, RgbImage};
use nalgebra::Point2;
use tiny_skia::{
    FillRule, IntSize, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, Transform,
};

pub type Color = [u8; 3];

/// Side of a character, cells.
const GLYPH: u32 = 8;
/// Of what the font does not have.
const UNKNOWN: [u8; 8] = [0, 0x7e, 0x42, 0x42, 0x42, 0x42, 0x7e, 0];
const GROUND: Color = [16, 16, 16];
/// The library's pixels begin at integers, ours have their centers there.
const FROM_CENTER: f32 = 0.5;

/// An image to draw on; coordinates are pixels, integers being pixel centers.
pub struct Canvas(Pixmap);

impl Canvas {
    /// A copy of the image; `None` where that is empty.
    pub fn new(image: &RgbImage) -> Option<Self> {
        let size = IntSize::from_wh(image.width(), image.height())?;
        let opaque = |pixel: &Rgb<u8>| [pixel[0], pixel[1], pixel[2], u8::MAX];
        Pixmap::from_vec(image.pixels().flat_map(opaque).collect(), size).map(Self)
    }

    /// The image as it is now.
    pub fn image(&self) -> RgbImage {
        let pixels = self.0.pixels();
        RgbImage::from_fn(self.0.width(), self.0.height(), |x, y| {
            let pixel = pixels[(y * self.0.width() + x) as usize];
            Rgb([pixel.red(), pixel.green(), pixel.blue()])
        })
    }

    /// Lines through `points`, `width` px thick; `alpha` is the opacity, 0 to 1.
    pub fn polyline(&mut self, points: &[Point2<f64>], width: f64, color: Color, alpha: f64) {
        let mut path = PathBuilder::new();
        for point in points {
            let (x, y) = (point.x as f32 + FROM_CENTER, point.y as f32 + FROM_CENTER);
            match path.is_empty() {
                true => path.move_to(x, y),
                false => path.line_to(x, y),
            }
        }
        let stroke = Stroke {
            width: width as f32,
            line_cap: LineCap::Round,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        if let Some(path) = path.finish() {
            let (paint, here) = (paint(color, alpha), Transform::identity());
            self.0.stroke_path(&path, &paint, &stroke, here, None);
        }
    }

    /// A filled circle.
    pub fn dot(&mut self, center: Point2<f64>, radius: f64, color: Color, alpha: f64) {
        let (x, y) = (center.x as f32 + FROM_CENTER, center.y as f32 + FROM_CENTER);
        if let Some(circle) = PathBuilder::from_circle(x, y, radius as f32) {
            self.fill(&circle, color, alpha);
        }
    }

    /// Text on a dark ground, its top left corner at `(x, y)` or as near as the image allows.
    pub fn text(&mut self, text: &str, x: f64, y: f64, scale: u32, color: Color) {
        let (width, height) = text_size(text, scale);
        let place = |at: f64, size: u32, limit: u32| {
            // A saturating cast: NaN becomes 0.
            (at.round().max(0.0) as u32).min(limit.saturating_sub(size))
        };
        let left = place(x, width, self.0.width());
        let top = place(y, height, self.0.height());
        let square = |x: u32, y: u32, width: u32, height: u32| {
            Rect::from_xywh(x as f32, y as f32, width as f32, height as f32)
        };
        if let Some(ground) = square(left, top, width, height) {
            self.fill(&PathBuilder::from_rect(ground), GROUND, 0.65);
        }
        let mut cells = PathBuilder::new();
        for (i, character) in text.chars().enumerate() {
            for (row, bits) in glyph(character).into_iter().enumerate() {
                for column in (0..GLYPH).filter(|column| bits >> column & 1 == 1) {
                    let x = left + scale * (1 + i as u32 * GLYPH + column);
                    let y = top + scale * (1 + row as u32);
                    if let Some(cell) = square(x, y, scale, scale) {
                        cells.push_rect(cell);
                    }
                }
            }
        }
        if let Some(cells) = cells.finish() {
            self.fill(&cells, color, 1.0);
        }
    }

    fn fill(&mut self, path: &Path, color: Color, alpha: f64) {
        let (paint, here) = (paint(color, alpha), Transform::identity());
        let canvas = &mut self.0;
        canvas.fill_path(path, &paint, FillRule::Winding, here, None);
    }
}

/// Width and height of a text with its ground, px.
pub fn text_size(text: &str, scale: u32) -> (u32, u32) {
    let columns = text.chars().count() as u32 * GLYPH + 2;
    (columns * scale, (GLYPH + 2) * scale)
}

/// Rows of a character from top to bottom, the leftmost cell in bit 0.
fn glyph(character: char) -> [u8; 8] {
    let latin = || LATIN_FONTS.get(character);
    BASIC_FONTS.get(character).or_else(latin).unwrap_or(UNKNOWN)
}

fn paint(color: Color, alpha: f64) -> Paint<'static> {
    let [r, g, b] = color;
    let mut paint = Paint::default();
    paint.set_color_rgba8(r, g, b, (alpha * 255.0).round() as u8);
    paint
}

#[cfg(test)]
mod tests {
    use super::*;

    fn black(width: u32, height: u32) -> Canvas {
        Canvas::new(&RgbImage::new(width, height)).unwrap()
    }

    #[test]
    fn line_covers_its_pixels_fully_and_its_neighbours_not() {
        let mut canvas = black(10, 7);
        let ends = [Point2::new(2.0, 3.0), Point2::new(7.0, 3.0)];
        canvas.polyline(&ends, 1.0, [200, 100, 0], 1.0);
        let image = canvas.image();
        assert_eq!(image.get_pixel(5, 3), &Rgb([200, 100, 0]));
        assert_eq!(image.get_pixel(5, 2), &Rgb([0, 0, 0]));
        assert_eq!(image.get_pixel(9, 3), &Rgb([0, 0, 0]));
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
        let image = canvas.image();
        assert_eq!(image.get_pixel(4, 4), &Rgb([100, 100, 100]));
        assert_eq!(image.get_pixel(2, 4), &Rgb([100, 100, 100]));
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
        assert!(canvas.image().pixels().all(|pixel| pixel.0 == [0; 3]));
    }

    #[test]
    fn text_is_moved_into_the_image_and_cut_where_it_is_too_small() {
        let mut canvas = black(60, 40);
        canvas.text("T", 1000.0, -50.0, 2, [255; 3]);
        let (width, height) = text_size("T", 2);
        let image = canvas.image();
        let lit: Vec<(u32, u32)> = image
            .enumerate_pixels()
            .filter(|(_, _, pixel)| pixel.0 == [255; 3])
            .map(|(x, y, _)| (x, y))
            .collect();
        let cells: u32 = glyph('T').iter().map(|row| row.count_ones()).sum();
        assert!(cells > 0 && lit.len() as u32 == 4 * cells);
        assert!(lit.iter().all(|&(x, y)| x >= 60 - width && y < height));

        let mut tiny = black(3, 3);
        tiny.text("TOO LONG", f64::NAN, 0.0, 3, [255; 3]);
    }

    #[test]
    fn every_character_has_a_sign_of_its_own() {
        for character in "aZ09.,:-+_/%()°±é".chars() {
            assert!(
                ![UNKNOWN, [0; 8]].contains(&glyph(character)),
                "{character}"
            );
        }
        assert_eq!(glyph('球'), UNKNOWN);
    }
}
