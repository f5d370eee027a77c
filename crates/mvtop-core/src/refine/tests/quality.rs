//! How well images show an object at a pose.

use super::*;

#[test]
fn images_are_explained_best_by_the_right_one_of_several_poses() {
    let cameras = [0.0, 70.0].map(camera);
    let mut draw = Draw(7);
    for mesh in [ball(), cuboid()] {
        let refiner = Refiner::new(&mesh, 0.13);
        for _ in 0..8 {
            let pose = rotation(&mut draw, &cameras);
            let truth = Isometry3::from_parts(Translation3::identity(), pose);
            let images = cameras
                .each_ref()
                .map(|camera| seen(&mesh, camera, &truth, &mut draw));
            let views: Vec<View> = (cameras.iter().zip(&images))
                .map(|(camera, image)| View { camera, image })
                .collect();
            let right = refiner.quality(&views, &truth).unwrap().explained();
            // Of the ball, the turn that puts the red knob where the green one is; of the box, none
            // that makes it look the same.
            let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 90_f64.to_radians());
            for turn in [
                draw.rotation(0.5),
                draw.rotation(0.8),
                quarter,
                quarter.inverse(),
            ] {
                let wrong = Isometry3::from_parts(truth.translation, pose * turn);
                let wrong = refiner.quality(&views, &wrong).unwrap().explained();
                assert!(wrong < right - 0.02, "{wrong} against {right} by {turn}");
            }
        }
    }
}

#[test]
fn right_pose_explains_most_also_where_a_view_is_half_hidden() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0, 140.0].map(camera);
    let mut draw = Draw(3);
    for _ in 0..2 {
        let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
        let mut images = [0, 1, 2].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
        // No axis of the box, as turns about those by 180 degrees look the same.
        let axis = UnitQuaternion::from_scaled_axis(truth.rotation * Vector3::new(0.7, 0.7, 0.2));
        let axis = axis.axis().unwrap();
        for half_hidden in [false, true] {
            if half_hidden {
                for v in 0..SIDE {
                    for u in SIDE / 2..SIDE {
                        images[1].put_pixel(u, v, Rgb([60, 140, 70]));
                    }
                }
            }
            let views = views_of(&cameras, &images);
            let explained = |degrees: f64| {
                let turn = UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
                let pose = Isometry3::from_parts(truth.translation, turn * truth.rotation);
                refiner.quality(&views, &pose).unwrap().explained()
            };
            let right = explained(0.0);
            for off in [5.0, -5.0, 20.0, -20.0, 90.0, 180.0] {
                let wrong = explained(off);
                assert!(
                    right > wrong,
                    "{right} at the pose, {wrong} {off} degrees off"
                );
            }
        }
    }
}

#[test]
fn edges_are_seen_at_the_true_pose_where_the_image_has_them() {
    let (mesh, camera, mut draw) = (cuboid(), camera(70.0), Draw(4));
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
    let image = seen(&mesh, &camera, &truth, &mut draw);
    let (refiner, view) = (
        Refiner::new(&mesh, 0.13),
        View {
            camera: &camera,
            image: &image,
        },
    );
    let share = |pose: &Isometry3<f64>| {
        let edges = refiner.edges(&view, pose);
        assert!(edges.len() > 100, "{}", edges.len());
        // On the surface's edges: each lies on two faces of the box.
        for edge in &edges {
            let at = pose.inverse_transform_point(&edge.point);
            let half = [0.03, 0.04, 0.055];
            let near = (0..3).filter(|&i| (at[i].abs() - half[i]).abs() < 1e-6);
            assert!(near.count() >= 2, "{at}");
        }
        edges.iter().filter(|edge| edge.supported).count() as f64 / edges.len() as f64
    };
    let turned = truth * Isometry3::rotation(Vector3::new(0.0, 0.2, 0.0));
    // But for those next to background of the box's own color.
    let (here, there) = (share(&truth), share(&turned));
    assert!(here > 0.8 && there < here - 0.3, "{here}, {there}");
    // Beside what the camera sees.
    let beside = Isometry3::translation(0.0, 50.0, 0.0);
    assert!(refiner.edges(&view, &beside).is_empty());
}

#[test]
fn quality_says_which_view_does_not_show_the_object() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0, 140.0].map(camera);
    let mut draw = Draw(4);
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(1.0));
    let mut images = [0, 1, 2].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
    images[2] = background(&mut draw);
    let views = views_of(&cameras, &images);
    let quality = refiner.quality(&views, &truth).unwrap();
    let [first, second, hidden] = quality.views[..] else {
        panic!("{quality:?}")
    };
    assert_eq!(quality.worst().unwrap().view, 2);
    for shown in [first, second] {
        // Not all of it: some creases lie between faces of like brightness.
        assert!(shown.supported > 0.5 && shown.supported > hidden.supported + 0.3);
        assert!(shown.residual_px < 0.7 && shown.residual_px < hidden.residual_px / 2.0);
        assert!(shown.overlap > 0.7 && shown.overlap > hidden.overlap + 0.2);
    }
    let mean = (first.supported + second.supported + hidden.supported) / 3.0;
    assert!((quality.supported() - mean).abs() < 1e-12);
    assert_eq!(Quality::default().explained(), 0.0);
}

#[test]
fn a_camera_that_sees_the_knobs_tells_turns_apart_and_one_that_sees_nothing_does_not() {
    let refiner = Refiner::new(&ball(), 0.1);
    let pose = Isometry3::identity();
    let turned = |angle: f64| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle.to_radians());
        Isometry3::from_parts(Translation3::identity(), turn)
    };
    let camera = camera(0.0);
    let differ = |degrees: f64| refiner.difference(&camera, &pose, &turned(degrees));
    assert_eq!(differ(0.0), 0.0);
    assert!(
        differ(20.0) > differ(5.0) && differ(5.0) > 0.0,
        "{}",
        differ(5.0)
    );
    assert!(differ(20.0) <= 1.0);
    let away = camera.world_from_cam() * Isometry3::rotation(Vector3::y() * 2.0);
    let size = [camera.width(), camera.height()];
    let away = Camera::new("away", size, camera.intrinsics().clone(), away).unwrap();
    assert_eq!(refiner.difference(&away, &pose, &turned(20.0)), 0.0);
}
