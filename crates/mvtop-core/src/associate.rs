//! Which boxes of different views show the same object, told by their lines of sight.
//!
//! No appearance is compared: identical objects look alike, but only one place lies on the lines
//! of sight of all the boxes that show one object.

use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashSet};

use nalgebra::Vector3;

use crate::config::AssociationConfig;
use crate::rays::BoxRays;
use crate::{BBox, Camera};

/// The line of sight through a box's center and how large the box appears.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineOfSight {
    /// Index into the bundle's classes; only equal classes match.
    pub class: usize,
    /// Camera center in the world, metres.
    pub origin: Vector3<f64>,
    /// Unit vector in the world frame.
    pub direction: Vector3<f64>,
    /// Sine of half the angle under which the box appears: a ball at distance `z` that fills the
    /// box has the radius `z * sin_radius`.
    pub sin_radius: f64,
}

impl LineOfSight {
    /// Of a box in a camera's image, in the world frame; `None` where the lens gives no rays for it.
    pub fn new(class: usize, camera: &Camera, bbox: BBox) -> Option<Self> {
        let rays = BoxRays::new(camera, bbox)?;
        Some(Self {
            class,
            origin: camera.world_from_cam().translation.vector,
            direction: camera.world_from_cam().rotation * rays.center,
            sin_radius: (rays.half_x.norm() * rays.half_y.norm()).sqrt(),
        })
    }
}

/// Groups the boxes of all views into objects.
///
/// Two boxes of a class match where their rays meet in front of both cameras, the apparent radii there
/// are similar, and their mean is a size that an object of the class can have. Each matching pair proposes a place, and every other view
/// adds the box that fits it best. Places that more views agree on go first, then those that fit
/// better: so a third view settles which of two crossings in the first two is real. A box in no match
/// is an object seen by one view.
///
/// - `views`: lines of sight of the boxes of each view, `[V][boxes]`
/// - `radii`: least and greatest half width of each class, metres, see
///   [`crate::bundle::Class::half_widths`]
/// - returns: for each object, the index of its box in each view, `[objects][V]`; every box is
///   in exactly one object
pub fn associate(
    config: &AssociationConfig,
    views: &[Vec<LineOfSight>],
    radii: &[[f64; 2]],
) -> Vec<Vec<Option<usize>>> {
    let mut free = all_free(views);
    let mut queue = BinaryHeap::from(proposals(config, views, radii, &free));

    let mut objects = Vec::new();
    while let Some(best) = queue.pop() {
        if best.boxes().any(|(view, index)| !free[view][index]) {
            // Some of its boxes went to a better object: try again with those that are left.
            queue.extend(Proposal::grow(config, best.seed, views, radii, &free));
            continue;
        }
        for (view, index) in best.boxes() {
            free[view][index] = false;
        }
        objects.push(best.members);
    }

    for (view, boxes) in free.iter().enumerate() {
        for index in (0..boxes.len()).filter(|&index| boxes[index]) {
            let mut members = vec![None; views.len()];
            members[view] = Some(index);
            objects.push(members);
        }
    }
    objects
}

/// All matches of boxes, the best one first: a box may be in several.
///
/// Arguments and matches are those of [`associate`]; a box in no match is not returned.
pub fn matches(
    config: &AssociationConfig,
    views: &[Vec<LineOfSight>],
    radii: &[[f64; 2]],
) -> Vec<Vec<Option<usize>>> {
    let mut all = proposals(config, views, radii, &all_free(views));
    all.sort_by(|a, b| b.cmp(a));
    let mut known = HashSet::new();
    let members = all.into_iter().map(|one| one.members);
    members.filter(|one| known.insert(one.clone())).collect()
}

/// Of each box, that it is in no object yet.
fn all_free(views: &[Vec<LineOfSight>]) -> Vec<Vec<bool>> {
    views.iter().map(|boxes| vec![true; boxes.len()]).collect()
}

/// What each pair of boxes proposes.
fn proposals(
    config: &AssociationConfig,
    views: &[Vec<LineOfSight>],
    radii: &[[f64; 2]],
    free: &[Vec<bool>],
) -> Vec<Proposal> {
    let seeds = pairs(views).into_iter();
    seeds
        .filter_map(|seed| Proposal::grow(config, seed, views, radii, free))
        .collect()
}

/// Two boxes, each by view and index.
type Pair = [(usize, usize); 2];

fn pairs(views: &[Vec<LineOfSight>]) -> Vec<Pair> {
    let mut pairs = Vec::new();
    for second in 1..views.len() {
        for first in 0..second {
            for i in 0..views[first].len() {
                pairs.extend((0..views[second].len()).map(|j| [(first, i), (second, j)]));
            }
        }
    }
    pairs
}

/// A place proposed by two boxes, with the boxes of all views that agree.
struct Proposal {
    seed: Pair,
    members: Vec<Option<usize>>,
    /// Mean over the boxes beyond the first; 0 is a perfect fit.
    cost: f64,
}

impl Proposal {
    /// `None` where the seed's boxes are taken or do not match.
    fn grow(
        config: &AssociationConfig,
        seed: Pair,
        views: &[Vec<LineOfSight>],
        radii: &[[f64; 2]],
        free: &[Vec<bool>],
    ) -> Option<Self> {
        let [(first, i), (second, j)] = seed;
        if !free[first][i] || !free[second][j] {
            return None;
        }
        let (ball, mut cost) = meet(config, &views[first][i], &views[second][j])?;
        if !is_of_class(config, ball.radius, *radii.get(ball.class)?) {
            return None;
        }
        let mut members = vec![None; views.len()];
        members[first] = Some(i);
        members[second] = Some(j);
        for (view, boxes) in views.iter().enumerate() {
            if members[view].is_some() {
                continue;
            }
            let fit = (0..boxes.len())
                .filter(|&index| free[view][index])
                .filter_map(|index| Some((index, ball.fit(config, &boxes[index])?)))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((index, miss)) = fit {
                members[view] = Some(index);
                cost += miss;
            }
        }
        let seen = members.iter().flatten().count();
        Some(Self {
            seed,
            members,
            cost: cost / (seen - 1) as f64,
        })
    }

    fn boxes(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.members
            .iter()
            .enumerate()
            .filter_map(|(view, index)| Some((view, (*index)?)))
    }
}

impl Ord for Proposal {
    /// More views first, then the better fit, then the earlier boxes (so that ties are settled).
    fn cmp(&self, other: &Self) -> Ordering {
        let seen = |proposal: &Self| proposal.members.iter().flatten().count();
        seen(self)
            .cmp(&seen(other))
            .then(other.cost.total_cmp(&self.cost))
            .then(other.seed.cmp(&self.seed))
    }
}

impl PartialOrd for Proposal {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Proposal {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Proposal {}

/// Where an object is thought to be, and how large, metres.
struct Ball {
    class: usize,
    center: Vector3<f64>,
    radius: f64,
}

impl Ball {
    /// The cost of taking a box for a sight of this ball, or `None` where it is not one.
    fn fit(&self, config: &AssociationConfig, sight: &LineOfSight) -> Option<f64> {
        let to_center = self.center - sight.origin;
        let depth = to_center.dot(&sight.direction);
        if sight.class != self.class || depth <= 0.0 {
            return None;
        }
        let miss = (to_center - depth * sight.direction).norm();
        cost(config, miss, self.radius, depth * sight.sin_radius)
    }
}

/// Where two lines of sight are nearest to each other.
struct Nearest {
    on_a: Vector3<f64>,
    on_b: Vector3<f64>,
    /// Apparent radii there, metres.
    radius_a: f64,
    radius_b: f64,
}

impl Nearest {
    /// `None` where that is not in front of both cameras.
    fn of(a: &LineOfSight, b: &LineOfSight) -> Option<Self> {
        // Nearest points a.origin + s * a.direction and b.origin + t * b.direction.
        let baseline = b.origin - a.origin;
        let cosine = a.direction.dot(&b.direction);
        let sine_squared = a.direction.cross(&b.direction).norm_squared();
        let (along_a, along_b) = (baseline.dot(&a.direction), baseline.dot(&b.direction));
        let widths = a.sin_radius + b.sin_radius;
        // Of cameras that look at each other past the object, sizes tell best where between them it is.
        let facing = cosine < 0.0 && along_a > 0.0 && along_b < 0.0;
        let [s, t] = match facing && sine_squared < (widths / 2.0).powi(2) {
            true => [b, a].map(|other| baseline.norm() * other.sin_radius / widths),
            false => {
                [along_a - cosine * along_b, cosine * along_a - along_b].map(|x| x / sine_squared)
            }
        };
        // Parallel lines meet nowhere: s and t are then not finite.
        (s > 0.0 && t > 0.0 && s.is_finite() && t.is_finite()).then(|| Self {
            on_a: a.origin + s * a.direction,
            on_b: b.origin + t * b.direction,
            radius_a: s * a.sin_radius,
            radius_b: t * b.sin_radius,
        })
    }

    fn gap(&self) -> f64 {
        (self.on_a - self.on_b).norm()
    }
}

/// The ball that two boxes agree on and the cost of the match.
fn meet(config: &AssociationConfig, a: &LineOfSight, b: &LineOfSight) -> Option<(Ball, f64)> {
    if a.class != b.class {
        return None;
    }
    let nearest = Nearest::of(a, b)?;
    let cost = cost(config, nearest.gap(), nearest.radius_a, nearest.radius_b)?;
    let ball = Ball {
        class: a.class,
        center: (nearest.on_a + nearest.on_b) / 2.0,
        radius: (nearest.radius_a * nearest.radius_b).sqrt(),
    };
    Some((ball, cost))
}

/// Why two boxes of a class do not match.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mismatch {
    /// Their rays pass each other; not finite where they do not meet in front of both cameras.
    Rays {
        /// Distance of the rays, metres.
        gap_m: f64,
        /// Greatest distance of a match, metres.
        limit_m: f64,
    },
    /// They have different sizes at that place, or one that the class does not have.
    Sizes {
        /// Radius by the boxes, metres.
        radius_m: f64,
        /// Nearest radius that would match, metres.
        limit_m: f64,
    },
}

/// Why two boxes do not match; `None` where they do.
///
/// - `radii`: least and greatest half width of the class, metres
pub fn mismatch(
    config: &AssociationConfig,
    a: &LineOfSight,
    b: &LineOfSight,
    radii: [f64; 2],
) -> Option<Mismatch> {
    let Some(nearest) = Nearest::of(a, b) else {
        let (gap_m, limit_m) = (f64::INFINITY, 0.0);
        return Some(Mismatch::Rays { gap_m, limit_m });
    };
    let (gap_m, a, b) = (nearest.gap(), nearest.radius_a, nearest.radius_b);
    let [miss, size] = shares(config, gap_m, a, b);
    if miss > 1.0 {
        let limit_m = greatest_gap(config, a, b);
        return Some(Mismatch::Rays { gap_m, limit_m });
    }
    let factor = 1.0 + config.box_tolerance;
    if size > 1.0 {
        let (radius_m, limit_m) = (a.max(b), a.min(b) * factor.powi(2));
        return Some(Mismatch::Sizes { radius_m, limit_m });
    }
    let radius_m = (a * b).sqrt();
    let [least, greatest] = [radii[0] / factor, radii[1] * factor];
    let limit_m = radius_m.clamp(least, greatest.max(least));
    (!is_of_class(config, radius_m, radii)).then_some(Mismatch::Sizes { radius_m, limit_m })
}

/// 0 for a perfect match, 2 at both limits, `None` beyond either.
fn cost(config: &AssociationConfig, miss: f64, radius_a: f64, radius_b: f64) -> Option<f64> {
    let [miss, size] = shares(config, miss, radius_a, radius_b);
    (miss <= 1.0 && size <= 1.0).then_some(miss + size)
}

/// Distance of two rays and difference of two radii, each as a share of its limit.
fn shares(config: &AssociationConfig, miss: f64, radius_a: f64, radius_b: f64) -> [f64; 2] {
    [
        miss / greatest_gap(config, radius_a, radius_b),
        (radius_a / radius_b).ln().abs() / (2.0 * config.box_tolerance.ln_1p()),
    ]
}

/// Greatest distance of the rays of two boxes that match, metres; both boxes may be off.
fn greatest_gap(config: &AssociationConfig, radius_a: f64, radius_b: f64) -> f64 {
    (radius_a + radius_b) * config.box_tolerance
}

/// Whether a ball by boxes may be an object of a class.
///
/// - `least`, `greatest`: half width of the class, metres
fn is_of_class(config: &AssociationConfig, radius: f64, [least, greatest]: [f64; 2]) -> bool {
    let factor = 1.0 + config.box_tolerance;
    radius * factor >= least && radius <= greatest * factor
}

#[cfg(test)]
mod tests;
