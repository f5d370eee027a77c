//! Lenses by the names that programs give them, and the fit of those that a rig file has no name for.

mod fit;
mod foreign;

use mvtop_geometry::{Intrinsics, Projection};
use nalgebra::Point2;

use crate::Checked;

pub use foreign::Foreign;

/// Largest error of a fit that still is the same lens, px.
const WORST_FIT: f64 = 0.5;

/// Focal lengths, principal point and skew, px; pixel centers are integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    pub skew: f64,
}

/// Angles that are tried where a lens cannot be fitted over its whole image, degrees.
const ANGLE_STEP: f64 = 5.0;
const LEAST_ANGLE: f64 = 20.0;

/// Between rays and the plane of unit focal length.
#[derive(Debug, Clone, PartialEq)]
pub enum Lens {
    /// One that a rig file can name.
    Native(Projection),
    /// One that it cannot.
    Foreign(Foreign),
}

impl Plane {
    pub fn new([fx, fy, cx, cy]: [f64; 4]) -> Self {
        let skew = 0.0;
        Self {
            fx,
            fy,
            cx,
            cy,
            skew,
        }
    }

    /// Of files whose top-left pixel has its center at (0.5, 0.5).
    pub fn from_corner(plane: [f64; 4]) -> Self {
        Self::new(plane).counted_from_corner()
    }

    /// Of a file whose top-left pixel has its center at (0.5, 0.5).
    pub fn counted_from_corner(self) -> Self {
        let [cx, cy] = [self.cx, self.cy].map(|c| c - 0.5);
        Self { cx, cy, ..self }
    }

    /// From the rows of a camera matrix.
    pub fn from_matrix([fx, skew, cx, a, fy, cy, b, c, one]: [f64; 9]) -> Checked<Self> {
        if [a, b, c, one] != [0.0, 0.0, 0.0, 1.0] {
            return Err("the camera matrix must be [fx, skew, cx, 0, fy, cy, 0, 0, 1]".into());
        }
        let plane = Self::new([fx, fy, cx, cy]);
        Ok(Self { skew, ..plane })
    }

    /// The point of the plane of unit focal length that is imaged at a pixel.
    fn unit(&self, pixel: &Point2<f64>) -> Point2<f64> {
        let y = (pixel.y - self.cy) / self.fy;
        Point2::new((pixel.x - self.cx - self.skew * y) / self.fx, y)
    }

    /// With the principal point moved, px.
    fn moved(&self, x: f64, y: f64) -> Self {
        Self {
            cx: self.cx + x,
            cy: self.cy + y,
            ..*self
        }
    }

    /// With focal lengths and skew scaled alike.
    fn scaled(&self, scale: f64) -> Self {
        Self {
            fx: scale * self.fx,
            fy: scale * self.fy,
            skew: scale * self.skew,
            ..*self
        }
    }

    fn under(&self, projection: Projection) -> mvtop_geometry::Result<Intrinsics> {
        Intrinsics::new(self.fx, self.fy, self.cx, self.cy, projection)?.with_skew(self.skew)
    }
}

impl Lens {
    pub const PINHOLE: Self = Self::Native(Projection::Pinhole);

    /// OpenCV's pinhole, with its coefficients in its order.
    pub fn brown_conrady(params: &[f64]) -> Checked<Self> {
        native("pinhole", "brown_conrady", params)
    }

    /// OpenCV's fisheye.
    pub fn kannala_brandt(params: &[f64]) -> Checked<Self> {
        native("fisheye", "kannala_brandt", params)
    }

    /// Whether it is OpenCV's fisheye.
    pub fn is_fisheye(&self) -> bool {
        matches!(self, Self::Native(projection) if projection.family() == "fisheye")
    }

    /// The distortion of that name.
    pub fn named(name: &str, params: &[f64]) -> Checked<Self> {
        let plain: String = name
            .chars()
            .filter(|c| c.is_alphanumeric())
            .map(|c| c.to_ascii_lowercase())
            .collect();
        match plain.strip_prefix("distortion").unwrap_or(&plain) {
            // RealSense's: without coefficients, one way or the other is the same.
            "inversebrownconrady" | "modifiedbrownconrady" => {
                match params.iter().all(|&p| p == 0.0) {
                    true => Ok(Self::PINHOLE),
                    false => Err(format!(
                        "the distortion {name:?} of {params:?} is not OpenCV's brown_conrady and cannot be \
                     expressed; undistort its images, and leave its coefficients out"
                    )),
                }
            }
            "" | "none" | "pinhole" | "perspective" => match params.iter().all(|&p| p == 0.0) {
                true => Ok(Self::PINHOLE),
                false => Err(format!(
                    "the distortion is called {name:?}, but has coefficients: {params:?}"
                )),
            },
            "plumbbob" | "rationalpolynomial" | "radtan" | "radialtangential" | "opencv"
            | "browncondrady" | "brownconrady" | "rational" | "fullopencv" | "thinprism" => {
                Self::brown_conrady(params)
            }
            "equidistant" | "equi" | "equidist" | "fisheye" | "kannalabrandt" | "kb4"
            | "opencvfisheye" | "kannalabrandt4" | "kannalabrandt8" => Self::kannala_brandt(params),
            "fov" | "atan" => match params {
                [w] => Foreign::fov(*w).map(Self::Foreign),
                _ => Err(format!("a FOV lens has 1 coefficient, got {params:?}")),
            },
            _ => Err(format!(
                "the distortion {name:?} is not known; expected plumb_bob, rational_polynomial, \
                 radtan, equidistant, fov or none"
            )),
        }
    }

    /// As a rig expresses it, with a note where it had to be fitted.
    ///
    /// - `size`: of the images, which the fit covers
    /// - `max_angle`: from the axis, degrees; the lens is limited to it, and the fit covers no more
    pub fn intrinsics(
        &self,
        plane: &Plane,
        size: [u32; 2],
        max_angle: Option<f64>,
    ) -> Checked<(Intrinsics, Option<String>)> {
        let limited = |intrinsics: Intrinsics| match max_angle {
            Some(degrees) => intrinsics.with_max_angle(degrees),
            None => Ok(intrinsics),
        };
        let foreign = match self {
            Self::Native(projection) => {
                return plane
                    .under(projection.clone())
                    .and_then(limited)
                    .map(|intrinsics| (intrinsics, None))
                    .map_err(|error| error.to_string());
            }
            Self::Foreign(foreign) => foreign,
        };
        let name = foreign.name();
        let fit = fit::fit(foreign, plane, size, max_angle)
            .ok_or_else(|| format!("its lens ({name}) images nothing that could be fitted"))?;
        let (error, fitted) = (fit.worst_px, fit.name());
        if error > WORST_FIT {
            let most = max_angle.unwrap_or(fit.angle_deg).min(fit.angle_deg);
            let off = match error.is_finite() {
                true => format!("is off by up to {error:.3} px, {WORST_FIT} px allowed"),
                false => "does not image all that it images".to_owned(),
            };
            let instead = match fitted_angle(foreign, plane, size, most) {
                Some((degrees, reached)) => format!(
                    "limited to {degrees:.0} degrees from its axis it would be off by {reached:.3} px: give \
                     `max_angle` (--max-angle {degrees:.0})"
                ),
                None => "undistort its images to a pinhole's".to_owned(),
            };
            return Err(format!(
                "its lens ({name}) cannot be expressed over its whole image, up to {most:.0} degrees from its \
                 axis: the nearest {fitted} {off}; {instead}"
            ));
        }
        let part = match fit.covered < 0.9995 {
            true => format!(
                " over the {:.1} % of the image that it covers",
                100.0 * fit.covered
            ),
            false => String::new(),
        };
        let note = format!("its lens ({name}) became {fitted}, off by up to {error:.6} px{part}");
        let intrinsics = limited(fit.intrinsics).map_err(|error| error.to_string())?;
        Ok((intrinsics, Some(note)))
    }
}

/// Largest angle, in whole steps below `most`, over which a lens can be fitted, and the error there, px.
fn fitted_angle(lens: &Foreign, plane: &Plane, size: [u32; 2], most: f64) -> Option<(f64, f64)> {
    let steps =
        (1..).map(|step| (most / ANGLE_STEP).ceil() * ANGLE_STEP - ANGLE_STEP * f64::from(step));
    let angles = steps.take_while(|degrees| *degrees >= LEAST_ANGLE);
    angles
        .filter_map(|degrees| {
            Some((
                degrees,
                fit::fit(lens, plane, size, Some(degrees))?.worst_px,
            ))
        })
        .find(|(_, error)| *error <= WORST_FIT)
}

fn native(family: &str, distortion: &str, params: &[f64]) -> Checked<Lens> {
    Projection::from_params(family, Some(distortion), params)
        .map(Lens::Native)
        .map_err(|error| error.to_string())
}
