//! Antialiased lines, areas and dots on an RGB image. Whatever lies outside is cut off.

use image::RgbImage;
use nalgebra::Point2;
use tiny_skia::{FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform};

use crate::BBox;

pub type Color = [u8; 3];

/// tiny-skia's pixels begin at integers, ours have their centers there.
pub const FROM_CENTER: f32 = 0.5;

/// An image to draw on; coordinates are pixels, integers being pixel centers.
pub struct Canvas(Pixmap);

impl Canvas {
    /// A copy of the image; `None` where that is empty.
    pub fn new(image: &RgbImage) -> Option<Self> {
        let mut pixels = Pixmap::new(image.width(), image.height())?;
        let (rgba, rgb) = (pixels.data_mut(), image.as_raw());
        for (to, from) in rgba.chunks_exact_mut(4).zip(rgb.chunks_exact(3)) {
            to.copy_from_slice(&[from[0], from[1], from[2], u8::MAX]);
        }
        Some(Self(pixels))
    }

    /// The image as it is now.
    pub fn image(&self) -> RgbImage {
        let mut image = RgbImage::new(self.0.width(), self.0.height());
        for (to, from) in image.chunks_exact_mut(3).zip(self.0.data().chunks_exact(4)) {
            to.copy_from_slice(&from[..3]);
        }
        image
    }

    /// Width and height, px.
    pub fn size(&self) -> [u32; 2] {
        [self.0.width(), self.0.height()]
    }

    /// Lines through `points`, `width` px thick; `alpha` is the opacity, 0 to 1.
    pub fn polyline(&mut self, points: &[Point2<f64>], width: f64, color: Color, alpha: f64) {
        let mut path = PathBuilder::new();
        add_line(&mut path, points);
        self.stroke(path.finish(), width, color, alpha);
    }

    /// Closed lines, `width` px thick, each pixel painted once.
    pub fn loops(&mut self, loops: &[Vec<Point2<f64>>], width: f64, color: Color, alpha: f64) {
        self.stroke(closed(loops), width, color, alpha);
    }

    /// The area within closed lines, without their holes.
    pub fn area(&mut self, loops: &[Vec<Point2<f64>>], color: Color, alpha: f64) {
        if let Some(path) = closed(loops) {
            self.fill(&path, FillRule::EvenOdd, color, alpha);
        }
    }

    /// A filled circle.
    pub fn dot(&mut self, center: Point2<f64>, radius: f64, color: Color, alpha: f64) {
        let [x, y] = corner_based(&center);
        if let Some(circle) = PathBuilder::from_circle(x, y, radius as f32) {
            self.fill(&circle, FillRule::Winding, color, alpha);
        }
    }

    /// A filled box with round corners.
    pub fn plate(&mut self, bbox: BBox, radius: f64, color: Color, alpha: f64) {
        if let Some(path) = rounded(bbox, radius) {
            self.fill(&path, FillRule::Winding, color, alpha);
        }
    }

    /// The outline of a box with round corners, `width` px thick.
    pub fn frame(&mut self, bbox: BBox, radius: f64, width: f64, color: Color, alpha: f64) {
        self.stroke(rounded(bbox, radius), width, color, alpha);
    }

    /// A path in tiny-skia's coordinates, filled.
    pub fn fill(&mut self, path: &Path, rule: FillRule, color: Color, alpha: f64) {
        let (paint, here) = (paint(color, alpha), Transform::identity());
        self.0.fill_path(path, &paint, rule, here, None);
    }

    fn stroke(&mut self, path: Option<Path>, width: f64, color: Color, alpha: f64) {
        let stroke = Stroke {
            width: width as f32,
            line_cap: LineCap::Round,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        if let Some(path) = path {
            let (paint, here) = (paint(color, alpha), Transform::identity());
            self.0.stroke_path(&path, &paint, &stroke, here, None);
        }
    }
}

fn corner_based(point: &Point2<f64>) -> [f32; 2] {
    [point.x as f32 + FROM_CENTER, point.y as f32 + FROM_CENTER]
}

fn add_line(path: &mut PathBuilder, points: &[Point2<f64>]) {
    for (index, [x, y]) in points.iter().map(corner_based).enumerate() {
        match index {
            0 => path.move_to(x, y),
            _ => path.line_to(x, y),
        }
    }
}

fn closed(loops: &[Vec<Point2<f64>>]) -> Option<Path> {
    let mut path = PathBuilder::new();
    for points in loops.iter().filter(|points| points.len() > 1) {
        add_line(&mut path, points);
        path.close();
    }
    path.finish()
}

fn rounded(bbox: BBox, radius: f64) -> Option<Path> {
    let BBox { x0, y0, x1, y1 } = bbox;
    let radius = radius.min(bbox.width() / 2.0).min(bbox.height() / 2.0) as f32;
    let [[x0, y0], [x1, y1]] = [[x0, y0], [x1, y1]].map(|[x, y]| corner_based(&Point2::new(x, y)));
    let mut path = PathBuilder::new();
    path.move_to(x0 + radius, y0);
    path.line_to(x1 - radius, y0);
    path.quad_to(x1, y0, x1, y0 + radius);
    path.line_to(x1, y1 - radius);
    path.quad_to(x1, y1, x1 - radius, y1);
    path.line_to(x0 + radius, y1);
    path.quad_to(x0, y1, x0, y1 - radius);
    path.line_to(x0, y0 + radius);
    path.quad_to(x0, y0, x0 + radius, y0);
    path.close();
    path.finish()
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
    use image::Rgb;

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
    fn line_between_two_rows_covers_half_of_each() {
        let mut canvas = black(10, 7);
        let ends = [Point2::new(2.0, 2.5), Point2::new(7.0, 2.5)];
        canvas.polyline(&ends, 1.0, [200; 3], 1.0);
        let image = canvas.image();
        for (row, expected) in [(1, 0), (2, 100), (3, 100), (4, 0)] {
            let value = i32::from(image.get_pixel(5, row).0[0]);
            assert!((value - expected).abs() <= 1, "row {row}: {value}");
        }
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
    fn area_spares_holes() {
        let square = |at: f64, to: f64| {
            let corners = [(at, at), (to, at), (to, to), (at, to)];
            corners.map(|(x, y)| Point2::new(x, y)).to_vec()
        };
        let mut canvas = black(12, 12);
        canvas.area(&[square(0.0, 10.0), square(3.0, 7.0)], [200; 3], 1.0);
        let image = canvas.image();
        assert_eq!(image.get_pixel(1, 5), &Rgb([200; 3]));
        assert_eq!(image.get_pixel(5, 5), &Rgb([0; 3]));
        assert_eq!(image.get_pixel(11, 5), &Rgb([0; 3]));
    }

    #[test]
    fn plate_fills_its_box_but_its_corners() {
        let mut canvas = black(12, 12);
        // From pixel 1 to pixel 10, whole pixels.
        canvas.plate([0.5, 0.5, 10.5, 10.5].into(), 4.0, [200; 3], 1.0);
        let image = canvas.image();
        for (x, y, expected) in [(5, 1, 200), (10, 5, 200), (5, 0, 0), (11, 5, 0), (1, 1, 0)] {
            assert_eq!(image.get_pixel(x, y), &Rgb([expected; 3]), "{x}, {y}");
        }
    }

    #[test]
    fn figures_outside_the_image_or_not_finite_leave_it_alone() {
        let mut canvas = black(6, 5);
        for at in [-1e12, 1e12, f64::NAN, f64::INFINITY] {
            canvas.dot(Point2::new(at, at), 3.0, [255; 3], 1.0);
            let ends = [Point2::new(at, 0.), Point2::new(at, 9.)];
            canvas.polyline(&ends, 2.0, [255; 3], 1.0);
            canvas.loops(&[ends.to_vec()], 2.0, [255; 3], 1.0);
            canvas.plate([at; 4].into(), 2.0, [255; 3], 1.0);
        }
        canvas.polyline(&[], 2.0, [255; 3], 1.0);
        canvas.area(&[], [255; 3], 1.0);
        assert!(canvas.image().pixels().all(|pixel| pixel.0 == [0; 3]));
    }
}
