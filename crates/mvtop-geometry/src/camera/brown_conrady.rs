//! Radial, tangential and thin prism distortion of a pinhole camera, and a tilted sensor (OpenCV's
//! `projectPoints`).
//!
//! Source: Brown, "Decentering distortion of lenses", 1966; the rational radial factor is OpenCV's.

use nalgebra::{Matrix2, Matrix3, Point2, Point3, Rotation3, Vector3};

use super::projection::{ProjectionModel, on_plane, padded};
use super::radial;

/// Tangent of the widest angle from the axis that a pinhole with distortion is used at, 89.94°.
const WIDEST: f64 = 1e3;
/// Largest remaining error of an undistorted point, in focal lengths: some 1e-9 px.
const SETTLED: f64 = 1e-12;

/// Brown-Conrady distortion with 0, 4, 5, 8, 12 or 14 coefficients.
///
/// With `r² = x² + y²`, a point `(x, y)` on the plane z = 1 moves to
///
/// ```text
/// g  = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
/// x' = g x + 2 p1 x y + p2 (r² + 2 x²) + s1 r² + s2 r⁴
/// y' = g y + p1 (r² + 2 y²) + 2 p2 x y + s3 r² + s4 r⁴
/// ```
///
/// and from there onto the plane of a sensor that is tilted by `tx` and `ty` about its x and y axes,
/// radians.
#[derive(Debug, Clone, PartialEq)]
pub struct BrownConrady {
    params: [f64; 14],
    /// Radius at which `g r` stops rising; beyond it the image would fold back.
    fold: f64,
    /// Square of a radius up to which nothing folds for certain.
    calm: f64,
    /// `None` for a sensor that is not tilted, as nearly all are.
    tilt: Option<Box<Tilt>>,
}

/// Between the plane z = 1 and a tilted one.
#[derive(Debug, Clone, PartialEq)]
struct Tilt {
    tilted_from_plane: Matrix3<f64>,
    plane_from_tilted: Matrix3<f64>,
}

impl ProjectionModel for BrownConrady {
    const FAMILY: &'static str = "pinhole";
    const NAME: &'static str = "brown_conrady";
    const PARAMS: &'static [&'static str] = &[
        "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty",
    ];
    const COUNTS: &'static [usize] = &[0, 4, 5, 8, 12, 14];

    fn from_finite(params: &[f64]) -> Self {
        let params: [f64; 14] = padded(params);
        let [k1, k2, _, _, k3, k4, k5, k6, _, _, _, _, tx, ty] = params;
        let fold = fold([k1, k2, k3], [k4, k5, k6]);
        Self {
            params,
            fold,
            calm: calm(&params, fold),
            tilt: Tilt::new(tx, ty).map(Box::new),
        }
    }

    /// The rare ones, of thin prisms and tilted sensors, are left out where they are 0.
    fn params(&self) -> &[f64] {
        let zero = |range: &[f64]| range.iter().all(|&p| p == 0.0);
        match &self.params {
            all if zero(&all[8..]) => &all[..8],
            all if zero(&all[12..]) => &all[..12],
            all => all,
        }
    }

    fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        self.distort(&on_plane(point)?)
    }

    fn unproject(&self, image: &Point2<f64>) -> Option<Vector3<f64>> {
        Some(self.undistort(image)?.coords.push(1.0))
    }
}

impl BrownConrady {
    /// Where a point of the plane z = 1 is imaged, in focal lengths from the principal point;
    /// `None` past the fold.
    pub fn distort(&self, point: &Point2<f64>) -> Option<Point2<f64>> {
        let (image, jacobian) = self.map(point);
        let image = self.in_range(point, &jacobian).then_some(image)?;
        match &self.tilt {
            None => Some(image),
            Some(tilt) => along(&tilt.tilted_from_plane, &image),
        }
    }

    /// [`BrownConrady::distort`] without branches, for a sensor that is not tilted; NaN for `None`.
    #[inline(always)]
    pub(super) fn distort_or_nan(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let point = Point2::new(x, y);
        let (image, jacobian) = self.map(&point);
        let shown = self.in_range(&point, &jacobian);
        [image.x, image.y].map(|x| if shown { x } else { f64::NAN })
    }

    /// Whether points of the plane z = 1 are so near the axis that [`BrownConrady::distort_calm`] does.
    #[inline(always)]
    pub(super) fn is_calm<const N: usize>(&self, [x, y]: &[[f64; N]; 2]) -> bool {
        // Without branches.
        (0..N).fold(true, |calm, i| {
            calm & (x[i] * x[i] + y[i] * y[i] <= self.calm)
        })
    }

    /// [`BrownConrady::distort_or_nan`] where nothing folds.
    #[inline(always)]
    pub(super) fn distort_calm(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        self.map(&Point2::new(x, y)).0.into()
    }

    /// Whether the sensor is not tilted.
    pub(super) fn is_upright(&self) -> bool {
        self.tilt.is_none()
    }

    /// The inverse of [`BrownConrady::distort`]; `None` where it does not settle.
    pub fn undistort(&self, image: &Point2<f64>) -> Option<Point2<f64>> {
        let image = &match &self.tilt {
            None => *image,
            Some(tilt) => along(&tilt.plane_from_tilted, image)?,
        };
        // The radial part alone has a safe inverse, and the tangential part moves it but little.
        let radius = image.coords.norm();
        let start =
            radial::invert(|r| self.profile(r), radius, self.fold).unwrap_or(0.99 * self.fold);
        let mut point = image * if radius > 0.0 { start / radius } else { 1.0 };
        let (at, mut jacobian) = self.map(&point);
        let mut error = at - image;
        for _ in 0..50 {
            if error.norm() <= SETTLED * (1.0 + radius) {
                return self.in_range(&point, &jacobian).then_some(point);
            }
            let step = jacobian.try_inverse()? * error;
            // A whole step may leap over the fold, or away from the solution where the lens bends
            // strongly: it is halved until it helps.
            (point, error, jacobian) = (0..30).find_map(|halvings| {
                let next = point - step * 0.5f64.powi(halvings);
                let (at, jacobian) = self.map(&next);
                let left = at - image;
                let helps = left.norm() < error.norm() && self.in_range(&next, &jacobian);
                helps.then_some((next, left, jacobian))
            })?;
        }
        None
    }

    #[inline(always)]
    fn in_range(&self, point: &Point2<f64>, jacobian: &Matrix2<f64>) -> bool {
        // Not `&&`, which is a branch.
        (point.coords.norm() <= self.fold) & (jacobian.determinant() > 0.0)
    }

    /// The radial factor `g` and its derivative by r².
    #[inline(always)]
    fn factor(&self, r2: f64) -> (f64, f64) {
        let [k1, k2, _, _, k3, k4, k5, k6, ..] = self.params;
        let over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let d_over = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let d_under = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        let g = over / under;
        (g, (d_over - g * d_under) / under)
    }

    /// `g r` and its derivative by `r`.
    fn profile(&self, r: f64) -> (f64, f64) {
        let (g, dg) = self.factor(r * r);
        (g * r, g + 2.0 * r * r * dg)
    }

    /// The distorted point and the derivative of the distortion there.
    #[inline(always)]
    fn map(&self, point: &Point2<f64>) -> (Point2<f64>, Matrix2<f64>) {
        let [_, _, p1, p2, _, _, _, _, s1, s2, s3, s4, _, _] = self.params;
        let (x, y) = (point.x, point.y);
        let r2 = x * x + y * y;
        let (g, dg) = self.factor(r2);
        let image = Point2::new(
            g * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2),
            g * y + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4),
        );
        // Of the thin prism, by r².
        let (prism_x, prism_y) = (s1 + 2.0 * r2 * s2, s3 + 2.0 * r2 * s4);
        let cross = 2.0 * (dg * x * y + p1 * x + p2 * y);
        let jacobian = Matrix2::new(
            g + 2.0 * (dg * x * x + p1 * y + 3.0 * p2 * x + prism_x * x),
            cross + 2.0 * prism_x * y,
            cross + 2.0 * prism_y * x,
            g + 2.0 * (dg * y * y + 3.0 * p1 * y + p2 * x + prism_y * y),
        );
        (image, jacobian)
    }
}

impl Tilt {
    /// - `tx`, `ty`: about the sensor's x and y axes, radians
    fn new(tx: f64, ty: f64) -> Option<Self> {
        if [tx, ty] == [0.0, 0.0] {
            return None;
        }
        // OpenCV's angles turn the other way.
        let about = |axis, angle: f64| Rotation3::from_axis_angle(&axis, -angle);
        let turn = (about(Vector3::y_axis(), ty) * about(Vector3::x_axis(), tx)).into_inner();
        let flatten = Matrix3::new(
            turn[(2, 2)],
            0.0,
            -turn[(0, 2)], // in rows
            0.0,
            turn[(2, 2)],
            -turn[(1, 2)], //
            0.0,
            0.0,
            1.0,
        );
        let tilted_from_plane = flatten * turn;
        // A sensor seen edge-on has no image: zeros let no point through.
        let plane_from_tilted = tilted_from_plane.try_inverse().unwrap_or_default();
        Some(Self {
            tilted_from_plane,
            plane_from_tilted,
        })
    }
}

/// A point through a homography; `None` where it goes to infinity or past it.
fn along(homography: &Matrix3<f64>, point: &Point2<f64>) -> Option<Point2<f64>> {
    let moved = homography * point.coords.push(1.0);
    on_plane(&Point3::from(moved))
}

/// Square of a radius, below the fold, up to which the Jacobian's determinant is above 0 for certain: where
/// its entries differ from the identity's by less than a half in each row. A bound: 0 of lenses that bend
/// strongly everywhere.
fn calm(params: &[f64; 14], fold: f64) -> f64 {
    let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, _, _] = params.map(f64::abs);
    let is_calm = |r2: &f64| {
        let r2 = *r2;
        let series = |a: f64, b: f64, c: f64| r2 * (a + r2 * (b + r2 * c));
        let slope = |a: f64, b: f64, c: f64| a + r2 * (2.0 * b + r2 * 3.0 * c);
        let (over, under) = (series(k1, k2, k3), series(k4, k5, k6));
        let (d_over, d_under) = (slope(k1, k2, k3), slope(k4, k5, k6));
        let least = 1.0 - under;
        let g = (over + under) / least;
        let dg = (d_over + (1.0 + over) / least * d_under) / least;
        let prism = s1 + s3 + 2.0 * r2 * (s2 + s4);
        let row = g + 3.0 * r2 * dg + 8.0 * r2.sqrt() * (p1 + p2 + prism);
        r2 < 0.99 * fold * fold && least > 0.1 && row < 0.5
    };
    let mut tried = (0..100).map(|n| 4.0 * 0.9_f64.powi(n));
    tried.find(is_calm).unwrap_or(0.0)
}

/// The first radius at which `g r` stops rising or `g` has a pole, at most [`WIDEST`].
fn fold([k1, k2, k3]: [f64; 3], [k4, k5, k6]: [f64; 3]) -> f64 {
    let over = [1.0, k1, k2, k3];
    let under = [1.0, k4, k5, k6];
    // The sign of d(g r)/dr as a polynomial in s = r²: under (over + 2s over') - 2s over under'.
    let twice_s = |p: &[f64]| radial::product(&[0.0, 2.0], &radial::derivative(p));
    let plus = |a: &[f64], factor: f64, b: &[f64]| -> Vec<f64> {
        a.iter().zip(b).map(|(a, b)| a + factor * b).collect()
    };
    let rise = plus(&over, 1.0, &twice_s(&over));
    let fall = radial::product(&over, &twice_s(&under));
    let slope = plus(&radial::product(&under, &rise), -1.0, &fall);
    [&slope[..], &under[..]]
        .iter()
        .filter_map(|p| radial::sign_changes(p, WIDEST * WIDEST).first().copied())
        .fold(WIDEST * WIDEST, f64::min)
        .sqrt()
        // A hair inside: rounding must not put the end of the range on the far side of a pole.
        * (1.0 - SETTLED)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_folds_where_a_lens_is_calm() {
        let lenses: [(&[f64], f64); 5] = [
            (&[-0.1, 0.01, 0.001, -0.001, 0.0], 0.5),
            (&[-0.3, 0.1, 0.01, -0.01, 0.0], 0.2),
            (&[8.0, -3.0, 0.001, 0.0, 0.2, 8.4, -1.0, 0.5], 0.0),
            (
                &[
                    0.4, -0.2, 0.02, 0.01, 0.1, 0.3, 0.1, -0.1, 0.02, 0.01, -0.03, 0.01,
                ],
                0.02,
            ),
            (&[300.0, 0.0, 5.0, 5.0], 0.0),
        ];
        for (params, least) in lenses {
            let lens = BrownConrady::new(params).unwrap();
            assert!(lens.calm >= least, "{} of {params:?}", lens.calm);
            for i in 0..1000 {
                let (share, angle) = (f64::from(i) / 999.0, f64::from(i));
                let radius = (lens.calm * share).sqrt() * (1.0 - 1e-12);
                let point = [radius * angle.cos(), radius * angle.sin()];
                assert!(lens.is_calm(&point.map(|x| [x])));
                assert_eq!(lens.distort_calm(point), lens.distort_or_nan(point));
            }
            assert!(!lens.is_calm(&[[0.0, f64::NAN], [0.0, 0.0]]));
        }
    }
}
