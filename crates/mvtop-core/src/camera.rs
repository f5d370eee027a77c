//! A calibrated camera: its lens, between points and pixels, and its place in the world.
//!
//! Camera frame: x right, y down, z forward. Pixels: integer coordinates are pixel centers, the
//! top-left one at (0, 0).

pub mod brown_conrady;
pub mod kannala_brandt;
mod radial;

use nalgebra::{Isometry3, Point2, Point3, Unit, Vector3};

pub use brown_conrady::BrownConrady;
pub use kannala_brandt::KannalaBrandt;

/// One camera of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    pub id: String,
    /// Image width, px.
    pub width: u32,
    /// Image height, px.
    pub height: u32,
    pub lens: Lens,
    /// Camera frame to world frame, metres.
    pub world_from_cam: Isometry3<f64>,
}

/// Intrinsics and distortion, in OpenCV's conventions.
#[derive(Debug, Clone, PartialEq)]
pub struct Lens {
    /// Focal lengths, px.
    pub fx: f64,
    pub fy: f64,
    /// Principal point, px.
    pub cx: f64,
    pub cy: f64,
    pub distortion: Distortion,
}

/// What happens to a ray before the pinhole's `(fx, fy, cx, cy)`.
#[derive(Debug, Clone, PartialEq)]
pub enum Distortion {
    /// An ideal pinhole.
    None,
    /// A pinhole with radial and tangential distortion.
    BrownConrady(BrownConrady),
    /// A fisheye.
    KannalaBrandt(KannalaBrandt),
}

impl Lens {
    /// Pixel at which the lens images a point of the camera frame (any unit of length).
    ///
    /// `None` for a point that the lens cannot image: behind the camera (pinholes), or past the
    /// angle at which the distortion would fold the image back onto itself.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        let image = match &self.distortion {
            Distortion::None => Some(on_plane(point)?),
            Distortion::BrownConrady(lens) => lens.distort(&on_plane(point)?),
            Distortion::KannalaBrandt(lens) => lens.project(point),
        }?;
        finite(Point2::new(
            self.fx * image.x + self.cx,
            self.fy * image.y + self.cy,
        ))
    }

    /// Direction, in the camera frame, of the ray that the lens images at a pixel.
    ///
    /// The exact inverse of [`Lens::project`], by Newton's method run until it settles; `None`
    /// where it does not, or where no ray within the lens's range meets the pixel.
    pub fn unproject(&self, pixel: &Point2<f64>) -> Option<Unit<Vector3<f64>>> {
        let image = finite(Point2::new(
            (pixel.x - self.cx) / self.fx,
            (pixel.y - self.cy) / self.fy,
        ))?;
        let ray = match &self.distortion {
            Distortion::None => image.coords.push(1.0),
            Distortion::BrownConrady(lens) => lens.undistort(&image)?.coords.push(1.0),
            Distortion::KannalaBrandt(lens) => lens.unproject(&image)?,
        };
        // The norm of a ray that overflowed is no longer 1.
        Unit::try_new(ray, 0.0).filter(|ray| (ray.norm() - 1.0).abs() < 1e-9)
    }
}

/// The point on the plane z = 1, `None` unless it lies in front of the camera.
fn on_plane(point: &Point3<f64>) -> Option<Point2<f64>> {
    (point.z > 0.0)
        .then(|| Point2::new(point.x / point.z, point.y / point.z))
        .and_then(finite)
}

fn finite(point: Point2<f64>) -> Option<Point2<f64>> {
    (point.x.is_finite() && point.y.is_finite()).then_some(point)
}
