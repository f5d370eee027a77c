//! Classes, priors and planes that are asked for, and near misses of classes without an object.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::proposers::surface;
use super::*;
use crate::closeup::CloseUp;
use crate::prediction::{MissReason, NearMiss};
use crate::request::{Plane, Prior};

/// Counts the crops that it is shown.
struct Counting<'a> {
    network: Geometry,
    crops: &'a AtomicUsize,
}

impl Network for Counting<'_> {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        self.network.detect(images)
    }

    fn encode(&self, pictures: ArrayView4<f32>, rays: ArrayView3<f32>) -> Result<Array3<f32>> {
        self.crops.fetch_add(pictures.dim().0, Ordering::Relaxed);
        self.network.encode(pictures, rays)
    }

    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        self.network.decode(memory, queries)
    }

    fn provider(&self) -> &str {
        "counting"
    }
}

/// The second ball, which has the lower score, as an object of a second class.
fn second_is_a_nut(maps: &mut DetectorMaps) {
    let (views, _, rows, columns) = maps.scores.dim();
    let mut scores = Array4::zeros((views, 2, rows, columns));
    for ((view, _, row, column), score) in maps.scores.indexed_iter() {
        let class = usize::from(*score < 0.85);
        scores[(view, class, row, column)] = *score;
    }
    maps.scores = scores;
}

/// Classes that are found, and the number of crops, of a ball and a nut that these cameras see.
fn of_classes(cameras: &[usize], classes: Option<&[&str]>) -> (Vec<String>, usize) {
    let rig = rig();
    let seen: Vec<(usize, &[[f64; 3]])> = cameras.iter().map(|&one| (one, &BALLS[..])).collect();
    let mut geometry = Geometry::new(&rig, &seen);
    geometry.detector_disorder = second_is_a_nut;
    let mut bundle = bundle();
    let nut = Class {
        name: "nut".into(),
        ..bundle.classes[0].clone()
    };
    bundle.classes.push(nut);
    let crops: &'static AtomicUsize = Box::leak(Box::default());
    let network = geometry;
    let estimator = Estimator::new(bundle, Box::new(Counting { network, crops }));
    let options = PredictOptions {
        classes: classes.map(|all| all.iter().map(|one| (*one).to_owned()).collect()),
        ..PredictOptions::default()
    };
    let found = estimator.predict(&rig, &images(&rig, cameras), &options);
    let objects = found.unwrap().objects.into_iter();
    let names = objects.map(|object| object.class);
    (names.collect(), crops.load(Ordering::Relaxed))
}

#[test]
fn other_classes_take_no_time_unless_they_may_hide_one_that_is_asked_for() {
    // Boxes of the two do not overlap in the first two cameras.
    let (all, crops) = of_classes(&[0, 1], None);
    assert_eq!((all.len(), crops), (2, 4));
    let (found, crops) = of_classes(&[0, 1], Some(&["nut"]));
    assert_eq!((found, crops), (vec!["nut".to_owned()], 2));
    let (found, crops) = of_classes(&[0, 1], Some(&["ball"]));
    assert_eq!((found, crops), (vec!["ball".to_owned()], 2));
    // In the third camera one is before the other.
    let (found, crops) = of_classes(&[0, 2], Some(&["ball"]));
    assert_eq!((found, crops), (vec!["ball".to_owned()], 4));
}

#[test]
fn classes_that_are_not_there_are_refused() {
    let of = |options: PredictOptions| {
        let network = Box::new(Geometry::new(&rig(), &[(0, &[])]));
        let estimator = Estimator::new(bundle(), network);
        let found = estimator.predict(&rig(), &images(&rig(), &[0]), &options);
        found.unwrap_err().to_string()
    };
    let prior = Prior::new("nut", &Isometry3::identity(), 1.0, 1.0).unwrap();
    for options in [
        PredictOptions {
            classes: Some(vec!["nut".into()]),
            ..PredictOptions::default()
        },
        PredictOptions {
            priors: vec![prior],
            ..PredictOptions::default()
        },
    ] {
        let error = of(options);
        assert!(error.contains("no class `nut`"), "{error}");
    }
}

/// A prior of a ball, of any rotation.
fn prior(ball: [f64; 3], sigma_m: f64) -> Prior {
    Prior::new("ball", &Isometry3::from(ball), sigma_m, 60.0).unwrap()
}

fn why(options: PredictOptions) -> PredictOptions {
    PredictOptions {
        why: true,
        ..options
    }
}

#[test]
fn poses_outside_their_priors_are_not_given() {
    let seen: [(usize, &[[f64; 3]]); 2] = [(0, &BALLS), (1, &BALLS)];
    let [first, second] = BALLS;
    let near = |priors: Vec<Prior>| {
        let options = PredictOptions {
            priors,
            ..PredictOptions::default()
        };
        predict(&rig(), &seen, &why(options))
    };
    let found = near(vec![prior(first, 0.01)]);
    assert_eq!(found.objects.len(), 1);
    assert_at(&found.objects[0], first);
    assert!(found.near_misses.is_empty());
    assert_eq!(
        near(vec![prior(first, 0.01), prior(second, 0.01)])
            .objects
            .len(),
        2
    );
    // 0.29 m apart: at a tenth of a metre both are within three standard deviations of the first.
    assert_eq!(near(vec![prior(first, 0.1)]).objects.len(), 2);
}

#[test]
fn how_far_the_nearest_object_is_from_its_prior_is_told() {
    let [first, _] = BALLS;
    let seen: [(usize, &[[f64; 3]]); 2] = [(0, &[first]), (1, &[first])];
    let [x, y, z] = first;
    let options = PredictOptions {
        priors: vec![prior([x + 0.5, y, z], 0.05)],
        ..PredictOptions::default()
    };
    let found = predict(&rig(), &seen, &why(options));
    assert!(found.objects.is_empty());
    let [miss] = &found.near_misses[..] else {
        panic!("{:?}", found.near_misses)
    };
    assert_eq!(
        (miss.reason, miss.threshold),
        (MissReason::Prior, Some(3.0))
    );
    assert!((miss.value.unwrap() - 10.0).abs() < 1e-3, "{miss:?}");
    let place = miss.world_from_obj.unwrap().translation.vector;
    assert!((place - Vector3::from(first)).norm() < 1e-5);
}

/// What is found on a level plane at a height, by balls of whose axis `axis` is up.
fn on_plane(height: f64, axis: [f64; 3]) -> Prediction {
    let [first, _] = BALLS;
    let up = [0.0, 0.0, 1.0];
    let plane = Plane::new(None, [5.0, 5.0, height], up, axis, 0.02, 10.0);
    let options = PredictOptions {
        planes: vec![plane.unwrap()],
        ..PredictOptions::default()
    };
    // With one view the pose is turned as its close-up.
    let seen: [(usize, &[[f64; 3]]); 1] = [(0, &[first])];
    let mut bundle = bundle();
    bundle.classes[0].points = surface();
    let estimator = Estimator::new(bundle, Box::new(Geometry::new(&rig(), &seen)));
    let found = estimator.predict(&rig(), &images(&rig(), &[0]), &why(options));
    found.unwrap()
}

#[test]
fn objects_that_do_not_stand_on_their_plane_are_not_given() {
    let rig = rig();
    let bbox = ball_box(&rig.cameras()[0], BALLS[0]);
    let closeup = CloseUp::new(&rig.cameras()[0], bbox, CLOSE).unwrap();
    let up = closeup.camera.world_from_cam().rotation.inverse() * Vector3::z();
    let lowest = 1.0 - RADIUS;
    let found = on_plane(lowest, up.into());
    assert_eq!(found.objects.len(), 1, "{:?}", found.near_misses);
    let missed = |found: Prediction| {
        assert!(found.objects.is_empty());
        let miss: NearMiss = found.near_misses.into_iter().next().unwrap();
        (miss.reason, miss.value.unwrap(), miss.threshold.unwrap())
    };
    let (reason, value, limit) = missed(on_plane(lowest - 0.05, up.into()));
    assert_eq!((reason, limit), (MissReason::Height, 0.02));
    // The points of a turned ball are a little above its lowest one.
    assert!((0.05..0.07).contains(&value), "{value}");
    let (reason, value, limit) = missed(on_plane(lowest, (-up).into()));
    assert_eq!((reason, limit), (MissReason::Tilt, 10.0));
    assert!((value - 180.0).abs() < 1e-3, "{value}");
}

#[test]
fn an_object_that_no_view_detects_is_found_where_its_prior_says() {
    let [first, _] = BALLS;
    let seen: [(usize, &[[f64; 3]]); 2] = [(0, &[]), (1, &[])];
    let mut bundle = bundle();
    bundle.classes[0].points = surface();
    let network = Geometry::new(&rig(), &seen);
    let estimator = Estimator::new(bundle, Box::new(network));
    let options = PredictOptions {
        priors: vec![prior(first, 0.02)],
        ..PredictOptions::default()
    };
    let found = estimator.predict(&rig(), &images(&rig(), &[0, 1]), &options);
    let objects = found.unwrap().objects;
    assert_eq!(objects.len(), 1);
    let off = objects[0].world_from_obj.translation.vector - Vector3::from(first);
    assert!(off.norm() < 0.02 * RADIUS, "{off}");
    assert_eq!(objects[0].score, 0.0);
    assert!(objects[0].cameras.iter().all(|seen| seen.bbox.is_none()));
}

/// The near miss of the ball, by a detector with these thresholds.
fn missed(threshold: f32, agree: f32, min_views: usize, seen: &[&[[f64; 3]]]) -> NearMiss {
    let rig = rig();
    let mut bundle = bundle();
    bundle.detector.score_threshold = threshold;
    bundle.detector.agree_threshold = Some(agree);
    let seen: Vec<(usize, &[[f64; 3]])> = seen.iter().copied().enumerate().collect();
    let cameras: Vec<usize> = (0..seen.len()).collect();
    let estimator = Estimator::new(bundle, Box::new(Geometry::new(&rig, &seen)));
    let options = PredictOptions {
        min_views,
        ..PredictOptions::default()
    };
    let images = images(&rig, &cameras);
    let silent = estimator.predict(&rig, &images, &options).unwrap();
    assert!(silent.objects.is_empty() && silent.near_misses.is_empty());
    let mut found = estimator.predict(&rig, &images, &why(options)).unwrap();
    assert_eq!(found.near_misses.len(), 1);
    found.near_misses.remove(0)
}

#[test]
fn what_came_nearest_is_told_with_the_threshold_that_it_missed() {
    let [first, second] = BALLS;
    let near = |value: Option<f64>, expected: f64| (value.unwrap() - expected).abs() < 1e-6;
    // No box at all: the detector's map has its peak of 0.9 in the second image.
    let miss = missed(0.95, 0.95, 0, &[&[], &[first]]);
    assert_eq!(
        (miss.reason, miss.camera),
        (MissReason::DetectorScore, Some(1))
    );
    assert!(near(miss.value, 0.9) && near(miss.threshold, 0.95));
    let shown = ball_box(&rig().cameras()[1], first);
    assert!(miss.bbox.unwrap().iou(&shown) > 0.99);
    // A faint box in one view.
    let miss = missed(0.95, 0.5, 0, &[&[first], &[]]);
    assert_eq!(
        (miss.reason, miss.camera),
        (MissReason::DetectorScore, Some(0))
    );
    // Faint boxes of different balls, 0.29 m apart.
    let miss = missed(0.95, 0.5, 0, &[&[first], &[second]]);
    assert_eq!(miss.reason, MissReason::RaysApart, "{}", miss.message);
    assert!(miss.value.unwrap() > miss.threshold.unwrap());
    assert!(
        miss.message.contains("`left` and `middle`"),
        "{}",
        miss.message
    );
    let miss = missed(0.3, 0.3, 2, &[&[first], &[]]);
    assert_eq!(miss.reason, MissReason::MinViews);
    assert!(near(miss.value, 1.0) && near(miss.threshold, 2.0));
}
