//! From points of the camera frame to pixels and back.

use nalgebra::{Point2, Point3, Unit, Vector3};

use super::{BrownConrady, Projection};
use crate::{Error, Result};

/// Largest skew, as a share of the focal length: the axes of real sensors' images are far less askew.
const MOST_SKEW: f64 = 0.1;

/// Focal lengths, skew, principal point and projection, in OpenCV's conventions.
#[derive(Debug, Clone, PartialEq)]
pub struct Intrinsics {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    skew: f64,
    projection: Projection,
    /// Degrees; `None` where the projection alone says it.
    max_angle: Option<f64>,
}

impl Intrinsics {
    /// - `fx`, `fy`: focal lengths, px
    /// - `cx`, `cy`: principal point, px
    /// - `projection`: one without distortion becomes [`Projection::Pinhole`]
    ///
    /// # Errors
    /// [`Error::Camera`] for a number that is not finite, or a focal length that is not above 0.
    pub fn new(fx: f64, fy: f64, cx: f64, cy: f64, projection: Projection) -> Result<Self> {
        let numbers = [("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)];
        if let Some((key, number)) = numbers.iter().find(|(_, number)| !number.is_finite()) {
            let problem = format!("`{key}` must be a finite number, got {number}");
            return Err(Error::Camera(problem));
        }
        if let Some((key, focal)) = numbers[..2].iter().find(|(_, focal)| *focal <= 0.0) {
            let problem = format!("the focal length `{key}` must be above 0 px, got {focal}");
            return Err(Error::Camera(problem));
        }
        Ok(Self {
            fx,
            fy,
            cx,
            cy,
            skew: 0.0,
            projection: projection.simplest(),
            max_angle: None,
        })
    }

    /// The same where the axes of the image are not at right angles: `K[0][1]`, px, what x gains for
    /// each focal length along y (of OpenCV's fisheye `alpha * fx`).
    ///
    /// # Errors
    /// [`Error::Camera`] for a skew that is not finite or beyond a tenth of `fx`, as of a matrix whose
    /// numbers are in another order.
    ///
    /// ```
    /// use mvtop_geometry::{Intrinsics, Projection};
    /// use nalgebra::Point3;
    ///
    /// let lens = Intrinsics::new(500.0, 510.0, 320.0, 240.0, Projection::Pinhole)?.with_skew(2.0)?;
    /// let pixel = lens.project(&Point3::new(0.1, -0.2, 2.0)).expect("in front");
    /// assert_eq!([pixel.x, pixel.y], [345.0 - 0.2, 189.0]);
    /// # Ok::<(), mvtop_geometry::Error>(())
    /// ```
    pub fn with_skew(self, skew: f64) -> Result<Self> {
        if !skew.is_finite() || skew.abs() > MOST_SKEW * self.fx {
            return Err(Error::Camera(format!(
                "`skew`, between the axes of the image, must be a finite number of at most a tenth of \
                 `fx` ({} px), got {skew}; check the order of the numbers of the camera matrix",
                self.fx
            )));
        }
        Ok(Self { skew, ..self })
    }

    /// The same for a lens that images nothing farther off its axis than this angle, degrees: the edge
    /// of a fisheye's image circle, or of what a calibration has seen. Beyond it there is no line of
    /// sight.
    ///
    /// # Errors
    /// [`Error::Camera`] for an angle that is not above 0 and at most 180 degrees.
    ///
    /// ```
    /// use mvtop_geometry::{Intrinsics, Projection};
    /// use nalgebra::Point3;
    ///
    /// let lens = Intrinsics::new(500.0, 500.0, 320.0, 240.0, Projection::Pinhole)?;
    /// let lens = lens.with_max_angle(45.5)?;
    /// assert!(lens.project(&Point3::new(1.0, 0.0, 1.0)).is_some());
    /// assert!(lens.project(&Point3::new(1.1, 0.0, 1.0)).is_none());
    /// # Ok::<(), mvtop_geometry::Error>(())
    /// ```
    pub fn with_max_angle(self, degrees: f64) -> Result<Self> {
        if !(degrees > 0.0 && degrees <= 180.0) {
            return Err(Error::Camera(format!(
                "`max_angle_deg`, from the optical axis, must be above 0 and at most 180 degrees, got {degrees}"
            )));
        }
        let max_angle = Some(degrees);
        Ok(Self { max_angle, ..self })
    }

    /// Focal length along x, px.
    pub fn fx(&self) -> f64 {
        self.fx
    }

    /// Focal length along y, px.
    pub fn fy(&self) -> f64 {
        self.fy
    }

    /// Principal point's x, px.
    pub fn cx(&self) -> f64 {
        self.cx
    }

    /// Principal point's y, px.
    pub fn cy(&self) -> f64 {
        self.cy
    }

    /// What x gains for each focal length along y, px: 0 where the axes of the image are at right angles.
    pub fn skew(&self) -> f64 {
        self.skew
    }

    /// The camera matrix, in rows, px.
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        [
            [self.fx, self.skew, self.cx],
            [0.0, self.fy, self.cy],
            [0.0, 0.0, 1.0],
        ]
    }

    /// Between rays and the image plane of unit focal length.
    pub fn projection(&self) -> &Projection {
        &self.projection
    }

    /// Greatest angle from the optical axis at which something is imaged, degrees; `None` where the
    /// projection alone says it.
    pub fn max_angle_deg(&self) -> Option<f64> {
        self.max_angle
    }

    #[inline]
    fn reaches(&self, ray: &Vector3<f64>) -> bool {
        let angle = || ray.xy().norm().atan2(ray.z);
        self.max_angle
            .is_none_or(|most| angle() <= most.to_radians())
    }

    /// Whether straight lines stay straight: no distortion, no fisheye.
    pub fn is_pinhole(&self) -> bool {
        self.projection == Projection::Pinhole
    }

    /// Pixel at which a point of the camera frame (any unit of length) is imaged.
    ///
    /// `None` for a point that cannot be imaged: behind the camera (pinholes), or past the angle at
    /// which the distortion would fold the image back onto itself, or the lens images nothing.
    ///
    /// ```
    /// use mvtop_geometry::{Intrinsics, Projection};
    /// use nalgebra::Point3;
    ///
    /// let fisheye = Projection::from_params("fisheye", None, &[-0.006, 0.016, -0.024, 0.0155])?;
    /// let intrinsics = Intrinsics::new(278.0, 278.0, 315.5, 244.5, fisheye)?;
    /// let pixel = intrinsics.project(&Point3::new(1.0, 0.0, 0.0)).expect("fisheyes see sidewards");
    /// let ray = intrinsics.unproject(&pixel).expect("the way back");
    /// assert!((ray.x - 1.0).abs() < 1e-9);
    /// # Ok::<(), mvtop_geometry::Error>(())
    /// ```
    #[inline]
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        let point = Some(point).filter(|point| self.reaches(&point.coords))?;
        let image = self.projection.project(point)?;
        finite(self.pixel(image.x, image.y).into())
    }

    /// Pixel of a place on the image plane of unit focal length.
    #[inline(always)]
    fn pixel(&self, x: f64, y: f64) -> [f64; 2] {
        [self.fx * x + self.skew * y + self.cx, self.fy * y + self.cy]
    }

    /// Itself as a lens that projects without branches, if it is one.
    pub fn as_branchless(&self) -> Option<Branchless<'_>> {
        match &self.projection {
            _ if self.max_angle.is_some() => None,
            Projection::Pinhole => Some(Branchless(Kind::Pinhole(self))),
            Projection::BrownConrady(lens) if lens.is_upright() => {
                Some(Branchless(Kind::BrownConrady(self, lens)))
            }
            _ => None,
        }
    }

    /// Direction, in the camera frame, of the ray that is imaged at a pixel.
    ///
    /// The exact inverse of [`Intrinsics::project`], by Newton's method run until it settles; `None`
    /// where it does not, or where no ray within the projection's range meets the pixel.
    pub fn unproject(&self, pixel: &Point2<f64>) -> Option<Unit<Vector3<f64>>> {
        let y = (pixel.y - self.cy) / self.fy;
        let x = (pixel.x - self.cx - self.skew * y) / self.fx;
        let ray = self.projection.unproject(&finite(Point2::new(x, y))?)?;
        // The norm of a ray that overflowed is no longer 1.
        let ray = Unit::try_new(ray, 0.0).filter(|ray| (ray.norm() - 1.0).abs() < 1e-9)?;
        self.reaches(&ray).then_some(ray)
    }

    /// What hints at a mistake, given the size of the images.
    pub(super) fn check_size(&self, width: u32, height: u32) -> Result<(), String> {
        let axes = [
            (["fx", "cx", "width"], self.fx, self.cx, f64::from(width)),
            (["fy", "cy", "height"], self.fy, self.cy, f64::from(height)),
        ];
        for ([f, _, _], focal, _, side) in axes {
            if focal < side / 100.0 {
                return Err(format!(
                    "the focal length `{f}` of {focal} px is too short for an image of {side} px; \
                     give it in pixels, not in mm or as a share of the image"
                ));
            }
        }
        for ([_, c, of], _, center, side) in axes {
            if !(-side..=2.0 * side).contains(&center) {
                return Err(format!(
                    "the principal point `{c}` of {center} px lies more than one image size \
                     outside the image of `{of}` {side} px"
                ));
            }
        }
        Ok(())
    }
}

/// Lenses without limits of their own, most of all that there are, which project many points at once:
/// without branches, so that compilers make vectors of them. Where [`Intrinsics::project`] is `None`,
/// what they give is not finite.
#[derive(Debug, Clone, Copy)]
pub struct Branchless<'a>(Kind<'a>);

#[derive(Debug, Clone, Copy)]
enum Kind<'a> {
    Pinhole(&'a Intrinsics),
    BrownConrady(&'a Intrinsics, &'a BrownConrady),
}

impl Branchless<'_> {
    /// x and y, px, of the pixels of the points 0 to N - 1, in the camera frame.
    #[inline(always)]
    pub fn project<const N: usize>(&self, point: impl Fn(usize) -> Point3<f64>) -> [[f64; N]; 2] {
        let (mut x, mut y) = ([0.0; N], [0.0; N]);
        // A loop for each, as one that is given what to do as a closure is not made of vectors.
        match self.0 {
            Kind::Pinhole(lens) => {
                for i in 0..N {
                    let [on_x, on_y] = plane(&point(i));
                    [x[i], y[i]] = lens.pixel(on_x, on_y);
                }
            }
            Kind::BrownConrady(lens, distortion) => {
                for i in 0..N {
                    [x[i], y[i]] = plane(&point(i));
                }
                if distortion.is_calm(&[x, y]) {
                    for i in 0..N {
                        let [on_x, on_y] = distortion.distort_calm([x[i], y[i]]);
                        [x[i], y[i]] = lens.pixel(on_x, on_y);
                    }
                } else {
                    for i in 0..N {
                        let [on_x, on_y] = distortion.distort_or_nan([x[i], y[i]]);
                        [x[i], y[i]] = lens.pixel(on_x, on_y);
                    }
                }
            }
        }
        [x, y]
    }
}

/// The point on the plane z = 1; not finite unless it lies in front of the camera.
#[inline(always)]
fn plane(point: &Point3<f64>) -> [f64; 2] {
    let z = if point.z > 0.0 { point.z } else { f64::NAN };
    [point.x / z, point.y / z]
}

#[inline]
pub(super) fn finite(point: Point2<f64>) -> Option<Point2<f64>> {
    (point.x.is_finite() && point.y.is_finite()).then_some(point)
}
