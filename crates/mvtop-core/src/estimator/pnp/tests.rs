use super::*;
use crate::symmetry::{self, Symmetry};
use crate::{Camera, Intrinsics, Projection};
use nalgebra::{Translation3, Unit};
use std::f64::consts::{PI, TAU};

const DIAMETER: f64 = 0.2;

/// Numbers from 0 to 1 that look random, the same in every run.
fn noise(n: usize) -> f64 {
    ((n as f64 + 1.0) * 12.9898)
        .sin()
        .abs()
        .mul_add(43_758.545_3, 0.0)
        .fract()
}

fn random_place(n: usize) -> Point3<f64> {
    let [x, y, z] = [0, 1, 2].map(|axis| noise(3 * n + axis) - 0.5);
    Point3::new(0.15 * x, 0.10 * y, 0.06 * z)
}

fn pose() -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -1.9, 0.8));
    Isometry3::from_parts(Translation3::new(0.05, -0.1, 0.9), rotation)
}

const LEFT: [f64; 3] = [-0.3, 0.0, 0.0];
const RIGHT: [f64; 3] = [0.4, 0.1, 0.1];

/// What cameras at `origins` see of the object.
///
/// - `wrong`: share of the correspondences that are any
/// - `blur`: how far off the other points are at most, metres
fn seen_from(origins: &[[f64; 3]], wrong: f64, blur: f64) -> Correspondences {
    seen_after(&Symmetry::default(), origins, wrong, blur)
}

/// Likewise, of an object with symmetries.
fn seen_after(symmetry: &Symmetry, origins: &[[f64; 3]], wrong: f64, blur: f64) -> Correspondences {
    // The cameras look at the object.
    let camera = |(view, origin): (usize, &[f64; 3])| {
        let to = Point3::from(pose().translation.vector);
        let view_from_world = Isometry3::look_at_rh(&Point3::from(*origin), &to, &Vector3::y());
        let pinhole = Intrinsics::new(100.0, 100.0, 49.5, 49.5, Projection::Pinhole).unwrap();
        let camera = Camera::new("any", [100; 2], pinhole, view_from_world.inverse()).unwrap();
        (view, camera)
    };
    let mut all = Correspondences {
        list: Vec::new(),
        crops: origins.iter().enumerate().map(camera).collect(),
        columns: 20,
        symmetry: symmetry.clone(),
        diameter: DIAMETER,
    };
    let equivalents = all.equivalents(&pose());
    let cells = (0..300).flat_map(|n| origins.iter().enumerate().map(move |o| (n, o)));
    all.list = cells
        .map(|(n, (crop, &origin))| {
            let (origin, seed) = (Point3::from(origin), 1000 * crop + n);
            let point = random_place(seed);
            let offset = pose() * point - origin;
            let off = Vector3::from_fn(|axis, _| noise(7 * seed + axis) - 0.5) * (2.0 * blur);
            let told = match noise(seed + 50_000) < wrong {
                true => random_place(seed + 9000),
                false => point + off,
            };
            let equivalent = equivalents.get(crop).copied().unwrap_or_default();
            Correspondence {
                crop,
                cell: n,
                point: equivalent.inverse() * told,
                origin,
                direction: offset.normalize(),
                distance: 0.0,
                weight: 1.0,
            }
        })
        .collect();
    all
}

/// The most probable pose.
fn fit(all: &mut Correspondences) -> Option<Hypothesis> {
    let found = solve(&InferenceConfig::default(), all);
    found.into_iter().next()
}

fn off(found: &Hypothesis) -> (f64, f64) {
    let (pose, found) = (pose(), &found.world_from_obj);
    let turned = pose.rotation.angle_to(&found.rotation).to_degrees();
    let moved = (pose.translation.vector - found.translation.vector).norm();
    (turned, moved)
}

#[test]
fn places_without_error_give_the_pose_from_one_view_and_from_two() {
    for origins in [&[LEFT][..], &[LEFT, RIGHT]] {
        let found = fit(&mut seen_from(origins, 0.0, 0.0)).unwrap();
        let (turned, moved) = off(&found);
        assert!(turned < 1e-4 && moved < 1e-6, "{turned} degrees, {moved} m");
        assert!(found.sigma.rot_deg < 1e-3);
    }
}

#[test]
fn half_of_the_cells_may_be_wrong() {
    let found = fit(&mut seen_from(&[LEFT, RIGHT], 0.5, 0.008)).unwrap();
    let (turned, moved) = off(&found);
    assert!(turned < 2.0 && moved < 0.002, "{turned} degrees, {moved} m");
}

#[test]
fn views_tell_the_distance_and_expect_less_of_an_error() {
    let one = fit(&mut seen_from(&[LEFT], 0.2, 0.01)).unwrap();
    let two = fit(&mut seen_from(&[LEFT, RIGHT], 0.2, 0.01)).unwrap();
    assert!(two.sigma.rot_deg < one.sigma.rot_deg);
    assert!(
        two.sigma.t_m < 0.5 * one.sigma.t_m,
        "{:?} {:?}",
        two.sigma,
        one.sigma
    );
    assert!(off(&two).1 < off(&one).1);
}

/// A nut's turns by sixths and upside down, about an axis beside the origin.
fn nut() -> Symmetry {
    let center = Translation3::new(0.01, -0.02, 0.0);
    let about = |axis: Vector3<f64>, angle: f64| {
        center * UnitQuaternion::from_scaled_axis(axis * angle) * center.inverse()
    };
    let sixths = (0..6).map(|n| about(Vector3::z(), f64::from(n) * TAU / 6.0));
    let both = sixths.flat_map(|turn| [turn, turn * about(Vector3::x(), PI)]);
    Symmetry {
        discrete: both.skip(1).collect(),
        axis: None,
    }
}

#[test]
fn each_view_may_mean_another_of_the_poses_that_look_alike() {
    let direction = Unit::new_normalize(Vector3::new(0.2, 0.1, 1.0));
    let shaft = Symmetry {
        discrete: Vec::new(),
        axis: Some(symmetry::Axis {
            direction,
            point: Point3::new(0.01, 0.0, 0.0),
        }),
    };
    let origins = [LEFT, RIGHT, [0.1, 1.3, 0.8]];
    for symmetry in [nut(), shaft] {
        let mut evidence = seen_after(&symmetry, &origins, 0.3, 0.005);
        let turns = evidence.equivalents(&pose());
        assert!(
            turns
                .iter()
                .any(|turn| turn.rotation.angle_to(&turns[0].rotation) > 0.5),
            "or it would not be tested"
        );
        let found = fit(&mut evidence).unwrap().world_from_obj;
        let alike = symmetry.nearest(&pose(), &found, DIAMETER);
        let turned = alike.rotation.angle_to(&found.rotation).to_degrees();
        let moved = (alike.translation.vector - found.translation.vector).norm();
        assert!(turned < 2.0 && moved < 0.002, "{turned} degrees, {moved} m");
        let given = symmetry.canonical(&found);
        assert!(
            given.rotation.angle_to(&found.rotation) < 1e-6,
            "always the same one"
        );
    }
}

#[test]
fn one_view_tells_the_distance_by_the_size() {
    let found = fit(&mut seen_from(&[LEFT], 0.1, 0.003)).unwrap();
    let (turned, moved) = off(&found);
    assert!(turned < 2.0 && moved < 0.01, "{turned} degrees, {moved} m");
}

#[test]
fn cameras_tell_where_it_is_however_near_they_stand() {
    let beside = |baseline: f64| [LEFT[0] + baseline, LEFT[1], LEFT[2]];
    let facing = [2.0 * pose().translation.x - LEFT[0], -0.2, 1.8];
    for other in [beside(0.001), beside(0.02), beside(0.1), RIGHT, facing] {
        let mut evidence = seen_from(&[LEFT, other], 0.1, 0.003);
        let position = position(&PnpConfig::default(), &evidence).unwrap();
        let off = (position - pose().translation.vector).norm();
        assert!(off < 0.12, "{other:?}: {off} m");
        let (turned, moved) = self::off(&fit(&mut evidence).unwrap());
        assert!(
            turned < 2.0 && moved < 0.01,
            "{other:?}: {turned} degrees, {moved} m"
        );
    }
}

#[test]
fn what_cannot_be_is_not_settled() {
    // Places of a whole object, all in one direction: it would be infinitely far away.
    let mut evidence = seen_from(&[LEFT], 0.0, 0.0);
    for one in &mut evidence.list {
        one.direction = Vector3::new(1e-9 * one.point.x, 1e-9 * one.point.y, 1.0).normalize();
    }
    assert!(fit(&mut evidence).is_none());
}

#[test]
fn few_cells_settle_nothing() {
    let fewest = PnpConfig::default().min_correspondences;
    let mut evidence = seen_from(&[LEFT], 0.0, 0.0);
    evidence.list.truncate(fewest);
    assert!(fit(&mut evidence.clone()).is_some());
    evidence.list.truncate(fewest - 1);
    assert!(fit(&mut evidence).is_none());
}

#[test]
fn starts_lie_around_every_rotation() {
    let count = PnpConfig::default().starts;
    let starts: Vec<_> = (0..count).map(|n| spread_rotation(n, count)).collect();
    for n in 0..500 {
        let any = [0, 1, 2, 3].map(|i| noise(4 * n + i) - 0.5);
        let any = UnitQuaternion::from_quaternion(Quaternion::from(any));
        let angles = starts.iter().map(|start| start.angle_to(&any).to_degrees());
        assert!(angles.fold(f64::INFINITY, f64::min) < 62.0);
    }
}

#[test]
fn without_the_decoder_s_pose_the_search_finds_it_all_the_same() {
    for (wrong, blur) in [(0.0, 0.0), (0.4, 0.006)] {
        let mut all = seen_from(&[LEFT, RIGHT], wrong, blur);
        let found = solve(&InferenceConfig::default(), &mut all);
        let (turned, moved) = off(&found[0]);
        assert!(turned < 2.0 && moved < 0.002, "{turned} degrees, {moved} m");
        assert!(found.is_sorted_by(|a, b| a.probability >= b.probability));
    }
}
