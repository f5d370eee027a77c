//! Evidence for a pose.

use super::*;

#[test]
fn mutual_information_is_largest_at_the_correct_pose() {
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
            let pyramids = images.each_ref().map(Pyramid::new);
            let views = views_of(&cameras, &pyramids);
            let right = refiner
                .quality(&views, &truth)
                .unwrap()
                .mutual_information();
            // The quarter turn puts the ball's red knob in place of the green one. No turn is a symmetry
            // of the box.
            let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 90_f64.to_radians());
            for turn in [
                draw.rotation(0.5),
                draw.rotation(0.8),
                quarter,
                quarter.inverse(),
            ] {
                let wrong = Isometry3::from_parts(truth.translation, pose * turn);
                let wrong = refiner
                    .quality(&views, &wrong)
                    .unwrap()
                    .mutual_information();
                assert!(wrong < right - 0.02, "{wrong} against {right} by {turn}");
            }
        }
    }
}

#[test]
fn mutual_information_is_largest_also_under_occlusion() {
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
            let pyramids = images.each_ref().map(Pyramid::new);
            let views = views_of(&cameras, &pyramids);
            let explained = |degrees: f64| {
                let turn = UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
                let pose = Isometry3::from_parts(truth.translation, turn * truth.rotation);
                refiner.quality(&views, &pose).unwrap().mutual_information()
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
fn edges_are_inliers_at_the_true_pose() {
    let (mesh, camera, mut draw) = (cuboid(), camera(70.0), Draw(4));
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
    let image = seen(&mesh, &camera, &truth, &mut draw);
    let (refiner, view) = (
        Refiner::new(&mesh, 0.13),
        View {
            camera: &camera,
            image: &Pyramid::new(&image),
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
        edges.iter().filter(|edge| edge.is_inlier).count() as f64 / edges.len() as f64
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
fn quality_is_worst_in_the_view_without_the_object() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0, 140.0].map(camera);
    let mut draw = Draw(4);
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(1.0));
    let mut images = [0, 1, 2].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
    images[2] = background(&mut draw);
    let pyramids = images.each_ref().map(Pyramid::new);
    let views = views_of(&cameras, &pyramids);
    let quality = refiner.quality(&views, &truth).unwrap();
    let [first, second, hidden] = quality.views[..] else {
        panic!("{quality:?}")
    };
    assert_eq!(quality.worst().unwrap().view, 2);
    for shown in [first, second] {
        // Not all of it: some creases lie between faces of like brightness.
        assert!(
            shown.contour_inliers > 0.5 && shown.contour_inliers > hidden.contour_inliers + 0.3
        );
        assert!(
            shown.contour_residual_px < 0.7
                && shown.contour_residual_px < hidden.contour_residual_px / 2.0
        );
        assert!(
            shown.color_separation > 0.7 && shown.color_separation > hidden.color_separation + 0.2
        );
    }
    let mean = (first.color_separation + second.color_separation + hidden.color_separation) / 3.0;
    assert!((quality.color_separation() - mean).abs() < 1e-12);
    assert_eq!(Quality::default().mutual_information(), 0.0);
}

#[test]
fn difference_grows_with_the_angle_and_is_zero_outside_the_image() {
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
