//! Lenses that rig files have no name for, from image to ray.

use mvtop_geometry::Projection;
use nalgebra::{Point2, Vector3};

use crate::Checked;

/// A lens, by which ray is imaged at a point of the plane of unit focal length.
#[derive(Debug, Clone, PartialEq)]
pub enum Foreign {
    /// Straight lines from `x / (1 + k r²)`; HALCON's division model, COLMAP's `DIVISION`.
    ///
    /// Source: Fitzgibbon, "Simultaneous linear estimation of multiple view geometry and lens
    /// distortion", 2001.
    Division {
        /// Per squared focal length.
        k: f64,
    },
    /// HALCON's polynomial, which takes distortion out where OpenCV's puts it in.
    Polynomial {
        /// Radial, of r², r⁴ and r⁶, in focal lengths.
        k: [f64; 3],
        /// Decentering.
        p: [f64; 2],
    },
    /// Devernay and Faugeras, "Straight lines have to be straight", 2001.
    Fov {
        /// Angle of view, radians.
        w: f64,
    },
    /// Usenko et al., "The double sphere camera model", 2018.
    DoubleSphere {
        /// Distance of the spheres.
        xi: f64,
        /// Where between sphere and plane.
        alpha: f64,
    },
    /// Khomutenko et al., "An enhanced unified camera model", 2016.
    Eucm {
        /// Where between ellipsoid and plane.
        alpha: f64,
        /// Shape of the ellipsoid.
        beta: f64,
    },
    /// Mei and Rives, "Single view point omnidirectional camera calibration from planar grids", 2007.
    Omni {
        /// Distance of the sphere's centre.
        xi: f64,
        /// On the plane.
        distortion: Projection,
    },
}

impl Foreign {
    pub fn fov(w: f64) -> Checked<Self> {
        match w > 0.0 && w < std::f64::consts::PI {
            true => Ok(Self::Fov { w }),
            false => Err(format!(
                "the FOV lens's angle must lie between 0 and 3.14 radians, got {w}"
            )),
        }
    }

    pub fn name(&self) -> &'static str {
        match self {
            Self::Division { .. } => "division model",
            Self::Polynomial { .. } => "HALCON's polynomial",
            Self::Fov { .. } => "FOV model",
            Self::DoubleSphere { .. } => "double sphere",
            Self::Eucm { .. } => "EUCM",
            Self::Omni { .. } => "omni",
        }
    }

    /// Whether directions about the axis are alike.
    pub fn is_radial(&self) -> bool {
        match self {
            Self::Polynomial { p, .. } => *p == [0.0; 2],
            Self::Omni { distortion, .. } => *distortion == Projection::Pinhole,
            _ => true,
        }
    }

    /// Direction of the ray imaged at a point; `None` where the lens has no image.
    pub fn unproject(&self, image: &Point2<f64>) -> Option<Vector3<f64>> {
        let (x, y) = (image.x, image.y);
        let r2 = x * x + y * y;
        let ray = match self {
            Self::Division { k } => {
                let z = 1.0 + k * r2;
                // Past r² = 1 / -k the image would fold back.
                (z > 0.0 && k * r2 < 1.0).then(|| Vector3::new(x, y, z))
            }
            Self::Polynomial {
                k: [k1, k2, k3],
                p: [p1, p2],
            } => {
                let g = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let slope = 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3));
                (slope > 0.0).then(|| {
                    Vector3::new(
                        x * g + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y,
                        y * g + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y,
                        1.0,
                    )
                })
            }
            Self::Fov { w } => {
                let r = r2.sqrt();
                let angle = r * w;
                let tangent = |a: f64| a.tan() / (2.0 * (w / 2.0).tan());
                match r {
                    0.0 => Some(Vector3::z()),
                    _ if angle < std::f64::consts::FRAC_PI_2 => {
                        let g = tangent(angle) / r;
                        Some(Vector3::new(x * g, y * g, 1.0))
                    }
                    _ => None,
                }
            }
            Self::DoubleSphere { xi, alpha } => {
                let root = 1.0 - (2.0 * alpha - 1.0) * r2;
                let z = (1.0 - alpha * alpha * r2) / (alpha * root.max(0.0).sqrt() + 1.0 - alpha);
                let under = z * z + (1.0 - xi * xi) * r2;
                (root >= 0.0 && under >= 0.0).then(|| {
                    let scale = (z * xi + under.sqrt()) / (z * z + r2);
                    Vector3::new(scale * x, scale * y, scale * z - xi)
                })
            }
            Self::Eucm { alpha, beta } => {
                let root = 1.0 - (2.0 * alpha - 1.0) * beta * r2;
                let over = 1.0 - beta * alpha * alpha * r2;
                let z = over / (alpha * root.max(0.0).sqrt() + 1.0 - alpha);
                (root >= 0.0).then(|| Vector3::new(x, y, z))
            }
            Self::Omni { xi, distortion } => {
                let plane = distortion.unproject(image)?;
                let (x, y) = (plane.x / plane.z, plane.y / plane.z);
                let r2 = x * x + y * y;
                let root = 1.0 + (1.0 - xi * xi) * r2;
                (root >= 0.0).then(|| {
                    let eta = (xi + root.sqrt()) / (r2 + 1.0);
                    Vector3::new(eta * x, eta * y, eta - xi)
                })
            }
        }?;
        ray.iter().all(|x| x.is_finite()).then_some(ray)
    }
}
