use super::*;
use crate::{Intrinsics, Projection};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use proptest::prelude::*;
use std::f64::consts::FRAC_PI_2;

const RADIUS: f64 = 0.07;

/// Objects of any size.
fn associate(views: &[Vec<LineOfSight>]) -> Vec<Vec<Option<usize>>> {
    of_sizes(views, &[[0.0, f64::INFINITY]; 2])
}

fn of_sizes(views: &[Vec<LineOfSight>], radii: &[[f64; 2]]) -> Vec<Vec<Option<usize>>> {
    super::associate(&AssociationConfig::default(), views, radii)
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

/// Two balls in one plane with two cameras, so that the wrong pairs cross too, and a third camera. The
/// boxes' sizes are off by what makes the wrong pairs fit better.
fn crossed() -> Vec<Vec<LineOfSight>> {
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
    views
}

#[test]
fn third_view_settles_which_of_two_crossings_is_real() {
    let views = crossed();
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
fn matches_are_all_that_lines_of_sight_allow_the_best_first() {
    let all = |views: &[Vec<LineOfSight>]| {
        matches(
            &AssociationConfig::default(),
            views,
            &[[0.0, f64::INFINITY]; 2],
        )
    };
    let mut by_two = all(&crossed()[..2]);
    by_two[..2].sort();
    by_two[2..].sort();
    let wrong = [[Some(0), Some(1)], [Some(1), Some(0)]];
    assert_eq!(by_two, [wrong, [[Some(0); 2], [Some(1); 2]]].concat());
    // Each once, although three pairs of boxes propose it.
    let by_three = all(&crossed());
    assert_eq!(
        by_three.iter().filter(|one| **one == [Some(0); 3]).count(),
        1
    );
    assert!(all(&crossed()[..1]).is_empty());
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
fn cameras_that_face_each_other_see_one_object_between_them() {
    let (near, far) = ([0.0, 0.0, 0.0], [0.0, 0.0, 1.2]);
    for depth in [0.4, 0.6, 0.8] {
        for aside in [0.0, 0.003, 0.02, 0.1] {
            // Boxes are not exact to 3 mm.
            let a = sight(near, [aside, 0.0, depth]);
            let mut b = sight(far, [aside - 0.002, 0.002, depth]);
            b.sin_radius *= 1.05;
            let (ball, _) = meet(&AssociationConfig::default(), &a, &b).unwrap();
            let off = (ball.center - Vector3::new(aside, 0.0, depth)).norm();
            assert!(off < 0.05, "{off} m");
            assert_eq!(associate(&[vec![a], vec![b]]), [[Some(0), Some(0)]]);
        }
    }
    // Back to back, each sees its own.
    let views = [
        vec![sight(near, [0.0, 0.0, -0.6])],
        vec![sight(far, [0.0, 0.0, 1.8])],
    ];
    assert_eq!(associate(&views).len(), 2);
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
        assert_eq!(of_sizes(&views, &[radii]).len(), objects, "{radii:?}");
    }
    assert_eq!(of_sizes(&views, &[]).len(), 3, "no such class");
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
fn box_gives_its_line_of_sight_in_the_world() {
    // A pinhole at (1, 2, 3) that looks along the world's x; the box spans 30 px to each side.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2);
    let intrinsics = Intrinsics::new(40.0, 40.0, 50.0, 50.0, Projection::Pinhole).unwrap();
    let world_from_cam = Isometry3::from_parts(Translation3::new(1.0, 2.0, 3.0), turn);
    let camera = Camera::new("left", [101, 101], intrinsics, world_from_cam).unwrap();
    let bbox = BBox::from([20.0, 20.0, 80.0, 80.0]);
    let sight = LineOfSight::new(4, &camera, bbox).unwrap();
    assert_eq!(sight.class, 4);
    assert_eq!(sight.origin, Vector3::new(1.0, 2.0, 3.0));
    assert!((sight.direction - Vector3::x()).norm() < 1e-15);
    // 30 px at 40 px: a triangle with the sides 3, 4 and 5.
    assert!((sight.sin_radius - 0.6).abs() < 1e-15);
    assert_eq!(LineOfSight::new(4, &camera, [f64::NAN; 4].into()), None);
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

#[test]
fn why_boxes_do_not_match_is_told() {
    let config = AssociationConfig {
        box_tolerance: 0.25,
    };
    // Along z and along -x, nearest to each other at z = 1: 0.1 m apart in y.
    let a = LineOfSight {
        class: 0,
        origin: Vector3::zeros(),
        direction: Vector3::z(),
        sin_radius: 0.1,
    };
    let b = |y: f64, sin_radius: f64| LineOfSight {
        class: 0,
        origin: Vector3::new(1.0, y, 1.0),
        direction: -Vector3::x(),
        sin_radius,
    };
    let told = |b: LineOfSight, radii| mismatch(&config, &a, &b, radii);
    let any = [0.0, 1.0];
    assert_eq!(told(b(0.0, 0.1), any), None);
    // Radii of 0.1 m each: a quarter of their sum is allowed.
    let Some(Mismatch::Rays { gap_m, limit_m }) = told(b(0.1, 0.1), any) else {
        panic!("they are apart");
    };
    assert!((gap_m - 0.1).abs() < 1e-12 && (limit_m - 0.05).abs() < 1e-12);
    // Twice as large: 1.25 squared times is allowed.
    let Some(Mismatch::Sizes { radius_m, limit_m }) = told(b(0.0, 0.2), any) else {
        panic!("sizes differ");
    };
    assert!((radius_m - 0.2).abs() < 1e-12 && (limit_m - 0.15625).abs() < 1e-12);
    // A class of 0.2 to 0.3 m of radius: at least 0.2 / 1.25 by the boxes.
    let Some(Mismatch::Sizes { radius_m, limit_m }) = told(b(0.0, 0.1), [0.2, 0.3]) else {
        panic!("too small");
    };
    assert!((radius_m - 0.1).abs() < 1e-12 && (limit_m - 0.16).abs() < 1e-12);
    // Behind the second camera.
    let away = LineOfSight {
        direction: Vector3::x(),
        ..b(0.0, 0.1)
    };
    assert!(matches!(told(away, any), Some(Mismatch::Rays { gap_m, .. }) if gap_m.is_infinite()));
    // What matches is what is associated.
    for (b, radii) in [
        (b(0.0, 0.1), any),
        (b(0.1, 0.1), any),
        (b(0.0, 0.2), any),
        (b(0.0, 0.1), [0.2, 0.3]),
        (b(0.0, 0.15), [0.14, 0.3]),
    ] {
        let together = of_sizes(&[vec![a], vec![b]], &[radii]).len() == 1;
        assert_eq!(together, told(b, radii).is_none());
    }
}
