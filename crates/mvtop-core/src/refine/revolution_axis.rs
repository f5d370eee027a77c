//! The axis of a surface of revolution.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Matrix3, Point3, Unit, UnitQuaternion, Vector3};

/// Slices along the axis and sectors around it, in which the outline is compared.
const SLICES: usize = 8;
const SECTORS: usize = 8;

/// An axis, object frame.
#[derive(Debug, Clone, Copy)]
pub struct RevolutionAxis {
    through: Point3<f64>,
    pub along: Unit<Vector3<f64>>,
}

impl RevolutionAxis {
    /// The only principal axis about which the points are round.
    ///
    /// - `max_unevenness`: largest standard deviation of the radius, metres
    pub fn fit(points: &[Point3<f64>], through: Point3<f64>, max_unevenness: f64) -> Option<Self> {
        let spread = points.iter().map(|point| point - through);
        let spread: Matrix3<f64> = spread.map(|off| off * off.transpose()).sum();
        let principal = spread.symmetric_eigen().eigenvectors;
        let axes = principal.column_iter().map(|along| Self {
            through,
            along: Unit::new_normalize(along.into_owned()),
        });
        let mut round = axes.filter(|axis| axis.unevenness(points) < max_unevenness);
        round.next().filter(|_| round.next().is_none())
    }

    /// Rotation about the axis, radians.
    pub fn rotation(&self, angle: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&self.along, angle);
        Isometry3::rotation_wrt_point(turn, self.through)
    }

    /// Standard deviation over sectors of the outline's radius, in the slice with the largest one,
    /// metres.
    fn unevenness(&self, points: &[Point3<f64>]) -> f64 {
        let aside = self.along.cross(&Vector3::ith(self.along.iamin(), 1.0));
        let aside = Unit::new_normalize(aside);
        let third = self.along.cross(&aside);
        let heights = points.iter().map(|p| self.along.dot(&(p - self.through)));
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| {
            (low.min(h), high.max(h))
        });
        let mut radii = [[0.0_f64; SECTORS]; SLICES];
        let place = |share: f64, count: usize| ((share * count as f64) as usize).min(count - 1);
        for point in points {
            let off = point - self.through;
            let (x, y) = (aside.dot(&off), third.dot(&off));
            let slice = place((self.along.dot(&off) - low) / (high - low), SLICES);
            let sector = place(y.atan2(x) / TAU + 0.5, SECTORS);
            let radius = &mut radii[slice][sector];
            *radius = radius.max(x.hypot(y));
        }
        let deviation = |slice: &[f64; SECTORS]| {
            let mean = slice.iter().sum::<f64>() / SECTORS as f64;
            let squares = slice.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
            (squares / SECTORS as f64).sqrt()
        };
        radii.iter().map(deviation).fold(0.0, f64::max)
    }
}
