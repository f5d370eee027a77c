//! What poses do not depend on: the order of the images, the world frame, the reference.

use super::*;

#[test]
fn order_of_the_images_does_not_matter() {
    let rig = rig();
    let seen: [(usize, &[[f64; 3]]); 3] = [(0, &BALLS), (1, &BALLS), (2, &BALLS)];
    let estimator = Estimator::new(bundle(), Box::new(Geometry::new(&rig, &seen)));
    let predict = |order: &[usize]| {
        let options = PredictOptions {
            reference: Some("right".into()),
            ..PredictOptions::default()
        };
        estimator
            .predict(&rig, &images(&rig, order), &options)
            .unwrap()
    };
    let expected = predict(&[0, 1, 2]);
    assert_eq!(expected.reference, 2);
    for order in [[2, 1, 0], [1, 2, 0]] {
        for (object, as_expected) in predict(&order).objects.iter().zip(&expected.objects) {
            assert_eq!(object.ref_from_obj, as_expected.ref_from_obj);
        }
    }
}

#[test]
fn another_world_frame_leaves_the_poses_in_the_cameras() {
    let seen: [(usize, &[[f64; 3]]); 2] = [(0, &BALLS[..1]), (1, &BALLS)];
    let expected = predict(&rig(), &seen, &PredictOptions::default());
    let new_from_old = Isometry3::new(Vector3::new(500.0, -80.0, 3.0), Vector3::new(1.0, 2.0, 0.5));
    let moved = rig()
        .moved(|_, camera| new_from_old * camera.world_from_cam())
        .unwrap();
    let network = Geometry::new(&rig(), &seen);
    let estimator = Estimator::new(bundle(), Box::new(network));
    let prediction = estimator
        .predict(&moved, &images(&moved, &[0, 1]), &PredictOptions::default())
        .unwrap();
    assert_eq!(prediction.objects.len(), expected.objects.len());
    for (object, as_expected) in prediction.objects.iter().zip(&expected.objects) {
        let off = as_expected.ref_from_obj.inv_mul(&object.ref_from_obj);
        assert!(off.translation.vector.norm() < 1e-5 && off.rotation.angle() < 1e-5);
        let off = (new_from_old * as_expected.world_from_obj).inv_mul(&object.world_from_obj);
        assert!(off.translation.vector.norm() < 1e-5 && off.rotation.angle() < 1e-5);
    }
}

/// Cameras of two sizes on an arc around the balls.
fn arc(views: usize) -> Vec<Camera> {
    let camera = |i: usize| {
        let (sin, cos) = (0.5 * i as f64 - 1.4).sin_cos();
        let size = [(320, 240), (640, 360)][i % 2];
        let center = [1.8 * sin, -1.8 * cos, 1.2 + 0.1 * i as f64];
        camera(&format!("cam{i}"), size, 300.0 + 10.0 * i as f64, center)
    };
    (0..views).map(camera).collect()
}

#[test]
fn poses_in_the_world_do_not_depend_on_the_reference() {
    let balls: &[[f64; 3]] = &BALLS;
    for views in [2, 6, 8] {
        let rig = |reference| Rig::new(arc(views), reference).unwrap();
        let cameras: Vec<usize> = (0..views).collect();
        // Each ball is hidden from some of the cameras: the references see it, or they do not.
        let shown = |camera: usize| match (camera, views) {
            (0, 3..) => &balls[1..],
            (1, 3..) => &balls[..1],
            _ => balls,
        };
        let seen: Vec<(usize, &[[f64; 3]])> = cameras.iter().map(|&i| (i, shown(i))).collect();
        {
            let network = Geometry::new(&rig(0), &seen);
            let estimator = Estimator::new(bundle(), Box::new(network));
            let mut expected: Option<Vec<Isometry3<f64>>> = None;
            for reference in 0..views {
                let rig = rig(reference);
                let prediction = estimator
                    .predict(&rig, &images(&rig, &cameras), &PredictOptions::default())
                    .unwrap();
                assert_eq!(prediction.reference, reference);
                let objects = &prediction.objects;
                let poses: Vec<_> = objects.iter().map(|object| object.world_from_obj).collect();
                assert_eq!(poses.len(), 2, "{views} views");
                assert_eq!(*expected.get_or_insert_with(|| poses.clone()), poses);
                let world_from_ref = rig.cameras()[reference].world_from_cam();
                for object in objects {
                    let off =
                        (world_from_ref * object.ref_from_obj).inv_mul(&object.world_from_obj);
                    assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-12);
                }
            }
        }
    }
}

#[test]
fn order_of_the_cameras_changes_no_bit() {
    let balls: &[[f64; 3]] = &BALLS;
    for views in 2..=8 {
        let shown = |camera: usize| match camera {
            1 => &balls[..1],
            _ => balls,
        };
        {
            // Images go to the network by their cameras' ids, whatever the order in the rig.
            let ordered = Rig::new(arc(views), 0).unwrap();
            let seen: Vec<(usize, &[[f64; 3]])> = (0..views).map(|i| (i, shown(i))).collect();
            let found = |order: &[usize]| {
                let cameras = order
                    .iter()
                    .map(|&i| ordered.cameras()[i].clone())
                    .collect();
                let rig = Rig::new(cameras, 0).unwrap();
                let geometry = Geometry::new(&ordered, &seen);
                let mut bundle = bundle();
                bundle.classes[0].points = super::doubts::sphere();
                let estimator = Estimator::new(bundle, Box::new(geometry));
                let shuffled: Vec<usize> = (0..views).rev().collect();
                let images = images(&rig, &shuffled);
                let prediction = estimator.predict(&rig, &images, &PredictOptions::default());
                let objects = prediction.unwrap().objects;
                let each = objects.into_iter().map(|object| {
                    let seen = object.cameras.iter().filter(|seen| seen.bbox.is_some());
                    let mut seen: Vec<usize> = seen.map(|seen| order[seen.camera]).collect();
                    seen.sort_unstable();
                    let pose = object.world_from_obj.to_homogeneous();
                    (pose, object.sigma, object.score, seen)
                });
                each.collect::<Vec<_>>()
            };
            let identity: Vec<usize> = (0..views).collect();
            let expected = found(&identity);
            assert!(expected.len() >= 2, "{views} views");
            let mut rotated = identity.clone();
            rotated.rotate_left(views / 2);
            let reversed: Vec<usize> = identity.iter().rev().copied().collect();
            for order in [rotated, reversed] {
                assert_eq!(found(&order), expected, "{views} views, {order:?}");
            }
        }
    }
}
