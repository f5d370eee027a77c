//! Axes of poses, through the camera's true lens.

use nalgebra::{Isometry3, Point2, Point3};

use super::canvas::{Canvas, Color};
use crate::Camera;

/// x, y and z.
pub const COLORS: [Color; 3] = [[255, 60, 60], [60, 220, 80], [70, 130, 255]];
const DARK: Color = [16, 16, 16];
/// Lines are drawn in this many pieces, for lenses bend them.
const PIECES: usize = 8;
/// Lengths of predicted and of true axes, as shares of the object's diameter.
pub const LENGTH: f64 = 0.3;
pub const TRUE_LENGTH: f64 = 0.45;

/// Thick lines in the axes' colors.
pub fn draw(
    canvas: &mut Canvas,
    camera: &Camera,
    cam_from_obj: &Isometry3<f64>,
    diameter_m: f64,
    unit: f64,
) {
    let axes = axes(camera, cam_from_obj, LENGTH * diameter_m);
    for (pixels, color) in axes {
        canvas.polyline(&pixels, 5.2 * unit, DARK, 0.6);
        canvas.polyline(&pixels, 3.2 * unit, color, 1.0);
    }
}

/// Thin white lines that end in a dot of the axis' color beyond the predicted ones, so that both can
/// be seen where they agree.
pub fn draw_true(
    canvas: &mut Canvas,
    camera: &Camera,
    cam_from_obj: &Isometry3<f64>,
    diameter_m: f64,
    unit: f64,
) {
    for (pixels, color) in axes(camera, cam_from_obj, TRUE_LENGTH * diameter_m) {
        canvas.polyline(&pixels, 2.0 * unit, DARK, 0.5);
        canvas.polyline(&pixels, unit, [255; 3], 1.0);
        if let Some(end) = pixels.last() {
            canvas.dot(*end, 4.0 * unit, [255; 3], 1.0);
            canvas.dot(*end, 2.8 * unit, color, 1.0);
        }
    }
}

/// Lines of the axes in the image, with their colors; far ones first, so that near ones cover
/// them.
fn axes(
    camera: &Camera,
    cam_from_obj: &Isometry3<f64>,
    length: f64,
) -> Vec<(Vec<Point2<f64>>, Color)> {
    let at = |axis: usize, piece: usize| {
        let mut point = Point3::origin();
        point[axis] = length * piece as f64 / PIECES as f64;
        cam_from_obj * point
    };
    let mut axes = [0, 1, 2];
    axes.sort_by(|&a, &b| at(b, PIECES).z.total_cmp(&at(a, PIECES).z));
    let line = |axis: usize| {
        let pixel = |piece| camera.intrinsics().project(&at(axis, piece));
        let pixels: Option<Vec<_>> = (0..=PIECES).map(pixel).collect();
        Some((pixels?, COLORS[axis]))
    };
    axes.into_iter().filter_map(line).collect()
}
