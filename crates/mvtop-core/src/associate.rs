//! Which boxes of different views show the same object, told by their lines of sight.
//!
//! No appearance is compared: identical objects look alike, but only one place lies on the lines
//! of sight of all the boxes that show one object.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use nalgebra::Vector3;

/// Lines of sight of one object may miss each other by this share of its apparent radius.
const MAX_MISS: f64 = 0.5;

/// Apparent radii of one object may differ by this factor between views.
const MAX_SIZE_RATIO: f64 = 1.6;

/// The radius that two boxes agree on may be out of the object's range by this factor.
const SIZE_TOLERANCE: f64 = 1.25;

/// The line of sight through a box's center and how large the box appears.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineOfSight {
    /// Index into the bundle's classes; only equal classes match.
    pub class: usize,
    /// Camera center, metres, in one frame common to all views.
    pub origin: Vector3<f64>,
    /// Unit vector in that frame.
    pub direction: Vector3<f64>,
    /// Sine of half the angle under which the box appears: a ball at distance `z` that fills the
    /// box has the radius `z * sin_radius`.
    pub sin_radius: f64,
}

impl LineOfSight {
    /// From the twelve numbers of [`crate::rays::box_rays`]: `[o, d_c, 10 e_x, 10 e_y]`.
    pub fn from_box_rays(class: usize, rays: &[f32; 12]) -> Self {
        let vector = |i: usize| Vector3::from_fn(|row, _| f64::from(rays[3 * i + row]));
        Self {
            class,
            origin: vector(0),
            direction: vector(1),
            sin_radius: (vector(2).norm() / 10.0 * vector(3).norm() / 10.0).sqrt(),
        }
    }
}

/// Groups the boxes of all views into objects.
///
/// Two boxes of a class match where their lines of sight meet in front of both cameras, nearer
/// than half the apparent radius, the apparent radii there differ by a factor of at most 1.6, and
/// their mean is a size that an object of the class can have: things that only look alike, or boxes
/// of two different things, seldom have it. Each matching pair proposes a place, and every other view adds the box that fits it best. Places
/// that more views agree on go first, then those that fit better: so a third view settles which of
/// two crossings in the first two is real. A box in no match is an object seen by one view.
///
/// - `views`: lines of sight of the boxes of each view, `[V][boxes]`
/// - `radii`: least and greatest half width of each class, metres, see
///   [`crate::bundle::Class::half_widths`]
/// - returns: for each object, the index of its box in each view, `[objects][V]`; every box is
///   in exactly one object
pub fn associate(views: &[Vec<LineOfSight>], radii: &[[f64; 2]]) -> Vec<Vec<Option<usize>>> {
    let mut free: Vec<Vec<bool>> = views.iter().map(|boxes| vec![true; boxes.len()]).collect();
    let mut queue: BinaryHeap<Proposal> = pairs(views)
        .into_iter()
        .filter_map(|seed| Proposal::grow(seed, views, radii, &free))
        .collect();

    let mut objects = Vec::new();
    while let Some(best) = queue.pop() {
        if best.boxes().any(|(view, index)| !free[view][index]) {
            // Some of its boxes went to a better object: try again with those that are left.
            queue.extend(Proposal::grow(best.seed, views, radii, &free));
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
        seed: Pair,
        views: &[Vec<LineOfSight>],
        radii: &[[f64; 2]],
        free: &[Vec<bool>],
    ) -> Option<Self> {
        let [(first, i), (second, j)] = seed;
        if !free[first][i] || !free[second][j] {
            return None;
        }
        let (ball, mut cost) = meet(&views[first][i], &views[second][j])?;
        let [least, greatest] = *radii.get(ball.class)?;
        if ball.radius * SIZE_TOLERANCE < least || ball.radius > greatest * SIZE_TOLERANCE {
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
                .filter_map(|index| Some((index, ball.fit(&boxes[index])?)))
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
    fn fit(&self, sight: &LineOfSight) -> Option<f64> {
        let to_center = self.center - sight.origin;
        let depth = to_center.dot(&sight.direction);
        if sight.class != self.class || depth <= 0.0 {
            return None;
        }
        let miss = (to_center - depth * sight.direction).norm();
        cost(miss, self.radius, depth * sight.sin_radius)
    }
}

/// The ball that two boxes agree on and the cost of the match.
fn meet(a: &LineOfSight, b: &LineOfSight) -> Option<(Ball, f64)> {
    if a.class != b.class {
        return None;
    }
    // Nearest points a.origin + s * a.direction and b.origin + t * b.direction.
    let baseline = b.origin - a.origin;
    let cosine = a.direction.dot(&b.direction);
    let sine_squared = a.direction.cross(&b.direction).norm_squared();
    let (along_a, along_b) = (baseline.dot(&a.direction), baseline.dot(&b.direction));
    let s = (along_a - cosine * along_b) / sine_squared;
    let t = (cosine * along_a - along_b) / sine_squared;
    // Parallel lines meet nowhere: s and t are then not finite.
    if !(s > 0.0 && t > 0.0 && s.is_finite() && t.is_finite()) {
        return None;
    }
    let (on_a, on_b) = (a.origin + s * a.direction, b.origin + t * b.direction);
    let (radius_a, radius_b) = (s * a.sin_radius, t * b.sin_radius);
    let cost = cost((on_a - on_b).norm(), radius_a, radius_b)?;
    let ball = Ball {
        class: a.class,
        center: (on_a + on_b) / 2.0,
        radius: (radius_a * radius_b).sqrt(),
    };
    Some((ball, cost))
}

/// 0 for a perfect match, 2 at both limits, `None` beyond either.
fn cost(miss: f64, radius_a: f64, radius_b: f64) -> Option<f64> {
    let miss = miss / ((radius_a + radius_b) / 2.0 * MAX_MISS);
    let size = (radius_a / radius_b).ln().abs() / MAX_SIZE_RATIO.ln();
    (miss <= 1.0 && size <= 1.0).then_some(miss + size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RADIUS: f64 = 0.07;

    /// Objects of any size.
    fn associate(views: &[Vec<LineOfSight>]) -> Vec<Vec<Option<usize>>> {
        super::associate(views, &[[0.0, f64::INFINITY]; 2])
    }

    fn sight(camera: [f64; 3], ball: [f64; 3]) -> LineOfSight {
        let origin = Vector3::from(camera);
        let to_ball = Vector3::from(ball) - origin;
        LineOfSight {
            class: 0,
            origin,
            direction: to_ball.normalize(),
            sin_radius: RADIUS / to_ball.norm(),
        }
    }

    const CAMERAS: [[f64; 3]; 3] = [[-0.5, 0.0, 0.0], [0.5, 0.1, 0.0], [0.0, -0.6, 0.2]];
    const LEFT: [f64; 3] = [-0.2, 0.05, 1.5];
    const RIGHT: [f64; 3] = [0.2, 0.0, 1.6];

    #[test]
    fn two_identical_objects_are_told_apart_in_three_views() {
        let views = [
            vec![sight(CAMERAS[0], LEFT), sight(CAMERAS[0], RIGHT)],
            vec![sight(CAMERAS[1], RIGHT), sight(CAMERAS[1], LEFT)],
            vec![sight(CAMERAS[2], LEFT), sight(CAMERAS[2], RIGHT)],
        ];
        let mut objects = associate(&views);
        objects.sort();
        assert_eq!(
            objects,
            [
                [Some(0), Some(1), Some(0)].to_vec(),
                [Some(1), Some(0), Some(1)].to_vec()
            ]
        );
    }

    #[test]
    fn object_missed_in_the_reference_is_found_by_the_other_views() {
        let views = [
            vec![],
            vec![sight(CAMERAS[1], RIGHT)],
            vec![sight(CAMERAS[2], RIGHT)],
        ];
        assert_eq!(associate(&views), [vec![None, Some(0), Some(0)]]);
    }

    #[test]
    fn in_a_single_view_every_box_is_an_object() {
        let views = [vec![sight(CAMERAS[0], LEFT), sight(CAMERAS[0], RIGHT)]];
        assert_eq!(associate(&views), [[Some(0)], [Some(1)]]);
        assert!(associate(&[]).is_empty());
        assert!(associate(&[vec![], vec![]]).is_empty());
    }

    #[test]
    fn object_hidden_from_all_views_but_one_stands_alone() {
        let views = [
            vec![sight(CAMERAS[0], LEFT), sight(CAMERAS[0], RIGHT)],
            vec![sight(CAMERAS[1], LEFT)],
            vec![sight(CAMERAS[2], LEFT)],
        ];
        let objects = associate(&views);
        assert_eq!(
            objects,
            [[Some(0), Some(0), Some(0)], [Some(1), None, None]]
        );
    }

    #[test]
    fn third_view_settles_which_of_two_crossings_is_real() {
        // Both balls lie in one plane with both cameras, so in two views the wrong pairs cross
        // too; the boxes' sizes are off by what makes the wrong pairs fit better there.
        let cameras = [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.5, 0.0]];
        let (near, far) = ([0.0, 0.0, 2.8], [0.0, 0.0, 3.2]);
        let mut views: Vec<Vec<LineOfSight>> = cameras
            .map(|camera| vec![sight(camera, near), sight(camera, far)])
            .to_vec();
        for view in &mut views[..2] {
            view[0].sin_radius *= 0.9;
            view[1].sin_radius *= 1.1;
        }
        views[1][0].sin_radius /= 0.9 * 0.9;
        views[1][1].sin_radius /= 1.1 * 1.1;

        let mut by_two = associate(&views[..2]);
        by_two.sort();
        assert_eq!(
            by_two,
            [[Some(0), Some(1)], [Some(1), Some(0)]],
            "the trap is set"
        );
        let mut by_three = associate(&views);
        by_three.sort();
        assert_eq!(by_three, [[Some(0); 3], [Some(1); 3]]);
    }

    #[test]
    fn lines_that_meet_behind_a_camera_or_at_different_sizes_do_not_match() {
        let first = sight(CAMERAS[0], LEFT);
        let second = sight(CAMERAS[1], LEFT);
        assert_eq!(associate(&[vec![first], vec![second]]).len(), 1);

        let backwards = LineOfSight {
            direction: -second.direction,
            ..second
        };
        assert_eq!(associate(&[vec![first], vec![backwards]]).len(), 2);
        for (factor, objects) in [(1.5, 1), (1.7, 2), (1.0 / 1.5, 1), (1.0 / 1.7, 2)] {
            let resized = LineOfSight {
                sin_radius: second.sin_radius * factor,
                ..second
            };
            assert_eq!(
                associate(&[vec![first], vec![resized]]).len(),
                objects,
                "{factor}"
            );
        }
        let other_class = LineOfSight { class: 1, ..second };
        assert_eq!(associate(&[vec![first], vec![other_class]]).len(), 2);
        let parallel = LineOfSight {
            direction: first.direction,
            ..second
        };
        assert_eq!(associate(&[vec![first], vec![parallel]]).len(), 2);
    }

    #[test]
    fn boxes_that_agree_on_a_size_the_object_cannot_have_do_not_match() {
        let views = CAMERAS.map(|camera| vec![sight(camera, LEFT)]);
        // RADIUS is 0.07; a quarter more or less is let through.
        for (radii, objects) in [
            ([0.07, 0.07], 1),
            ([0.08, 0.2], 1),
            ([0.09, 0.2], 3),
            ([0.01, 0.06], 1),
            ([0.01, 0.05], 3),
        ] {
            assert_eq!(
                super::associate(&views, &[radii]).len(),
                objects,
                "{radii:?}"
            );
        }
        assert_eq!(super::associate(&views, &[]).len(), 3, "no such class");
    }

    #[test]
    fn lines_may_miss_each_other_by_half_the_radius() {
        let first = sight([-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
        for (share, objects) in [(0.45, 1), (0.55, 2)] {
            let mut second = sight([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
            second.origin.y += share * RADIUS; // across both lines
            assert_eq!(
                associate(&[vec![first], vec![second]]).len(),
                objects,
                "{share}"
            );
        }
    }

    #[test]
    fn box_rays_give_the_line_of_sight() {
        // A ball of radius 0.3 at 1 m, seen along z from (1, 2, 3): the half extents have length 0.3.
        let rays = [1., 2., 3., 0., 0., 1., 3., 0., 0., 0., 3., 0.];
        let sight = LineOfSight::from_box_rays(4, &rays);
        assert_eq!(sight.class, 4);
        assert_eq!(sight.origin, Vector3::new(1., 2., 3.));
        assert_eq!(sight.direction, Vector3::z());
        assert!((sight.sin_radius - 0.3).abs() < 1e-12);
    }

    fn any_sight() -> impl Strategy<Value = LineOfSight> {
        let number = prop_oneof![20 => -2.0..2.0, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)];
        (0..2usize, proptest::array::uniform7(number)).prop_map(|(class, n)| LineOfSight {
            class,
            origin: Vector3::new(n[0], n[1], n[2]),
            direction: Vector3::new(n[3], n[4], 1.0).normalize(),
            sin_radius: n[6],
        })
    }

    proptest! {
        #[test]
        fn every_box_is_in_exactly_one_object_of_one_class(
            views in prop::collection::vec(prop::collection::vec(any_sight(), 0..5), 0..5),
        ) {
            let objects = associate(&views);
            let mut seen = Vec::new();
            for object in &objects {
                prop_assert_eq!(object.len(), views.len());
                let members: Vec<_> = object
                    .iter()
                    .enumerate()
                    .filter_map(|(view, index)| Some((view, (*index)?)))
                    .collect();
                prop_assert!(!members.is_empty());
                let class = |&(view, index): &(usize, usize)| views[view][index].class;
                prop_assert!(members.iter().all(|member| class(member) == class(&members[0])));
                seen.extend(members);
            }
            seen.sort();
            let all: Vec<_> = (0..views.len())
                .flat_map(|view| (0..views[view].len()).map(move |index| (view, index)))
                .collect();
            prop_assert_eq!(seen, all);
        }

        #[test]
        fn order_of_the_views_does_not_matter(
            balls in prop::collection::vec(
                proptest::array::uniform3(-0.5..0.5).prop_map(|p| [p[0], p[1], p[2] + 2.0]), 1..4),
            shift in 1..3usize,
        ) {
            let views: Vec<Vec<_>> =
                CAMERAS.iter().map(|&c| balls.iter().map(|&b| sight(c, b)).collect()).collect();
            let mut rotated = views.clone();
            rotated.rotate_left(shift);
            let mut expected = associate(&views);
            for object in &mut expected {
                object.rotate_left(shift);
            }
            expected.sort();
            let mut objects = associate(&rotated);
            objects.sort();
            prop_assert_eq!(objects, expected);
        }
    }
}
