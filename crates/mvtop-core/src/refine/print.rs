//! What is printed on a part: whether the images show it, and by it the turn of a round part about its
//! axis, which no edge tells.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Unit, UnitQuaternion, Vector3};

use super::picture::{Look, look};
use super::working::Working;
use crate::bundle::SurfacePoint;

/// Least standard deviation of each number over the part for it to say something.
const CONTRAST: Look = [0.15, 0.02, 0.02];
/// What points are averaged over, in diameters: first, to come near.
const AVERAGED: f64 = 0.04;
/// Then every pixel of so many is enough.
const SPARSELY: usize = 2;
/// What pixels are averaged over, in diameters, at last.
const SHARP: f64 = 0.008;
/// Angles that are tried to each side, and steps between them, degrees: first, and at last.
const NEAR: [f64; 2] = [24.0, 2.0];
const LAST: [f64; 2] = [5.0, 0.5];
/// Slices and sectors in which the outline is looked at, and how much it may differ of a round part, in
/// diameters.
const SLICES: usize = 8;
const SECTORS: usize = 8;
const ROUND: f64 = 0.0125;
/// Least correlation of what the images show with the print.
const ALIKE: f64 = 0.35;
/// Standard deviation of the turn that is found, degrees.
const SPREAD_DEG: f64 = 2.5;
/// Fewest points that a view shows.
const FEWEST: usize = 30;
/// A point farther than this behind what the mesh shows there is hidden, in diameters.
const HIDDEN: f64 = 0.02;

/// What is printed on a part.
pub struct Print {
    /// Object frame, metres.
    points: Vec<Point3<f64>>,
    /// Of each point, averaged over its neighbours and as it is.
    looks: [Vec<Look>; 2],
    /// Which of the numbers differ over the part.
    told: [bool; 3],
    /// About which it is round.
    axis: Option<Axis>,
    diameter: f64,
}

/// An axis of the part, object frame.
#[derive(Debug, Clone, Copy)]
struct Axis {
    through: Point3<f64>,
    along: Unit<Vector3<f64>>,
}

/// What a view shows, averaged over some pixels.
struct Averaged<'a> {
    view: &'a Working,
    /// One for each square of `every` pixels a side.
    looks: Vec<Look>,
    every: usize,
}

impl Print {
    /// `None` where the part looks alike all around.
    ///
    /// - `center`: middle of its box, object frame, metres
    /// - `diameter`: largest distance between two points, metres
    pub fn new(points: &[SurfacePoint], center: Point3<f64>, diameter: f64) -> Option<Self> {
        let look = |point: &SurfacePoint| look(point.color.map(f32::from));
        let (points, looks): (Vec<_>, Vec<_>) = points
            .iter()
            .filter_map(|point| Some((Point3::from(point.position), look(point)?)))
            .unzip();
        let axis = Axis::of(&points, center, diameter);
        let near = (AVERAGED * diameter).powi(2);
        let averaged: Vec<Look> = points
            .iter()
            .map(|point| {
                let alike = points.iter().zip(&looks);
                let alike = alike.filter(|(other, _)| (*other - point).norm_squared() <= near);
                mean(alike.map(|(_, look)| look))
            })
            .collect();
        let middle = mean(averaged.iter());
        let told = [0, 1, 2].map(|i| {
            let squares = averaged.iter().map(|look| (look[i] - middle[i]).powi(2));
            (squares.sum::<f32>() / averaged.len().max(1) as f32).sqrt() > CONTRAST[i]
        });
        told.contains(&true).then_some(Self {
            points,
            looks: [averaged, looks],
            told,
            axis,
            diameter,
        })
    }

    /// Whether the part is round, so that its turn is told by nothing else.
    #[cfg(test)]
    pub fn tells_turns(&self) -> bool {
        self.axis.is_some()
    }

    /// The pose of a round part, turned so that the print lies where the views show it; `None` where they
    /// do not tell.
    ///
    /// - `views`: with the mesh drawn at the pose
    pub fn turned(&self, views: &[Working], pose: &Isometry3<f64>) -> Option<Isometry3<f64>> {
        let axis = self.axis?;
        let mut at = 0.0;
        let passes = [(AVERAGED, SPARSELY, NEAR), (SHARP, 1, LAST)];
        for ((over, every, [reach, step]), looks) in passes.into_iter().zip(&self.looks) {
            let averaged: Vec<Averaged> = views
                .iter()
                .map(|view| Averaged::new(view, every, over * self.diameter))
                .collect();
            let count = (reach / step).round() as i32;
            let angle = |n: i32| at + (f64::from(n) * step).to_radians();
            let alike = |n: i32| self.alike(looks, &averaged, &(pose * axis.turn(angle(n))));
            let all: Vec<f64> = (-count..=count).map(alike).collect::<Option<_>>()?;
            let best = (0..all.len()).max_by(|a, b| all[*a].total_cmp(&all[*b]))?;
            if best == 0 || best + 1 == all.len() || all[best] < ALIKE {
                return None;
            }
            // The top of the parabola through the best one and its neighbours.
            let [before, here, after] = [all[best - 1], all[best], all[best + 1]];
            let bend = before - 2.0 * here + after;
            let beside = if bend < 0.0 {
                0.5 * (before - after) / bend
            } else {
                0.0
            };
            at = angle(best as i32 - count) + (beside * step).to_radians();
        }
        Some(pose * axis.turn(at))
    }

    /// What the print tells of a pose that was turned by it: inverse covariance of a turn (radians) and
    /// a shift, world frame.
    pub fn information(&self, pose: &Isometry3<f64>) -> Matrix6<f64> {
        let mut all = Matrix6::zeros();
        let Some(axis) = self.axis else { return all };
        let axis = pose * axis.along.into_inner();
        all.fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(axis * axis.transpose() * SPREAD_DEG.to_radians().powi(-2)));
        all
    }

    /// How far a view looks like the print, at most 1; `None` where it does not show enough of it.
    ///
    /// - `view`: with the mesh drawn at the pose
    pub fn seen(&self, view: &Working, pose: &Isometry3<f64>) -> Option<f64> {
        let averaged = Averaged::new(view, SPARSELY, AVERAGED * self.diameter);
        self.alike(&self.looks[0], &[averaged], pose)
    }

    /// How far the views look like the print, at most 1; `None` where none shows enough of it.
    fn alike(&self, looks: &[Look], views: &[Averaged], pose: &Isometry3<f64>) -> Option<f64> {
        let (mut sum, mut all) = (0.0, 0.0);
        for view in views {
            let pairs = self.pairs(looks, view, pose);
            if pairs.len() < FEWEST {
                continue;
            }
            for i in (0..3).filter(|&i| self.told[i]) {
                sum += pairs.len() as f64 * correlation(&pairs, i);
                all += pairs.len() as f64;
            }
        }
        (all > 0.0).then(|| sum / all)
    }

    /// Of each point that a view shows: how it looks, and what is seen there.
    fn pairs(&self, looks: &[Look], seen: &Averaged, pose: &Isometry3<f64>) -> Vec<[Look; 2]> {
        let Working {
            closeup, raster, ..
        } = seen.view;
        let (camera, hidden) = (&closeup.camera, HIDDEN * self.diameter);
        let cam_from_obj = camera.world_from_cam().inv_mul(pose);
        let of = |(point, look): (&Point3<f64>, &Look)| {
            let point = cam_from_obj * point;
            let index = raster.index(camera.intrinsics().project(&point)?)?;
            let shown = point.z < raster.depth(index) + hidden;
            let there = seen.at(index);
            (shown && there[0].is_finite()).then_some([*look, there])
        };
        self.points.iter().zip(looks).filter_map(of).collect()
    }
}

impl<'a> Averaged<'a> {
    /// - `every`: pixel of so many along each axis is looked at
    /// - `over`: on the object, metres
    fn new(view: &'a Working, every: usize, over: f64) -> Self {
        let camera = &view.closeup.camera;
        let size = (camera.width() as usize).div_ceil(every);
        let depth = view.raster.nearest();
        let half = over * camera.intrinsics().fx() / depth / every as f64;
        let looks = view.picture.looks(every);
        let looks = boxed(&looks, size, (half.round() as usize).min(size / 4));
        Self { view, looks, every }
    }

    /// What is seen around a pixel.
    fn at(&self, index: usize) -> Look {
        let size = self.view.closeup.camera.width() as usize;
        let [row, column] = [index / size, index % size].map(|x| x / self.every);
        self.looks[row * size.div_ceil(self.every) + column]
    }
}

impl Axis {
    /// The only one of the three principal axes about which the points are round.
    fn of(points: &[Point3<f64>], through: Point3<f64>, diameter: f64) -> Option<Self> {
        let spread = points.iter().map(|point| point - through);
        let spread: Matrix3<f64> = spread.map(|off| off * off.transpose()).sum();
        let principal = spread.symmetric_eigen().eigenvectors;
        let axes = principal.column_iter().map(|along| Self {
            through,
            along: Unit::new_normalize(along.into_owned()),
        });
        let mut round = axes.filter(|axis| axis.unevenness(points) < ROUND * diameter);
        round.next().filter(|_| round.next().is_none())
    }

    /// How much the outline's distance from the axis differs around it (standard deviation over sectors,
    /// in the slice across the axis where it is greatest), metres.
    fn unevenness(&self, points: &[Point3<f64>]) -> f64 {
        let aside = self.along.cross(&Vector3::ith(self.along.iamin(), 1.0));
        let aside = Unit::new_normalize(aside);
        let third = self.along.cross(&aside);
        let heights = points.iter().map(|p| self.along.dot(&(p - self.through)));
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| {
            (low.min(h), high.max(h))
        });
        let mut outline = [[0.0_f64; SECTORS]; SLICES];
        let place = |share: f64, count: usize| ((share * count as f64) as usize).min(count - 1);
        for point in points {
            let off = point - self.through;
            let (x, y) = (aside.dot(&off), third.dot(&off));
            let slice = place((self.along.dot(&off) - low) / (high - low), SLICES);
            let sector = place(y.atan2(x) / TAU + 0.5, SECTORS);
            let farthest = &mut outline[slice][sector];
            *farthest = farthest.max(x.hypot(y));
        }
        let deviation = |slice: &[f64; SECTORS]| {
            let mean = slice.iter().sum::<f64>() / SECTORS as f64;
            let squares = slice.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
            (squares / SECTORS as f64).sqrt()
        };
        outline.iter().map(deviation).fold(0.0, f64::max)
    }

    fn turn(&self, angle: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&self.along, angle);
        Isometry3::rotation_wrt_point(turn, self.through)
    }
}

fn mean<'a>(looks: impl Iterator<Item = &'a Look>) -> Look {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for look in looks {
        sum.iter_mut().zip(look).for_each(|(sum, x)| *sum += x);
        count += 1.0;
    }
    sum.map(|x| x / count)
}

/// Pearson's, of one of the numbers.
fn correlation(pairs: &[[Look; 2]], i: usize) -> f64 {
    let count = pairs.len() as f64;
    let mut sums = [0.0; 5];
    for [a, b] in pairs {
        let (a, b) = (f64::from(a[i]), f64::from(b[i]));
        let terms = [a, b, a * a, b * b, a * b];
        sums.iter_mut().zip(terms).for_each(|(sum, x)| *sum += x);
    }
    let [a, b, aa, bb, ab] = sums.map(|sum| sum / count);
    let spread = ((aa - a * a).max(0.0) * (bb - b * b).max(0.0)).sqrt();
    if spread > 1e-9 {
        (ab - a * b) / spread
    } else {
        0.0
    }
}

/// Means over squares of `2 half + 1` px, of what is known there.
fn boxed(looks: &[Look], size: usize, half: usize) -> Vec<Look> {
    // Sums of all above and to the left, with how many are known.
    let side = size + 1;
    let mut sums = vec![[0.0_f64; 4]; side * side];
    for row in 0..size {
        let mut line = [0.0; 4];
        for column in 0..size {
            let look = looks[row * size + column];
            if look[0].is_finite() {
                (0..3).for_each(|i| line[i] += f64::from(look[i]));
                line[3] += 1.0;
            }
            let above = sums[row * side + column + 1];
            sums[(row + 1) * side + column + 1] = std::array::from_fn(|i| above[i] + line[i]);
        }
    }
    let mean = |row: usize, column: usize| {
        let [top, left] = [row, column].map(|x| x.saturating_sub(half));
        let [bottom, right] = [row, column].map(|x| (x + half + 1).min(size));
        let corner = |row: usize, column: usize| sums[row * side + column];
        let (a, b) = (corner(top, left), corner(top, right));
        let (c, d) = (corner(bottom, left), corner(bottom, right));
        let sum: [f64; 4] = std::array::from_fn(|i| d[i] - b[i] - c[i] + a[i]);
        [0, 1, 2].map(|i| (sum[i] / sum[3]) as f32)
    };
    (0..size * size)
        .map(|index| mean(index / size, index % size))
        .collect()
}
