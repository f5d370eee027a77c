//! Boxes of identical objects that are matched wrongly at first.

use super::instances::candidate;
use super::*;
use crate::detect::Detection;
use crate::estimator::instance::Instance;
use crate::estimator::pipeline::Pipeline;
use crate::estimator::rematch::most_probable;
use crate::scorer::Scorer;

/// An instance with boxes of these numbers, by view.
fn instance(boxes: [Option<u8>; 2], log_odds: f64) -> Instance {
    let detection = |number: u8| {
        let x0 = f64::from(number);
        let bbox = BBox {
            x0,
            y0: 0.0,
            x1: x0 + 0.5,
            y1: 0.5,
        };
        Detection {
            class: 0,
            score: 0.9,
            bbox,
        }
    };
    Instance {
        candidates: vec![candidate(Isometry3::identity(), log_odds)],
        ..Instance::new(0, boxes.map(|number| number.map(detection)).to_vec())
    }
}

#[test]
fn of_instances_with_the_same_box_the_more_probable_one_is_kept() {
    let kept = |instances: &[Instance]| {
        let mut kept = most_probable(instances);
        kept.sort_unstable();
        kept
    };
    let crossed = [
        instance([Some(0), Some(1)], -1.0),
        instance([Some(1), Some(0)], -2.0),
    ];
    assert_eq!(kept(&crossed), [0, 1]);
    let parallel = |odds: [f64; 2]| {
        let each = [0, 1].map(|number| instance([Some(number); 2], odds[usize::from(number)]));
        [&crossed[..], &each].concat()
    };
    assert_eq!(kept(&parallel([3.0, -5.0])), [2, 3]);
    assert_eq!(kept(&parallel([-1.5, -1.5])), [0, 1]);
    let first = &parallel([-1.5, 0.0]);
    assert_eq!(kept(first), [2, 3]);
    // Boxes of the same number are of different views.
    let single = [
        instance([Some(0), None], 0.0),
        instance([None, Some(0)], 0.0),
    ];
    assert_eq!(kept(&single), [0, 1]);
}

/// Where the first of two rays is nearest to the second.
///
/// - `rays`: a point of each, and the point that it comes from
fn crossing(rays: [[Vector3<f64>; 2]; 2]) -> Vector3<f64> {
    let [(from, along), (other, across)] = rays.map(|[from, to]| (from, to - from));
    let normal = across.cross(&along.cross(&across));
    from + along * ((other - from).dot(&normal) / along.dot(&normal))
}

/// What is found of two balls in one plane with two cameras. Their boxes fit two other balls a bit better,
/// where the rays cross as well; a third view shows faintly which are there.
fn found(doubtful: f64) -> ([[f64; 3]; 2], Prediction) {
    let rig = rig();
    let [left, _, right] = [0, 1, 2].map(|camera| {
        let camera: &Camera = &rig.cameras()[camera];
        camera.world_from_cam().translation.vector
    });
    let target = Vector3::new(0.0, 0.0, 1.0);
    let (middle, normal) = (
        (left + right) / 2.0 - target,
        (left - target).cross(&(right - target)),
    );
    let true_balls = [0.12, -0.12].map(|along| target + middle.normalize() * along);
    let wrong_balls = [0, 1].map(|one| {
        let meet = crossing([[left, true_balls[one]], [right, true_balls[1 - one]]]);
        let beside = normal.normalize() * if one == 0 { 0.008 } else { -0.008 };
        <[f64; 3]>::from(meet + beside)
    });
    let true_balls = true_balls.map(<[f64; 3]>::from);
    let seen: [(usize, &[[f64; 3]]); 3] = [(0, &wrong_balls), (1, &true_balls), (2, &wrong_balls)];
    let mut bundle = Bundle {
        scorer: Some(Scorer::default()),
        ..bundle()
    };
    bundle.classes[0].points = super::doubts::sphere();
    bundle.inference.search.doubtful = doubtful;
    bundle.inference.search.min_confidence = 0.0;
    let network = Geometry {
        detector_disorder: |maps| {
            let mut faint = maps.scores.index_axis_mut(ndarray::Axis(0), 1);
            faint.mapv_inplace(|score| if score > 0.0 { 0.2 } else { 0.0 });
        },
        ..Geometry::new(&rig, &seen)
    };
    let estimator = Estimator::new(bundle, Box::new(network));
    let images = images(&rig, &[0, 1, 2]);
    let prediction = estimator.predict(&rig, &images, &PredictOptions::default());
    (true_balls, prediction.unwrap())
}

#[test]
fn poses_tell_which_boxes_are_of_one_object() {
    let near = |balls: [[f64; 3]; 2], prediction: &Prediction| {
        balls.map(|ball| {
            let off =
                |one: &ObjectPose| one.world_from_obj.translation.vector - Vector3::from(ball);
            prediction.objects.iter().any(|one| off(one).norm() < 0.02)
        })
    };
    let (balls, prediction) = found(0.0);
    assert_eq!(near(balls, &prediction), [false; 2], "the trap is set");
    let (balls, prediction) = found(0.5);
    assert_eq!(near(balls, &prediction), [true; 2]);
    assert_eq!(prediction.objects.len(), 2);
}

#[test]
fn box_that_no_match_keeps_is_an_object_of_one_view() {
    let network = Geometry::new(&rig(), &[(0, &BALLS), (2, &BALLS)]);
    let estimator = Estimator::new(bundle(), Box::new(network));
    let (rig, options) = (rig(), PredictOptions::default());
    let images = images(&rig, &[0, 2]);
    let pipeline = |min_views| {
        let options = PredictOptions {
            min_views,
            ..options.clone()
        };
        Pipeline::new(
            &estimator,
            &*estimator.network,
            &rig,
            &images,
            Box::leak(Box::new(options)),
        )
    };
    let all = [
        instance([Some(0), Some(1)], 1.0),
        instance([Some(1), Some(0)], -1.0),
        instance([Some(1), None], -2.0),
    ];
    let left = pipeline(1).unwrap().left_over(&all, &[0]);
    let boxes: Vec<_> = left.iter().map(|one| one.detections.clone()).collect();
    let [first, second] = [&all[1].detections[0], &all[1].detections[1]];
    assert_eq!(boxes, [vec![*first, None], vec![None, *second]]);
    assert!(pipeline(2).unwrap().left_over(&all, &[0]).is_empty());
}
