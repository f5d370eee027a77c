//! Calibrations that are wrong are warned of.

use super::*;
use crate::bundle::SurfacePoint;
use crate::consistency::extent;
use crate::prediction::WarningCode;
use crate::scorer::Scorer;

/// Points all over the ball.
pub(super) fn sphere() -> Vec<SurfacePoint> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let point = |i: i32| {
        let z = (f64::from(i) + 0.5) / 500.0 - 1.0;
        let (sin, cos) = (f64::from(i) * golden).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        SurfacePoint {
            position: [RADIUS * radius * cos, RADIUS * radius * sin, RADIUS * z],
            color: [0; 3],
        }
    };
    (0..1000).map(point).collect()
}

/// What is predicted of images of the true rig with another one.
///
/// - `seen`: for cameras 0, 1, ... the balls seen there
fn told(seen: &[&[[f64; 3]]], lie: &Rig) -> Prediction {
    told_by(seen, lie, None)
}

/// The same by a bundle with this scorer.
fn told_by(seen: &[&[[f64; 3]]], lie: &Rig, scorer: Option<Scorer>) -> Prediction {
    let rig = rig();
    let points = sphere();
    let cameras: Vec<usize> = (0..seen.len()).collect();
    let indexed: Vec<(usize, &[[f64; 3]])> = seen.iter().copied().enumerate().collect();
    let mut geometry = Geometry::new(&rig, &indexed);
    for ((boxes, balls), camera) in geometry.boxes.iter_mut().zip(seen).zip(rig.cameras()) {
        for (bbox, &ball) in boxes.iter_mut().zip(*balls) {
            let at_ball = Isometry3::translation(ball[0], ball[1], ball[2]);
            *bbox = extent(&points, camera, &at_ball).unwrap();
        }
    }
    let mut bundle = Bundle { scorer, ..bundle() };
    bundle.classes[0].points = points;
    let estimator = Estimator::new(bundle, Box::new(geometry));
    let images = images(&rig, &cameras);
    estimator
        .predict(lie, &images, &PredictOptions::default())
        .unwrap()
}

fn codes(prediction: &Prediction) -> Vec<WarningCode> {
    prediction.warnings.iter().map(|w| w.code).collect()
}

/// The rig with its last camera elsewhere in its own frame.
fn last_moved(count: usize, cam_from_new: Isometry3<f64>) -> Rig {
    let moved = rig().moved(|index, camera| match index + 1 == count {
        true => camera.world_from_cam() * cam_from_new,
        false => *camera.world_from_cam(),
    });
    moved.unwrap()
}

#[test]
fn true_calibration_is_not_warned_of() {
    let [first, second] = BALLS;
    let prediction = told(&[&[first], &[first], &[first]], &rig());
    assert_eq!(codes(&prediction), []);
    let fit = prediction.rig_consistency.unwrap();
    assert!(fit.px < 0.05, "{fit:?}");
    // Nor where hypotheses of each object share its odds, one of each anchor's frame.
    let both: &[[f64; 3]] = &[first, second];
    assert_eq!(codes(&told(&[both, both, both], &rig())), []);
    // One camera has nothing to disagree with, nor have two of which one sees another ball as well.
    assert!(told(&[&[first, second]], &rig()).rig_consistency.is_none());
    assert_eq!(codes(&told(&[&[first, second]], &rig())), []);
    assert_eq!(codes(&told(&[&[first, second], &[first]], &rig())), []);
}

#[test]
fn camera_that_is_off_is_named_by_the_others() {
    let [first, _] = BALLS;
    let seen: [&[[f64; 3]]; 3] = [&[first], &[first], &[first]];
    // The ball is 32 px wide there; 1 degree is 8.7 px.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::x() * 1f64.to_radians());
    let lie = last_moved(3, Isometry3::from_parts(Translation3::identity(), turn));
    let prediction = told(&seen, &lie);
    assert_eq!(codes(&prediction), [WarningCode::LinesMiss]);
    let warning = &prediction.warnings[0];
    assert_eq!((warning.camera, warning.object), (Some(2), Some(0)));
    let says = [
        "by the other views, `ball` is",
        "px beside its place in camera `right`",
    ];
    let all = says.iter().all(|part| warning.message.contains(part));
    assert!(all, "{}", warning.message);
    assert_eq!(prediction.rig_consistency.unwrap().worst_camera, Some(2));
}

#[test]
fn rig_of_another_size_is_told_by_the_boxes() {
    let [first, _] = BALLS;
    // Of two cameras none is known to be wrong.
    let scaled = rig().moved(|_, camera| {
        let pose = camera.world_from_cam();
        Isometry3::from_parts((pose.translation.vector * 1.12).into(), pose.rotation)
    });
    let prediction = told(&[&[first], &[first]], &scaled.unwrap());
    assert_eq!(codes(&prediction), [WarningCode::SizesDisagree]);
    assert_eq!(prediction.warnings[0].camera, None);
    let message = &prediction.warnings[0].message;
    assert!(message.contains("12 % larger or smaller"), "{message}");
    assert_eq!(prediction.rig_consistency.unwrap().worst_camera, None);
}

#[test]
fn views_of_which_none_fits_another_are_warned_of() {
    let [first, _] = BALLS;
    let seen: [&[[f64; 3]]; 2] = [&[first], &[first]];
    // Too far turned to match, but both still look at the balls.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::x() * 6f64.to_radians());
    let lie = last_moved(2, Isometry3::from_parts(Translation3::identity(), turn));
    let prediction = told(&seen, &lie);
    // The calibration may be wrong: neither of the two is taken for the other.
    assert_eq!(prediction.objects.len(), 2);
    assert_eq!(codes(&prediction), [WarningCode::NothingMatches]);
    assert_eq!(prediction.warnings[0].camera, None);
    let fit = prediction.rig_consistency.unwrap();
    assert!(fit.deviation > 1.0 && fit.contradiction > 2.4, "{fit:?}");
}

#[test]
fn swapped_images_contradict_each_other() {
    // Four balls a view, none of which is where the other camera should show it.
    let left: [[f64; 3]; 3] = [[-0.3, 0.0, 1.0], [0.0, 0.1, 1.1], [0.2, -0.1, 0.9]];
    let right: [[f64; 3]; 3] = left.map(|[x, y, z]| [x + 0.02, y, z + 0.22]);
    let swapped = told(&[&left, &right], &rig());
    assert!(swapped.objects.iter().all(|one| {
        one.cameras
            .iter()
            .filter(|seen| seen.bbox.is_some())
            .count()
            == 1
    }));
    assert_eq!(codes(&swapped), [WarningCode::NothingMatches]);
    // A third camera tells which of them is wrong.
    let third = told(&[&left, &left, &right], &rig());
    let [warning] = &third.warnings[..] else {
        panic!("{:?}", third.warnings)
    };
    assert_eq!(warning.camera, Some(2), "{}", warning.message);
    assert!(matches!(
        warning.code,
        WarningCode::NothingMatches | WarningCode::ViewsContradict
    ));
}

#[test]
fn objects_that_fit_no_image_contradict_no_rig() {
    let left: [[f64; 3]; 3] = [[-0.3, 0.0, 1.0], [0.0, 0.1, 1.1], [0.2, -0.1, 0.9]];
    let right: [[f64; 3]; 3] = left.map(|[x, y, z]| [x + 0.02, y, z + 0.22]);
    // Log-odds of a view: minus 1 without a detection there, otherwise by the detector's score.
    let by_detector = |weight: f64| {
        let mut scorer = Scorer::default();
        scorer.unrefined.view_bias = -1.0;
        scorer.unrefined.view = [("detector".to_owned(), weight)].into();
        told_by(&[&left, &right], &rig(), Some(scorer))
    };
    assert_eq!(codes(&by_detector(10.0)), [WarningCode::NothingMatches]);
    let unknown = by_detector(0.0);
    assert_eq!(codes(&unknown), []);
    assert_eq!(unknown.rig_consistency.unwrap().unconfirmed, 0);
}

#[test]
fn rig_on_which_an_object_agrees_is_not_doubted_for_what_single_views_find() {
    let [first, second] = BALLS;
    // In sight of both cameras, but on no line of sight to the second ball.
    let third = [second[0], second[1] + 0.25, second[2]];
    let prediction = told(&[&[first, second], &[first, third]], &rig());
    assert_eq!(codes(&prediction), []);
}

#[test]
fn of_two_objects_the_better_one_speaks_for_the_rig() {
    let [first, second] = BALLS;
    let both = told(&[&[first, second], &[first, second]], &rig());
    assert!(both.rig_consistency.unwrap().deviation < 0.1);
    // One of them is at other places in the two views, as far apart as a turn of 1 degree.
    let beside = [second[0], second[1], second[2] + 0.02];
    let alone = told(&[&[second], &[beside]], &rig());
    assert_eq!(codes(&alone), [WarningCode::LinesMiss]);
    let prediction = told(&[&[first, second], &[first, beside]], &rig());
    assert_eq!(codes(&prediction), []);
    let fit = prediction.rig_consistency.unwrap();
    assert!(fit.deviation < 0.1, "{fit:?}");
}
