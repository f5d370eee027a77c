//! What is given beside the images, and what is refused.

use super::*;
use crate::prediction::WarningCode;

#[test]
fn given_boxes_replace_the_detector() {
    let rig = rig();
    let [first, second] = BALLS;
    let bbox = |camera: usize, ball| ball_box(&rig.cameras()[camera], ball);
    let boxes = vec![
        given(&[("middle", bbox(1, second))]),
        // `right` gives no image, so its box is not used.
        given(&[
            ("left", bbox(0, first)),
            ("middle", bbox(1, first)),
            ("right", [0., 0., 9., 9.].into()),
        ]),
    ];
    let options = PredictOptions {
        boxes: Some(boxes),
        ..PredictOptions::default()
    };
    let prediction = predict(&rig, &[(0, &[]), (1, &[])], &options);
    assert_eq!(prediction.objects.len(), 2);
    assert_at(&prediction.objects[0], second);
    assert_at(&prediction.objects[1], first);
    assert_eq!(prediction.objects[0].score, 1.0);
    assert_eq!(prediction.objects[0].cameras[0].bbox, None);
    assert_eq!(prediction.objects[1].cameras[0].bbox, Some(bbox(0, first)));
}

#[test]
fn image_of_one_color_is_warned_of() {
    let rig = rig();
    let seen: [(usize, &[[f64; 3]]); 2] = [(0, &BALLS), (2, &[])];
    let estimator = Estimator::new(bundle(), Box::new(Geometry::new(&rig, &seen)));
    let mut images = images(&rig, &[0, 2]);
    let options = PredictOptions::default();
    let warned = |images: &[ViewImage]| estimator.predict(&rig, images, &options).unwrap().warnings;
    assert_eq!(warned(&images), []);
    // A covered camera: black, but for noise.
    for (i, pixel) in images[1].image.pixels_mut().enumerate() {
        pixel.0 = [(i % 7) as u8; 3];
    }
    let [warning] = &warned(&images)[..] else {
        panic!("expected one warning");
    };
    assert_eq!(
        (warning.code, warning.camera),
        (WarningCode::OneColor, Some(2))
    );
    assert!(
        warning.message.contains("camera `right` is of one color"),
        "{}",
        warning.message
    );
}

#[test]
fn arguments_that_do_not_fit_are_refused_in_one_sentence() {
    let rig = rig();
    let refusal = |images: &[ViewImage], options: PredictOptions| {
        let seen: Vec<(usize, &[[f64; 3]])> =
            images.iter().map(|i| (i.camera.min(2), &[][..])).collect();
        let estimator = Estimator::new(bundle(), Box::new(Geometry::new(&rig, &seen)));
        estimator.predict(&rig, images, &options).unwrap_err()
    };
    let plain = PredictOptions::default;
    let sized = |camera, width, height| ViewImage {
        camera,
        image: RgbImage::new(width, height),
    };
    let none = refusal(&[], plain());
    assert!(matches!(none, Error::TooFewImages { got: 0, .. }), "{none}");
    assert!(none.to_string().contains("at least one"), "{none}");
    let twice = refusal(&images(&rig, &[1, 0, 1]), plain()).to_string();
    assert!(twice.contains("`middle`: expected one image"), "{twice}");
    let wrong = refusal(&[sized(0, 240, 320)], plain());
    assert!(matches!(wrong, Error::ImageSize { .. }), "{wrong}");
    let wrong = wrong.to_string();
    assert!(
        wrong.contains("320x240 px as in the rig, got 240x320"),
        "{wrong}"
    );
    let no_camera = refusal(&[sized(3, 1, 1)], plain()).to_string();
    assert!(no_camera.contains("the rig has 3"), "{no_camera}");

    let options = PredictOptions {
        reference: Some("top".into()),
        ..PredictOptions::default()
    };
    let problem = refusal(&images(&rig, &[0]), options);
    let unknown = |e: &Error| {
        matches!(
            e,
            Error::Geometry(mvtop_geometry::Error::UnknownCamera { .. })
        )
    };
    assert!(unknown(&problem), "{problem}");
    let problem = problem.to_string();
    assert!(problem.contains("no camera `top`") && problem.contains("left, middle, right"));

    let options = PredictOptions {
        min_views: 2,
        ..PredictOptions::default()
    };
    let problem = refusal(&images(&rig, &[0]), options);
    assert!(
        matches!(
            problem,
            Error::TooFewImages {
                expected: 2,
                got: 1
            }
        ),
        "{problem}"
    );

    let mut other_class = given(&[("left", [1., 1., 9., 9.].into())]);
    other_class.class = "cube".into();
    for (boxes, says) in [
        (
            other_class,
            "no class `cube` in the model, expected one of: ball",
        ),
        (
            given(&[("top", [1., 1., 9., 9.].into())]),
            "no camera `top`",
        ),
        (
            given(&[("middle", [1., 1., 9., 9.].into())]),
            "at least one of the given images",
        ),
        (
            given(&[("left", [9., 1., 1., 9.].into())]),
            "camera `left`, got [9.0, 1.0, 1.0, 9.0]",
        ),
        (
            given(&[("left", [f64::NAN; 4].into())]),
            "camera `left`, got [NaN",
        ),
        (
            given(&[("left", [400., 1., 500., 9.].into())]),
            "within the image",
        ),
    ] {
        let options = PredictOptions {
            boxes: Some(vec![boxes]),
            ..PredictOptions::default()
        };
        let problem = refusal(&images(&rig, &[0]), options).to_string();
        assert!(
            problem.contains(says) && problem.contains("object 0"),
            "{problem}"
        );
    }
}

#[test]
fn broken_detector_is_no_empty_scene() {
    let rig = rig();
    let error = |detector_disorder: fn(&mut DetectorMaps)| {
        let network = Geometry {
            detector_disorder,
            ..Geometry::new(&rig, &[(0, &BALLS)])
        };
        let estimator = Estimator::new(bundle(), Box::new(network));
        let result = estimator.predict(&rig, &images(&rig, &[0]), &PredictOptions::default());
        result.unwrap_err().to_string()
    };
    type Case = (fn(&mut DetectorMaps), &'static str);
    let cases: [Case; 5] = [
        (
            |maps| maps.scores.fill(f32::NAN),
            "scores from 0 to 1, got NaN",
        ),
        (
            |maps| maps.scores[(0, 0, 3, 4)] = 1.5,
            "scores from 0 to 1, got 1.5",
        ),
        (
            |maps| maps.scores[(0, 0, 3, 4)] = -0.1,
            "scores from 0 to 1, got -0.1",
        ),
        (|maps| maps.boxes.fill(f32::INFINITY), "boxes"),
        (|maps| maps.boxes.mapv_inplace(|side| -side), "boxes"),
    ];
    for (disorder, part) in cases {
        let error = error(disorder);
        assert!(
            error.contains(part) && error.contains("bundle is broken"),
            "{error}"
        );
    }
}

#[test]
fn network_in_disorder_is_an_error() {
    let rig = rig();
    let error = |disorder: fn(&mut Decoded)| {
        let network = Geometry {
            disorder,
            ..Geometry::new(&rig, &[(0, &BALLS)])
        };
        let estimator = Estimator::new(bundle(), Box::new(network));
        estimator
            .predict(&rig, &images(&rig, &[0]), &PredictOptions::default())
            .unwrap_err()
    };
    assert!(matches!(
        error(|d| d.translation[(0, 1)] = f32::NAN),
        Error::Pose(_)
    ));
    assert!(matches!(
        error(|d| d.sigma[(0, 1)] = f32::INFINITY),
        Error::Pose(_)
    ));
    assert!(matches!(error(|d| d.sigma[(0, 0)] = -1.0), Error::Pose(_)));
    assert!(matches!(
        error(|d| d.rotation_6d.fill(0.0)),
        Error::Geometry(mvtop_geometry::Error::Rotation6d(_))
    ));
    assert!(matches!(
        error(|d| d.rotation_6d = Array2::zeros((2, 6))),
        Error::Shape { .. }
    ));
    let no_classes = Bundle {
        classes: vec![],
        ..bundle()
    };
    let estimator = Estimator::new(no_classes, Box::new(Geometry::new(&rig, &[(0, &BALLS)])));
    let result = estimator.predict(&rig, &images(&rig, &[0]), &PredictOptions::default());
    assert!(matches!(
        result,
        Err(Error::Shape {
            name: "det_scores",
            ..
        })
    ));
}

#[test]
fn poses_that_no_camera_can_see_are_dropped() {
    let rig = rig();
    let found = |disorder: fn(&mut Decoded)| {
        let network = Geometry {
            disorder,
            ..Geometry::new(&rig, &[(0, &BALLS)])
        };
        let estimator = Estimator::new(bundle(), Box::new(network));
        let images = images(&rig, &[0]);
        let prediction = estimator.predict(&rig, &images, &PredictOptions::default());
        prediction.unwrap().objects.len()
    };
    assert_eq!(found(|_| ()), 2);
    // The nearer one of two, at 1.4 and 1.55 m, is behind the camera.
    let nearer_behind = |d: &mut Decoded| {
        if d.translation[(0, 2)] < 1.5 {
            d.translation *= -1.0;
        }
    };
    assert_eq!(found(nearer_behind), 1);
    assert_eq!(found(|d| d.translation *= -1.0), 0);
    // 0.14 m, seen from about 1.5 m.
    assert_eq!(found(|d| d.translation *= 1000.0), 0);
}
