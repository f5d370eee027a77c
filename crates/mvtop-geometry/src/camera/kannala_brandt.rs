//! Fisheye lenses (OpenCV's `fisheye::projectPoints`).
//!
//! Source: Kannala & Brandt, "A generic camera model and calibration method for conventional,
//! wide-angle, and fish-eye lenses", 2006.

use std::f64::consts::PI;

use nalgebra::{Point2, Point3, Vector3};

use super::projection::{ProjectionModel, padded};
use super::radial;

/// Kannala-Brandt fisheye with 4 coefficients.
///
/// A ray at the angle `θ` from the axis is imaged at the radius
/// `θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`, in focal lengths. Angles beyond 90° are imaged too, as
/// far as the radius keeps rising.
#[derive(Debug, Clone, PartialEq)]
pub struct KannalaBrandt {
    params: [f64; 4],
    /// Angle at which the radius stops rising, at most π.
    fold: f64,
}

impl ProjectionModel for KannalaBrandt {
    const FAMILY: &'static str = "fisheye";
    const NAME: &'static str = "kannala_brandt";
    const PARAMS: &'static [&'static str] = &["k1", "k2", "k3", "k4"];
    const COUNTS: &'static [usize] = &[4];

    fn from_finite(params: &[f64]) -> Self {
        let params = padded(params);
        let [k1, k2, k3, k4] = params;
        let slope = [1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4]; // in θ²
        let fold = radial::sign_changes(&slope, PI * PI)
            .first()
            .map_or(PI, |s| s.sqrt());
        Self { params, fold }
    }

    fn params(&self) -> &[f64] {
        &self.params
    }

    fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        let across = point.x.hypot(point.y);
        if across == 0.0 {
            return (point.z > 0.0).then(Point2::origin);
        }
        let angle = across.atan2(point.z);
        (angle <= self.fold).then(|| {
            let scale = self.profile(angle).0 / across;
            Point2::new(point.x * scale, point.y * scale)
        })
    }

    fn unproject(&self, image: &Point2<f64>) -> Option<Vector3<f64>> {
        let radius = image.x.hypot(image.y);
        if radius == 0.0 {
            return Some(Vector3::z());
        }
        let angle = radial::invert(|angle| self.profile(angle), radius, self.fold)?;
        let (sin, cos) = angle.sin_cos();
        let across = image.coords / radius * sin;
        Some(across.push(cos))
    }
}

impl KannalaBrandt {
    /// Radius and its derivative by the angle.
    fn profile(&self, angle: f64) -> (f64, f64) {
        let [k1, k2, k3, k4] = self.params;
        let s = angle * angle;
        let radius = angle * radial::eval(&[1.0, k1, k2, k3, k4], s);
        let slope = radial::eval(&[1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4], s);
        (radius, slope)
    }
}
