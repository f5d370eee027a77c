//! Text as outlines of glyphs, from a font that is part of the program.

use std::sync::LazyLock;

use tiny_skia::{FillRule, Path, PathBuilder, Transform};
use ttf_parser::{Face, OutlineBuilder};

use super::canvas::{Canvas, Color, FROM_CENTER};

/// Inter Semi Bold: Latin, Greek and Cyrillic. Its licence lies beside it.
static FONT: LazyLock<Option<Face<'static>>> =
    LazyLock::new(|| Face::parse(include_bytes!("../../assets/inter-semibold.otf"), 0).ok());

/// A line of text, laid out.
pub struct Text {
    /// Glyphs, with the left end of the baseline at the origin.
    glyphs: Option<Path>,
    /// How far the text advances, px.
    pub width: f64,
    /// Height of capital letters, px.
    pub height: f64,
}

impl Text {
    /// - `size`: of the font (its em square), px
    pub fn new(text: &str, size: f64) -> Self {
        let mut outline = Outline {
            path: PathBuilder::new(),
            scale: 0.0,
            x: 0.0,
        };
        let Some(font) = FONT.as_ref() else {
            return Self {
                glyphs: None,
                width: 0.0,
                height: 0.0,
            };
        };
        outline.scale = size as f32 / f32::from(font.units_per_em());
        for character in text.chars() {
            // Glyph 0 is the font's sign for what it does not have.
            let glyph = font.glyph_index(character).unwrap_or_default();
            font.outline_glyph(glyph, &mut outline);
            let advance = font.glyph_hor_advance(glyph).unwrap_or_default();
            outline.x += f32::from(advance) * outline.scale;
        }
        let capitals = font.capital_height().unwrap_or_default();
        Self {
            width: f64::from(outline.x),
            height: f64::from(f32::from(capitals) * outline.scale),
            glyphs: outline.path.finish(),
        }
    }

    /// Draws it with the left end of its baseline at `(x, y)`.
    pub fn draw(self, canvas: &mut Canvas, x: f64, y: f64, color: Color) {
        let at = Transform::from_translate(x as f32 + FROM_CENTER, y as f32 + FROM_CENTER);
        if let Some(glyphs) = self.glyphs.and_then(|path| path.transform(at)) {
            canvas.fill(&glyphs, FillRule::Winding, color, 1.0);
        }
    }
}

/// Collects a glyph's outline; fonts have y up.
struct Outline {
    path: PathBuilder,
    /// Px for each unit of the font.
    scale: f32,
    /// Where the glyph begins, px.
    x: f32,
}

impl Outline {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.x + x * self.scale, -y * self.scale)
    }
}

impl OutlineBuilder for Outline {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.at(x1, y1), self.at(x, y));
        self.path.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) = (self.at(x1, y1), self.at(x2, y2), self.at(x, y));
        self.path.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.path.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;

    /// Columns and rows, first to last, that a text of white on black changes.
    fn extent(text: &str, size: f64) -> [u32; 4] {
        let mut canvas = Canvas::new(&RgbImage::new(400, 200)).unwrap();
        Text::new(text, size).draw(&mut canvas, 10.0, 150.0, [255; 3]);
        let image = canvas.image();
        let lit = image.enumerate_pixels().filter(|(_, _, p)| p.0[0] > 63);
        lit.fold([400, 200, 0, 0], |[x0, y0, x1, y1], (x, y, _)| {
            [x0.min(x), y0.min(y), x1.max(x), y1.max(y)]
        })
    }

    #[test]
    fn capitals_stand_on_the_baseline_and_scale_with_the_size() {
        for size in [20.0, 40.0, 160.0] {
            let [_, top, _, bottom] = extent("H", size);
            let height = Text::new("H", size).height;
            // Inter's capitals are 2048 of 2816 units high.
            assert!((height - size * 2048.0 / 2816.0).abs() < 1e-3, "{height}");
            assert!((f64::from(150 - top) - height).abs() <= 1.0, "{top}");
            assert_eq!(bottom, 150);
        }
    }

    #[test]
    fn text_stays_within_its_width() {
        let [left, _, right, _] = extent("mug 0.97", 40.0);
        let width = Text::new("mug 0.97", 40.0).width;
        assert!(left >= 10 && f64::from(right) <= 10.0 + width);
        assert!(f64::from(right - left) > 0.9 * width);
    }

    #[test]
    fn every_character_has_a_sign_of_its_own() {
        let font = FONT.as_ref().unwrap();
        for character in "aZ09.,:-+_/%()<>°±×éßŁΩж–…".chars() {
            assert!(font.glyph_index(character).is_some(), "{character}");
        }
        // Another script is shown as boxes, not left out.
        assert!(Text::new("球", 20.0).glyphs.is_some());
    }
}
