//! Lenses by the names that programs give them, and the fit of those that a rig file has no name for.

mod fit;
mod foreign;

use mvtop_core::{Intrinsics, Projection};

use crate::Checked;

pub use foreign::Foreign;

/// Largest error of a fit that still is the same lens, px.
const WORST_FIT: f64 = 0.5;

/// Focal lengths and principal point, px; pixel centers are integers.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
}

/// Between rays and the plane of unit focal length.
#[derive(Debug, Clone)]
pub enum Lens {
    /// One that a rig file can name.
    Native(Projection),
    /// One that it cannot.
    Foreign(Foreign),
}

impl Plane {
    pub fn new([fx, fy, cx, cy]: [f64; 4]) -> Self {
        Self { fx, fy, cx, cy }
    }

    /// Of files whose top-left pixel has its center at (0.5, 0.5).
    pub fn from_corner([fx, fy, cx, cy]: [f64; 4]) -> Self {
        Self::new([fx, fy, cx - 0.5, cy - 0.5])
    }

    /// From the rows of a camera matrix.
    pub fn from_matrix([fx, skew, cx, a, fy, cy, b, c, one]: [f64; 9]) -> Checked<Self> {
        if [a, b, c, one] != [0.0, 0.0, 0.0, 1.0] {
            return Err("the camera matrix must be [fx, 0, cx, 0, fy, cy, 0, 0, 1]".into());
        }
        if skew.abs() > 1e-9 * fx.abs() {
            return Err(format!(
                "a skew of {skew} px between the axes of the image cannot be expressed; calibrate \
                 again with the skew fixed at 0"
            ));
        }
        Ok(Self::new([fx, fy, cx, cy]))
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

    /// The distortion of that name.
    pub fn named(name: &str, params: &[f64]) -> Checked<Self> {
        let plain: String = name
            .chars()
            .filter(|c| c.is_alphanumeric())
            .map(|c| c.to_ascii_lowercase())
            .collect();
        match plain.as_str() {
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
            | "opencvfisheye" | "kannalabrandt4" => Self::kannala_brandt(params),
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
    pub fn intrinsics(
        &self,
        plane: &Plane,
        size: [u32; 2],
    ) -> Checked<(Intrinsics, Option<String>)> {
        let foreign = match self {
            Self::Native(projection) => {
                let Plane { fx, fy, cx, cy } = *plane;
                return Intrinsics::new(fx, fy, cx, cy, projection.clone())
                    .map(|intrinsics| (intrinsics, None))
                    .map_err(|error| error.to_string());
            }
            Self::Foreign(foreign) => foreign,
        };
        let name = foreign.name();
        let fit = fit::fit(foreign, plane, size)
            .ok_or_else(|| format!("its lens ({name}) images nothing that could be fitted"))?;
        let (error, fitted) = (fit.worst_px, fit.name());
        if error > WORST_FIT {
            return Err(format!(
                "its lens ({name}) cannot be expressed: the nearest {fitted} is off by up to \
                 {error:.3} px, {WORST_FIT} px allowed"
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
        Ok((fit.intrinsics, Some(note)))
    }
}

fn native(family: &str, distortion: &str, params: &[f64]) -> Checked<Lens> {
    Projection::from_params(family, Some(distortion), params)
        .map(Lens::Native)
        .map_err(|error| error.to_string())
}
