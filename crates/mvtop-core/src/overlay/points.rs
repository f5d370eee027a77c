//! Points of an object's surface, for objects without a mesh.

use nalgebra::{Isometry3, Point2, Point3};

use super::canvas::{Canvas, Color};
use crate::Camera;

/// As many of an object's points are drawn at most, evenly chosen.
const MAX_POINTS: usize = 1500;

/// Dots where the camera sees the object's surface; returns their places, px.
pub fn draw(
    canvas: &mut Canvas,
    camera: &Camera,
    cam_from_obj: &Isometry3<f64>,
    points: &[Point3<f64>],
    diameter_m: f64,
    color: Color,
    unit: f64,
) -> Vec<Point2<f64>> {
    let in_camera: Vec<(Point3<f64>, Point2<f64>)> = points
        .iter()
        .step_by(points.len().div_ceil(MAX_POINTS).max(1))
        .map(|point| cam_from_obj * point)
        .filter_map(|point| Some((point, camera.intrinsics().project(&point)?)))
        .collect();
    let mut drawn = Vec::new();
    for (point, pixel) in &in_camera {
        // Hidden where a point nearby in the image lies clearly nearer to the camera.
        let distance = point.coords.norm();
        let nearby = 0.06 * diameter_m / distance;
        let hidden = in_camera.iter().any(|(other, _)| {
            distance - other.coords.norm() > 0.15 * diameter_m
                && point.coords.angle(&other.coords) < nearby
        });
        if !hidden {
            canvas.dot(*pixel, 1.3 * unit, color, 0.6);
            drawn.push(*pixel);
        }
    }
    drawn
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Intrinsics, Projection};
    use image::RgbImage;

    #[test]
    fn points_behind_the_surface_are_not_drawn() {
        let pinhole = Intrinsics::new(500., 500., 320., 240., Projection::Pinhole).unwrap();
        let camera = Camera::new("left", [640, 480], pinhole, Isometry3::identity()).unwrap();
        let points = [Point3::new(0.0, 0.0, -0.1), Point3::new(0.0, 0.0, 0.1)];
        let shown = |z: f64, points: &[Point3<f64>]| {
            let mut canvas = Canvas::new(&RgbImage::new(640, 480)).unwrap();
            let pose = Isometry3::translation(0.0, 0.0, z);
            draw(&mut canvas, &camera, &pose, points, 0.2, [100; 3], 1.0);
            canvas.image().get_pixel(320, 240).0[0]
        };
        assert_eq!(shown(1.0, &points), 60, "one dot, not two on each other");
        assert_eq!(shown(1.0, &points[1..]), 60, "the far point alone is seen");
        assert_eq!(shown(-1.0, &points), 0, "behind the camera");
    }
}
