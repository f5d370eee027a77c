//! The inner loops over an object's points, compiled for AVX2 and AVX-512 as well on x86-64.

use mvtop_core::dispatch;
use nalgebra::{Isometry3, Matrix3, Vector3};

/// Points that are worked on together.
pub(super) const LANES: usize = 8;
/// Points after which a maximum is compared with its bound.
const STRIDE: usize = 8 * LANES;

/// Coordinates, each axis by itself.
#[derive(Debug, Clone, Default)]
pub(super) struct Columns {
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    pub z: Vec<f64>,
}

/// `matrix * p + offset`: a motion, or the difference of two.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Affine {
    m: [[f64; 3]; 3],
    t: [f64; 3],
}

/// Two poses before a pinhole of focal lengths `fx`, `fy`; its center does not matter to them.
#[derive(Debug, Clone, Copy)]
pub(super) struct PinholePair {
    pub truth: Affine,
    pub estimate: Affine,
    pub fx: f64,
    pub fy: f64,
}

impl Affine {
    pub fn new(motion: &Isometry3<f64>) -> Self {
        Self::from_parts(
            motion.rotation.to_rotation_matrix().into_inner(),
            motion.translation.vector,
        )
    }

    /// `a(p) - b(p)`.
    pub fn difference(a: &Isometry3<f64>, b: &Isometry3<f64>) -> Self {
        Self::from_parts(
            a.rotation.to_rotation_matrix().into_inner()
                - b.rotation.to_rotation_matrix().into_inner(),
            a.translation.vector - b.translation.vector,
        )
    }

    pub fn from_parts(matrix: Matrix3<f64>, offset: Vector3<f64>) -> Self {
        Self {
            m: std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)])),
            t: offset.into(),
        }
    }

    #[inline(always)]
    pub fn apply(&self, x: f64, y: f64, z: f64) -> [f64; 3] {
        let Self { m, t } = self;
        [
            m[0][0] * x + m[0][1] * y + m[0][2] * z + t[0],
            m[1][0] * x + m[1][1] * y + m[1][2] * z + t[1],
            m[2][0] * x + m[2][1] * y + m[2][2] * z + t[2],
        ]
    }

    #[inline(always)]
    fn squared(&self, x: f64, y: f64, z: f64) -> f64 {
        let [x, y, z] = self.apply(x, y, z);
        x * x + y * y + z * z
    }
}

/// Sum of the lengths of what the points become.
pub(super) fn sum_of_lengths(points: &Columns, map: &Affine) -> f64 {
    dispatch!(
        ["avx512f", "avx2"],
        sum_of_lengths_portable(points: &Columns, map: &Affine) -> f64
    )
}

/// Greatest squared length of what the points become; anything above `bound` once that is certain
/// to be exceeded.
pub(super) fn max_squared(points: &Columns, map: &Affine, bound: f64) -> f64 {
    dispatch!(
        ["avx512f", "avx2"],
        max_squared_portable(points: &Columns, map: &Affine, bound: f64) -> f64
    )
}

/// Greatest squared distance of the points' pixels under both poses; as [`max_squared`]. Infinite
/// where a point lies behind the camera.
pub(super) fn max_squared_px(points: &Columns, pair: &PinholePair, bound: f64) -> f64 {
    dispatch!(
        ["avx512f", "avx2"],
        max_squared_px_portable(points: &Columns, pair: &PinholePair, bound: f64) -> f64
    )
}

#[inline(always)]
fn sum_of_lengths_portable(points: &Columns, map: &Affine) -> f64 {
    let n = points.x.len();
    let mut sums = [0.0; LANES];
    let whole = n - n % LANES;
    for first in (0..whole).step_by(LANES) {
        let [x, y, z] = lanes(points, first);
        for lane in 0..LANES {
            sums[lane] += map.squared(x[lane], y[lane], z[lane]).sqrt();
        }
    }
    let rest = (whole..n).map(|i| map.squared(points.x[i], points.y[i], points.z[i]).sqrt());
    sums.iter().sum::<f64>() + rest.sum::<f64>()
}

#[inline(always)]
fn max_squared_portable(points: &Columns, map: &Affine, bound: f64) -> f64 {
    greatest(points, bound, |x, y, z| map.squared(x, y, z))
}

#[inline(always)]
fn max_squared_px_portable(points: &Columns, pair: &PinholePair, bound: f64) -> f64 {
    greatest(points, bound, |x, y, z| {
        let [xa, ya, za] = pair.truth.apply(x, y, z);
        let [xb, yb, zb] = pair.estimate.apply(x, y, z);
        // x_a / z_a - x_b / z_b over one denominator: divisions are what takes the time.
        let both = 1.0 / (za * zb);
        let du = pair.fx * (xa * zb - xb * za) * both;
        let dv = pair.fy * (ya * zb - yb * za) * both;
        if za > 0.0 && zb > 0.0 {
            du * du + dv * dv
        } else {
            f64::INFINITY
        }
    })
}

/// Greatest value over the points; leaves off where `bound` is exceeded.
#[inline(always)]
fn greatest(points: &Columns, bound: f64, value: impl Fn(f64, f64, f64) -> f64) -> f64 {
    let n = points.x.len();
    let mut greatest = 0.0;
    for start in (0..n).step_by(STRIDE) {
        let end = (start + STRIDE).min(n);
        let whole = end - (end - start) % LANES;
        let mut most = [0.0; LANES];
        for first in (start..whole).step_by(LANES) {
            let [x, y, z] = lanes(points, first);
            for lane in 0..LANES {
                most[lane] = larger(most[lane], value(x[lane], y[lane], z[lane]));
            }
        }
        for i in whole..end {
            most[0] = larger(most[0], value(points.x[i], points.y[i], points.z[i]));
        }
        greatest = most.into_iter().fold(greatest, larger);
        if greatest > bound {
            break;
        }
    }
    greatest
}

/// Becomes one instruction, unlike `f64::max`, which minds NaN.
#[inline(always)]
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if b > a { b } else { a }
}

/// As [`larger`].
#[inline(always)]
pub(super) fn smaller(a: f64, b: f64) -> f64 {
    if b < a { b } else { a }
}

#[inline(always)]
fn lanes(points: &Columns, first: usize) -> [[f64; LANES]; 3] {
    [&points.x, &points.y, &points.z]
        .map(|axis| std::array::from_fn(|lane| axis[first..first + LANES][lane]))
}
