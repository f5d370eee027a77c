//! Views of a wrong calibration contradict each other.

use super::*;
use crate::bundle::SurfacePoint;
use crate::consistency::alone::{Alone, Difference, Kind, differences};
use crate::consistency::{Sight, extent};

/// Differences between the single-view poses of a box at the origin, near its true pose.
///
/// - `claimed`: the claimed camera pose, by index and true camera
fn apart(claimed_of: impl Fn(usize, &Camera) -> Isometry3<f64>) -> Vec<Difference> {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.15);
    let corner = |v: &Point3<f64>| SurfacePoint {
        position: v.coords.into(),
        color: [0; 3],
    };
    let points: Vec<SurfacePoint> = mesh.vertices().iter().map(corner).collect();
    let mut draw = Draw(3);
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(1.0));
    let alone = [0.0, 70.0, 140.0].map(camera).into_iter().enumerate();
    let alone = alone.map(|(index, true_camera)| {
        let image = seen(&mesh, &true_camera, &truth, &mut draw);
        let bbox = extent(&points, &true_camera, &truth).unwrap();
        let (size, pinhole) = ([SIDE; 2], true_camera.intrinsics().clone());
        let claimed = claimed_of(index, &true_camera);
        let camera = &Camera::new(true_camera.id(), size, pinhole, claimed).unwrap();
        let view = View {
            camera,
            image: &Pyramid::new(&image),
        };
        Alone::of(
            &crate::config::RigConfig::default(),
            &refiner,
            &view,
            &Sight { camera, bbox },
            &points,
            &truth,
        )
        .unwrap()
    });
    let alone: Vec<Alone> = alone.collect();
    differences(&refiner, &alone, &truth).unwrap()
}

/// The third camera in another place in its own frame.
fn last(cam_from_new: Isometry3<f64>) -> impl Fn(usize, &Camera) -> Isometry3<f64> {
    move |index, camera| match index {
        2 => camera.world_from_cam() * cam_from_new,
        _ => *camera.world_from_cam(),
    }
}

fn worst(apart: &[Difference]) -> (usize, Difference) {
    let all = apart.iter().copied().enumerate();
    all.max_by(|a, b| a.1.deviation.total_cmp(&b.1.deviation))
        .unwrap()
}

#[test]
fn views_of_a_true_calibration_tell_one_pose() {
    for one in apart(|_, camera| *camera.world_from_cam()) {
        assert!(one.deviation < 1.5, "{one:?}");
        assert!(one.across < 0.001 && one.along < 0.006, "{one:?}");
        assert!((one.distance - 0.6).abs() < 0.01, "{one:?}");
    }
}

#[test]
fn camera_that_is_turned_misses_the_others() {
    // 1 degree is 10.5 mm at 0.6 m; two views against one: they agree nearer to the two.
    let turn = Isometry3::new(Vector3::zeros(), Vector3::x() * 1f64.to_radians());
    let (view, one) = worst(&apart(last(turn)));
    assert_eq!((view, one.mostly), (2, Kind::Across));
    assert!(one.deviation > 5.0, "{one:?}");
    assert!((0.0105 / 2.0..0.0105).contains(&one.across), "{one:?}");
}

#[test]
fn camera_that_is_rolled_sees_it_turned() {
    let roll = Isometry3::new(Vector3::zeros(), Vector3::z() * 8f64.to_radians());
    let (view, one) = worst(&apart(last(roll)));
    assert_eq!((view, one.mostly), (2, Kind::Turn));
    assert!(one.deviation > 2.0, "{one:?}");
    assert!((4.0..8.5).contains(&one.turn.to_degrees()), "{one:?}");
}

#[test]
fn camera_that_is_farther_away_sees_it_too_large() {
    // 24 mm of 0.6 m: 4 %.
    let (view, one) = worst(&apart(last(Isometry3::translation(0.0, 0.0, -0.024))));
    assert_eq!((view, one.mostly), (2, Kind::Along));
    assert!(one.deviation > 2.5, "{one:?}");
    assert!((0.012..0.03).contains(&one.along), "{one:?}");
}

#[test]
fn one_view_contradicts_nothing() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.15);
    assert!(differences(&refiner, &[], &Isometry3::identity()).is_none());
}
