//! The whole flow with a network that answers from geometry alone.

mod closeups;

use super::*;
use crate::bundle::{Class, Detector, Input};
use crate::image::Letterbox;
use crate::network::{Decoded, Features};
use crate::rays::LosEncoding;
use crate::{Camera, Intrinsics, Projection};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use ndarray::{Array4, ArrayView2, ArrayView3, array, s};

const RADIUS: f64 = 0.07;
const STRIDE: usize = 8;
const NET: (u32, u32) = (320, 240);

fn bundle() -> Bundle {
    Bundle {
        dir: "bundle".into(),
        preset: "geometry".into(),
        input: Input {
            width: NET.0,
            height: NET.1,
            mean: [0.5; 3],
            std: [0.25; 3],
        },
        strides: vec![STRIDE, 16],
        los_encoding: LosEncoding::OriginDirection,
        classes: vec![Class {
            id: 7,
            name: "ball".into(),
            diameter_m: 2.0 * RADIUS,
            points: vec![],
        }],
        detector: Detector {
            score_threshold: 0.3,
            agree_threshold: None,
            nms_iou: 0.5,
        },
        closeup: None,
        features: "features.onnx".into(),
        decoder: "decoder.onnx".into(),
        portable: false,
        provenance: serde_json::Value::Null,
    }
}

/// Looks from `center` at the point one metre above the world's origin.
fn camera(id: &str, size: (u32, u32), f: f64, center: [f64; 3]) -> Camera {
    let center = Vector3::from(center);
    let z = (Vector3::new(0.0, 0.0, 1.0) - center).normalize();
    let rotation = UnitQuaternion::face_towards(&z, &Vector3::new(0.0, 0.0, -1.0));
    let (cx, cy) = (f64::from(size.0) / 2.0 - 0.5, f64::from(size.1) / 2.0 - 0.5);
    let intrinsics = Intrinsics::new(f, f, cx, cy, Projection::Pinhole).unwrap();
    let world_from_cam = Isometry3::from_parts(Translation3::from(center), rotation);
    Camera::new(id, size.into(), intrinsics, world_from_cam).unwrap()
}

/// Cameras of three sizes, shapes and focal lengths.
fn rig() -> Rig {
    let cameras = vec![
        camera("left", (320, 240), 300.0, [-1.2, -0.8, 1.2]),
        camera("middle", (200, 200), 260.0, [0.1, -1.5, 0.7]),
        camera("right", (640, 360), 500.0, [1.1, -0.9, 1.5]),
    ];
    Rig::new(cameras, 0).unwrap()
}

const BALLS: [[f64; 3]; 2] = [[-0.1, 0.05, 1.0], [0.15, -0.05, 1.1]];

/// Box of a ball in a camera's image.
fn ball_box(camera: &Camera, ball: [f64; 3]) -> [f64; 4] {
    let in_camera = camera.world_from_cam().inverse() * Point3::from(ball);
    let center = camera.intrinsics().project(&in_camera).unwrap();
    let radius = camera.intrinsics().fx() * RADIUS / in_camera.z;
    [
        center.x - radius,
        center.y - radius,
        center.x + radius,
        center.y + radius,
    ]
}

/// A network that knows where the balls are, and checks that all it is given agrees with that.
struct Geometry {
    /// Boxes of each image, in the rig's order, image px.
    boxes: Vec<Vec<[f64; 4]>>,
    letterboxes: Vec<Letterbox>,
    /// Positions of every ball in the frame of every camera.
    in_cameras: Vec<Vector3<f64>>,
    /// What a network in disorder does to its answer.
    disorder: fn(&mut Decoded),
}

impl Geometry {
    /// - `seen`: for each image, the camera's index and the balls seen there
    fn new(rig: &Rig, seen: &[(usize, &[[f64; 3]])]) -> Self {
        let in_cameras = rig.cameras().iter().flat_map(|camera| {
            let cam_from_world = camera.world_from_cam().inverse();
            BALLS.map(|ball| (cam_from_world * Point3::from(ball)).coords)
        });
        let cameras = || seen.iter().map(|&(index, _)| &rig.cameras()[index]);
        let boxes = cameras()
            .zip(seen)
            .map(|(camera, (_, balls))| balls.iter().map(|&ball| ball_box(camera, ball)).collect());
        let letterbox = |c: &Camera| Letterbox::new(c.width(), c.height(), NET.0, NET.1);
        Self {
            boxes: boxes.collect(),
            letterboxes: cameras().map(letterbox).collect(),
            in_cameras: in_cameras.collect(),
            disorder: |_| (),
        }
    }
}

impl Network for Geometry {
    /// The memory is the cells' rays, so that the decoder can tell whose they are.
    fn features(&self, images: Array4<f32>, camera_rays: Array3<f32>) -> Result<Features> {
        let views = self.boxes.len();
        assert_eq!(images.dim(), (views, 3, NET.1 as usize, NET.0 as usize));
        let (h, w) = (NET.1 as usize / STRIDE, NET.0 as usize / STRIDE);
        let mut det_scores = Array4::zeros((views, 1, h, w));
        let mut det_boxes = Array4::zeros((views, 4, h, w));
        for (v, boxes) in self.boxes.iter().enumerate() {
            for (i, &[x0, y0, x1, y1]) in boxes.iter().enumerate() {
                let from = self.letterboxes[v].net_from_image([x0, y0]);
                let to = self.letterboxes[v].net_from_image([x1, y1]);
                let cell = |axis: usize| ((from[axis] + to[axis]) / 2.0) as usize / STRIDE;
                let (row, column) = (cell(1), cell(0));
                det_scores[(v, 0, row, column)] = 0.9 - 0.1 * i as f32;
                for (side, value) in [from[0], from[1], to[0], to[1]].into_iter().enumerate() {
                    det_boxes[(v, side, row, column)] = value as f32;
                }
            }
        }
        Ok(Features {
            memory: Some(camera_rays),
            det_scores,
            det_boxes,
        })
    }

    fn closeups(&self, _: Array4<f32>, _: Array3<f32>) -> Result<Array3<f32>> {
        panic!("the bundle has no close-ups")
    }

    /// Objects where they are, turned as the anchor camera is.
    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        let objects = queries.class_index.len();
        assert!(objects > 0, "nothing to decode");
        // Rotations keep angles: the one between two cells' rays tells the cameras apart.
        let angle = |rays: ArrayView2<f32>| rays.row(105).dot(&rays.row(125));
        for (rays, memory) in queries.rays.outer_iter().zip(memory.outer_iter()) {
            let encoded = angle(rays.slice(s![.., 3..]));
            assert!(
                (encoded - angle(memory)).abs() < 1e-5,
                "memory and rays of different views"
            );
        }
        let mut decoded = Decoded {
            rotation_6d: Array2::zeros((objects, 6)),
            translation: Array2::zeros((objects, 3)),
            sigma: Array2::from_elem((objects, 2), 0.5),
        };
        for q in 0..objects {
            let line = |v: usize| {
                let numbers = queries.box_rays.slice(s![v, q, ..]);
                let vector = |i: usize| Vector3::from_fn(|row, _| f64::from(numbers[3 * i + row]));
                (vector(0), vector(1))
            };
            let off = |v: usize, point: &Vector3<f64>| {
                let (origin, direction) = line(v);
                (point - origin).cross(&direction).norm()
            };
            let nearest = |a: &&Vector3<f64>, b: &&Vector3<f64>| off(0, a).total_cmp(&off(0, b));
            let center = *self.in_cameras.iter().min_by(nearest).unwrap();
            assert_eq!(queries.valid[(0, q)], 1.0, "the anchor sees its objects");
            assert!(line(0).0.norm() < 1e-6, "the anchor is the origin");
            for v in 0..queries.valid.nrows() {
                if queries.valid[(v, q)] == 1.0 {
                    assert!(off(v, &center) < 1e-4, "a box of another object");
                } else {
                    assert!(
                        queries
                            .box_rays
                            .slice(s![v, q, ..])
                            .iter()
                            .all(|&x| x == 0.0)
                    );
                    assert_eq!(queries.centers.slice(s![v, q, ..]), array![0.5, 0.5]);
                    assert_eq!(queries.half_sizes.slice(s![v, q, ..]), array![0.0, 0.0]);
                }
            }
            for axis in 0..3 {
                decoded.translation[(q, axis)] = center[axis] as f32;
            }
            decoded.rotation_6d[(q, 0)] = 2.0;
            decoded.rotation_6d[(q, 4)] = 3.0;
        }
        (self.disorder)(&mut decoded);
        Ok(decoded)
    }

    fn provider(&self) -> &str {
        "geometry"
    }
}

fn images(rig: &Rig, cameras: &[usize]) -> Vec<(usize, RgbImage)> {
    let image = |&i: &usize| {
        (
            i,
            RgbImage::new(rig.cameras()[i].width(), rig.cameras()[i].height()),
        )
    };
    cameras.iter().map(image).collect()
}

/// - `seen`: for each image, the camera's index and the balls seen there
fn predict(rig: &Rig, seen: &[(usize, &[[f64; 3]])], options: &PredictOptions) -> Prediction {
    let estimator = Estimator::new(bundle(), Box::new(Geometry::new(rig, seen)));
    let cameras: Vec<usize> = seen.iter().map(|view| view.0).collect();
    estimator
        .predict(rig, &images(rig, &cameras), options)
        .unwrap()
}

fn assert_at(object: &ObjectPose, ball: [f64; 3]) {
    let off = (object.world_from_obj.translation.vector - Vector3::from(ball)).norm();
    assert!(off < 1e-5, "{off} m off");
}

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
    // Turned as their anchors: the reference where it sees them, else the first that does.
    for (object, anchor) in [(by_all, 0), (by_two, 1)] {
        let anchor = rig.cameras()[anchor].world_from_cam().rotation;
        assert!(object.world_from_obj.rotation.angle_to(&anchor) < 1e-6);
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
    let found = by_all.cameras[2].bbox.unwrap();
    let expected = ball_box(&rig.cameras()[2], first);
    assert!(
        found
            .iter()
            .zip(expected)
            .all(|(a, b)| (a - b).abs() < 1e-3),
        "{found:?}"
    );
}

/// Scores of the objects and the number of views that see each, best first.
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
    objects
        .map(|object| ((object.score * 1e3).round() / 1e3, views(object)))
        .collect()
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
    let given = known(&[("left", ball_box(&rig.cameras()[0], first))]);
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

fn known(boxes: &[(&str, [f64; 4])]) -> KnownBoxes {
    let boxes = boxes
        .iter()
        .map(|&(id, bbox)| (id.to_owned(), bbox))
        .collect();
    KnownBoxes {
        class: "ball".into(),
        boxes,
    }
}

#[test]
fn given_boxes_replace_the_detector() {
    let rig = rig();
    let [first, second] = BALLS;
    let bbox = |camera: usize, ball| ball_box(&rig.cameras()[camera], ball);
    let given = vec![
        known(&[("middle", bbox(1, second))]),
        // `right` gives no image, so its box is not used.
        known(&[
            ("left", bbox(0, first)),
            ("middle", bbox(1, first)),
            ("right", [0., 0., 9., 9.]),
        ]),
    ];
    let options = PredictOptions {
        boxes: Some(given),
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
fn arguments_that_do_not_fit_are_refused_in_one_sentence() {
    let rig = rig();
    let refusal = |images: &[(usize, RgbImage)], options: PredictOptions| {
        let seen: Vec<(usize, &[[f64; 3]])> =
            images.iter().map(|i| (i.0.min(2), &[][..])).collect();
        let estimator = Estimator::new(bundle(), Box::new(Geometry::new(&rig, &seen)));
        match estimator.predict(&rig, images, &options) {
            Err(Error::Input(problem)) => problem,
            other => panic!("expected a refusal, got {other:?}"),
        }
    };
    let plain = PredictOptions::default;
    assert!(refusal(&[], plain()).contains("at least one"));
    assert!(refusal(&images(&rig, &[1, 0, 1]), plain()).contains("`middle`: expected one image"));
    let wrong = [(0, RgbImage::new(240, 320))];
    assert!(refusal(&wrong, plain()).contains("320x240 px as in the rig, got 240x320"));
    assert!(refusal(&[(3, RgbImage::new(1, 1))], plain()).contains("the rig has 3"));

    let options = PredictOptions {
        reference: Some("top".into()),
        ..PredictOptions::default()
    };
    let problem = refusal(&images(&rig, &[0]), options);
    assert!(problem.contains("no camera `top`") && problem.contains("left, middle, right"));

    let options = PredictOptions {
        min_views: 2,
        ..PredictOptions::default()
    };
    let problem = refusal(&images(&rig, &[0]), options);
    assert!(
        problem.contains("at most 1, as there are images, got 2"),
        "{problem}"
    );

    let mut other_class = known(&[("left", [1., 1., 9., 9.])]);
    other_class.class = "cube".into();
    for (boxes, says) in [
        (
            other_class,
            "no class `cube` in the model, expected one of: ball",
        ),
        (known(&[("top", [1., 1., 9., 9.])]), "no camera `top`"),
        (
            known(&[("middle", [1., 1., 9., 9.])]),
            "at least one of the given images",
        ),
        (
            known(&[("left", [9., 1., 1., 9.])]),
            "camera `left`, got [9.0, 1.0, 1.0, 9.0]",
        ),
        (known(&[("left", [f64::NAN; 4])]), "camera `left`, got [NaN"),
        (known(&[("left", [400., 1., 500., 9.])]), "within the image"),
    ] {
        let options = PredictOptions {
            boxes: Some(vec![boxes]),
            ..PredictOptions::default()
        };
        let problem = refusal(&images(&rig, &[0]), options);
        assert!(
            problem.contains(says) && problem.contains("object 0"),
            "{problem}"
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
        error(|d| d.sigma[(1, 1)] = f32::INFINITY),
        Error::Pose(_)
    ));
    assert!(matches!(
        error(|d| d.rotation_6d.fill(0.0)),
        Error::Rotation6d(_)
    ));
    assert!(matches!(
        error(|d| d.rotation_6d = Array2::zeros((1, 6))),
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
