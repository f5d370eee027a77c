//! Requests to the models that come along, on their examples.

use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use mvtop_core::pose::{rotation_error_deg, translation_error};
use mvtop_core::prediction::MissReason;
use mvtop_core::request::{Answer, Plane, Prior, Request};
use mvtop_core::{Estimator, Options, Rig, ViewImage};
use nalgebra::{Isometry3, Vector3};

struct Example {
    estimator: Estimator,
    rig: Rig,
    images: Vec<ViewImage>,
}

impl Example {
    /// - `files`: of the cameras, in the rig's order
    fn load(name: &str, files: &[&str], options: &Options) -> Self {
        let root: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let folder = root.join("examples").join(name);
        let rig = Rig::load(&folder.join("rig.json")).unwrap();
        let load = |(camera, file): (usize, &&str)| ViewImage {
            camera,
            image: mvtop_core::image::load(&folder.join(file), &rig.cameras()[camera]).unwrap(),
        };
        Self {
            images: files.iter().enumerate().map(load).collect(),
            estimator: Estimator::load(&root.join("models").join(name), options).unwrap(),
            rig,
        }
    }

    /// Four objects in three photographs.
    fn ycbv4(options: &Options) -> Self {
        Self::load("ycbv4", &["a.jpg", "b.jpg", "c.jpg"], options)
    }

    fn ask(&self, request: &Request) -> Answer {
        let answer = request.answer(&self.estimator, None, &self.rig, &self.images);
        answer.unwrap()
    }
}

fn cans() -> Request {
    Request {
        classes: Some(vec!["soup_can".into()]),
        ..Request::default()
    }
}

/// The can's pose among all objects.
fn pose(of_all: &Answer) -> Isometry3<f64> {
    let mut objects = of_all.prediction.objects.iter();
    let can = objects.find(|object| object.class == "soup_can");
    can.expect("the example shows a can").world_from_obj
}

#[test]
fn a_class_has_the_pose_that_it_has_among_all() {
    let example = Example::ycbv4(&Options::default());
    let all = example.ask(&Request::default());
    assert_eq!(all.prediction.objects.len(), 4);
    assert_eq!(all.report.why, None);
    let answer = example.ask(&cans());
    let [can] = &answer.prediction.objects[..] else {
        panic!("{:?}", answer.report.why)
    };
    // A network may compute a picture otherwise beside others.
    let expected = pose(&all);
    assert!(translation_error(&can.world_from_obj, &expected) < 1e-4);
    assert!(rotation_error_deg(&can.world_from_obj.rotation, &expected.rotation) < 0.1);
    assert!(can.confidence.unwrap() > 0.9);
}

#[test]
fn priors_and_planes_admit_what_is_there_and_say_how_far_off_it_is() {
    let example = Example::ycbv4(&Options::default());
    let found = pose(&example.ask(&cans()));
    let with = |priors: Vec<Prior>, planes: Vec<Plane>| {
        example.ask(&Request {
            priors,
            planes,
            ..cans()
        })
    };
    let prior = |x: f64| {
        let moved = Isometry3::translation(x, 0.0, 0.0) * found;
        Prior::new("soup_can", &moved, 0.01, 10.0).unwrap()
    };
    let admitted = with(vec![prior(0.02)], Vec::new());
    assert!(translation_error(&pose(&admitted), &found) < 2e-3);
    let missed = |answer: Answer| {
        assert!(answer.prediction.objects.is_empty());
        let miss = answer.report.why.unwrap().remove(0);
        (miss.reason, miss.value.unwrap(), miss.camera)
    };
    let (reason, value, camera) = missed(with(vec![prior(0.2)], Vec::new()));
    assert_eq!(reason, MissReason::Prior);
    assert!((value - 20.0).abs() < 0.2 && camera.is_some(), "{value}");

    // Its lowest point, by the points of the class.
    let bundle = example.estimator.bundle();
    let class = &bundle.classes[bundle.class_index("soup_can").unwrap()];
    let points = class.points.iter();
    let heights = points.map(|point| (found * nalgebra::Point3::from(point.position)).z);
    let lowest = heights.fold(f64::INFINITY, f64::min);
    let up = found.rotation.inverse() * Vector3::z();
    let plane = |height: f64| {
        let (point, normal) = ([0.0, 0.0, height], [0.0, 0.0, 1.0]);
        Plane::new(None, point, normal, up.into(), 0.01, 10.0).unwrap()
    };
    let admitted = with(Vec::new(), vec![plane(lowest)]);
    assert!(translation_error(&pose(&admitted), &found) < 2e-3);
    let (reason, value, _) = missed(with(Vec::new(), vec![plane(lowest - 0.1)]));
    assert_eq!(reason, MissReason::Height);
    assert!((value - 0.1).abs() < 2e-3, "{value}");
}

#[test]
fn an_object_that_is_not_sure_enough_is_told_of_with_its_confidence() {
    let options = Options::default().with_inference(vec![(
        "search.min_confidence".into(),
        serde_json::json!(1.0),
    )]);
    let answer = Example::ycbv4(&options).ask(&Request {
        why: true,
        ..Request::default()
    });
    assert!(answer.prediction.objects.is_empty());
    let why = answer.report.why.unwrap();
    assert_eq!(why.len(), 4);
    for miss in why {
        assert_eq!(
            (miss.reason, miss.threshold),
            (MissReason::Confidence, Some(1.0))
        );
        assert!(miss.value.unwrap() > 0.9 && miss.bbox.is_some() && miss.t_world_obj.is_some());
    }
}

#[test]
fn images_without_the_object_tell_the_detector_s_best_score() {
    let files = ["cam0.png", "cam1.png"];
    let mut example = Example::load("mvball", &files, &Options::default());
    for view in &mut example.images {
        // Not of one color, and nothing in it.
        let (width, height) = view.image.dimensions();
        view.image = RgbImage::from_fn(width, height, |x, _| Rgb([(x / 8) as u8; 3]));
    }
    let answer = example.ask(&Request {
        why: true,
        ..Request::default()
    });
    assert!(answer.prediction.objects.is_empty());
    let why = answer.report.why.unwrap();
    assert_eq!(
        (why.len(), why[0].reason),
        (1, MissReason::DetectorScore),
        "{why:?}"
    );
    assert!(why[0].value.unwrap() < why[0].threshold.unwrap());
}
