//! Which objects are found, and where.

use super::*;
use crate::closeup::CloseUp;

#[test]
fn objects_are_found_where_they_are_whichever_views_see_them() {
    let rig = rig();
    let [first, second] = BALLS;
    // The second ball is hidden from the reference.
    let seen: [(usize, &[[f64; 3]]); 3] =
        [(0, &[first]), (1, &[second, first]), (2, &[first, second])];
    let prediction = predict(&rig, &seen, &PredictOptions::default());

    assert_eq!(prediction.reference, 0);
    assert_eq!(prediction.provider, "geometry");
    assert_eq!(prediction.objects.len(), 2);
    assert!(prediction.timings.crop > 0.0);
    let by_all = prediction
        .objects
        .iter()
        .find(|o| o.cameras[0].bbox.is_some())
        .unwrap();
    let by_two = prediction
        .objects
        .iter()
        .find(|o| o.cameras[0].bbox.is_none())
        .unwrap();
    assert_at(by_all, first);
    assert_at(by_two, second);
    assert_eq!((by_all.class.as_str(), by_all.class_id), ("ball", 7));
    assert!((by_all.score - (1.0 - 0.1 * 0.2 * 0.1)).abs() < 1e-6);
    assert!((by_two.score - (1.0 - 0.1 * 0.2)).abs() < 1e-6);
    // Turned as their anchors, which are the close-ups of the cameras that see them.
    for (object, anchors) in [(by_all, 0..3), (by_two, 1..3)] {
        let turns = rig.cameras().iter().zip(&object.cameras);
        let turns: Vec<UnitQuaternion<f64>> = turns
            .filter_map(|(camera, seen)| CloseUp::new(camera, seen.bbox?, CLOSE))
            .map(|closeup| closeup.camera.world_from_cam().rotation)
            .collect();
        assert_eq!(turns.len(), anchors.len());
        assert!(is_mean_of_some(&object.world_from_obj.rotation, &turns));
        // Each anchor gives another rotation, and they are equally probable.
        let prior = object.evidence.as_ref().unwrap().pose.prior;
        assert!((prior - 1.0 / turns.len() as f64).abs() < 1e-9, "{prior}");
        for camera in &object.cameras {
            let world = rig.cameras()[camera.camera].world_from_cam() * camera.cam_from_obj;
            assert!(
                (world.translation.vector - object.world_from_obj.translation.vector).norm() < 1e-9
            );
        }
        let reference = rig.cameras()[0].world_from_cam() * object.ref_from_obj;
        assert!(
            (reference.translation.vector - object.world_from_obj.translation.vector).norm() < 1e-9
        );
    }
    let found: [f64; 4] = by_all.cameras[2].bbox.unwrap().into();
    let expected: [f64; 4] = ball_box(&rig.cameras()[2], first).into();
    assert!(
        found
            .iter()
            .zip(expected)
            .all(|(a, b)| (a - b).abs() < 1e-3),
        "{found:?}"
    );
}

/// Scores of the objects and the number of views that see each, the highest score first.
///
/// - `seen`: for cameras 0, 1, ... the balls seen there; the first has score 0.9, the second 0.8
fn found(agree_threshold: Option<f32>, seen: &[&[[f64; 3]]]) -> Vec<(f64, usize)> {
    let rig = rig();
    let mut bundle = bundle();
    bundle.detector.score_threshold = 0.85;
    bundle.detector.agree_threshold = agree_threshold;
    let seen: Vec<(usize, &[[f64; 3]])> = seen.iter().copied().enumerate().collect();
    let cameras: Vec<usize> = (0..seen.len()).collect();
    let estimator = Estimator::new(bundle, Box::new(Geometry::new(&rig, &seen)));
    let prediction = estimator
        .predict(&rig, &images(&rig, &cameras), &PredictOptions::default())
        .unwrap();
    let views = |object: &ObjectPose| object.cameras.iter().filter(|c| c.bbox.is_some()).count();
    let objects = prediction.objects.iter();
    let mut found: Vec<(f64, usize)> = objects
        .map(|object| ((object.score * 1e3).round() / 1e3, views(object)))
        .collect();
    // Poses are in the order of their log-odds.
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found
}

#[test]
fn faint_box_counts_where_another_view_agrees() {
    let [first, second] = BALLS;
    // `first` is faint in the other view, which shows `second` better.
    let seen: [&[[f64; 3]]; 2] = [&[first], &[second, first]];
    assert_eq!(found(None, &seen), [(0.9, 1), (0.9, 1)]);
    assert_eq!(found(Some(0.85), &seen), [(0.9, 1), (0.9, 1)]);
    assert_eq!(found(Some(0.75), &seen), [(0.98, 2), (0.9, 1)]);
    // Faint in both views, but both are there.
    let both: [&[[f64; 3]]; 2] = [&BALLS, &BALLS];
    assert_eq!(found(None, &both), [(0.99, 2)]);
    assert_eq!(found(Some(0.75), &both), [(0.99, 2), (0.96, 2)]);
}

#[test]
fn objects_in_too_few_views_are_left_out() {
    let rig = rig();
    let [first, second] = BALLS;
    let seen: [(usize, &[[f64; 3]]); 3] =
        [(0, &[first]), (1, &[second, first]), (2, &[first, second])];
    let count = |min_views, seen: &[(usize, &[[f64; 3]])]| {
        let options = PredictOptions {
            min_views,
            ..PredictOptions::default()
        };
        predict(&rig, seen, &options).objects.len()
    };
    assert_eq!([0, 1, 2, 3].map(|least| count(least, &seen)), [2, 2, 2, 1]);
    assert_eq!(count(2, &[(0, &[first]), (1, &[second])]), 0);
    // Given boxes are taken as they are.
    let given = given(&[("left", ball_box(&rig.cameras()[0], first))]);
    let options = PredictOptions {
        boxes: Some(vec![given]),
        min_views: 2,
        ..PredictOptions::default()
    };
    let prediction = predict(&rig, &[(0, &[]), (1, &[])], &options);
    assert_eq!(prediction.objects.len(), 1);
}

#[test]
fn faint_box_alone_is_no_object() {
    let [first, second] = BALLS;
    assert_eq!(found(Some(0.75), &[&[first, second]]), [(0.9, 1)]);
    // Faint boxes of different balls do not agree.
    let crossed: [&[[f64; 3]]; 2] = [&[first, second], &[second, first]];
    assert_eq!(found(Some(0.75), &crossed), [(0.98, 2), (0.98, 2)]);
    let (here, there): (&[_], &[_]) = (&[first, second], &[first]);
    assert_eq!(found(Some(0.75), &[here, there]), [(0.99, 2)]);
}

#[test]
fn one_view_is_enough() {
    for camera in 0..3 {
        let prediction = predict(&rig(), &[(camera, &BALLS[..])], &PredictOptions::default());
        assert_eq!(prediction.reference, 0, "the reference needs no image");
        assert_eq!(prediction.objects.len(), 2);
        for (object, ball) in prediction.objects.iter().zip(BALLS) {
            assert_at(object, ball);
            assert_eq!(object.cameras.len(), 1);
        }
    }
}

#[test]
fn nothing_detected_is_no_error() {
    let prediction = predict(&rig(), &[(0, &[]), (2, &[])], &PredictOptions::default());
    assert!(prediction.objects.is_empty());
}
