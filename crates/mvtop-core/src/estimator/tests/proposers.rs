//! Further candidates of instances that are not settled.

use std::sync::Mutex;

use super::*;
use crate::bundle::SurfacePoint;
use crate::detect::Detection;
use crate::estimator::instance::{Candidate, Instance};
use crate::estimator::pipeline::Pipeline;
use crate::estimator::proposals::turned;
use crate::image::Pyramid;
use crate::pose::rotation_error_deg;
use crate::prediction::Sigma;
use crate::refine::Refiner;
use crate::refine::tests::{Draw, camera, cuboid, seen, views_of};
use crate::scorer::Scored;

/// Notes how many crops it is shown at once, and turns objects the same way whichever view is the
/// anchor: by where all cameras are.
struct Noting<'a> {
    network: Geometry,
    crops: &'a Mutex<Vec<usize>>,
}

impl Network for Noting<'_> {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        self.network.detect(images)
    }

    fn encode(&self, pictures: ArrayView4<f32>, rays: ArrayView3<f32>) -> Result<Array3<f32>> {
        self.crops.lock().unwrap().push(pictures.dim().0);
        self.network.encode(pictures, rays)
    }

    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        let views = memory.dim().0 as f32;
        let mut decoded = self.network.decode(memory, queries)?;
        let origins: Vec<Vector3<f32>> = queries
            .box_rays
            .outer_iter()
            .map(|line| Vector3::from_fn(|axis, _| line[(0, axis)]))
            .collect();
        if origins.len() > 1 {
            let center = Vector3::from_fn(|axis, _| decoded.translation[(0, axis)]);
            let mean = origins.iter().sum::<Vector3<f32>>() / views;
            let far = |a: &&Vector3<f32>, b: &&Vector3<f32>| {
                (*a - center).norm().total_cmp(&(*b - center).norm())
            };
            let farthest = origins.iter().max_by(far).unwrap() - center;
            for axis in 0..3 {
                decoded.rotation_6d[(0, axis)] = (center - mean)[axis];
                decoded.rotation_6d[(0, axis + 3)] = farthest[axis];
            }
        }
        Ok(decoded)
    }

    fn provider(&self) -> &str {
        "noting"
    }
}

/// What is found, and the number of crops of each call of the encoder.
///
/// - `seen`: for cameras 0, 1, ... the balls seen there
/// - `change`: of the boxes of each view
fn found(
    points: Vec<SurfacePoint>,
    seen: &[&[[f64; 3]]],
    options: &PredictOptions,
    change: impl Fn(&mut [Vec<BBox>]),
) -> (Vec<ObjectPose>, Vec<usize>) {
    let rig = rig();
    let mut bundle = bundle();
    bundle.classes[0].points = points;
    let seen: Vec<(usize, &[[f64; 3]])> = seen.iter().copied().enumerate().collect();
    let cameras: Vec<usize> = (0..seen.len()).collect();
    let mut geometry = Geometry::new(&rig, &seen);
    change(&mut geometry.boxes);
    let crops: &'static Mutex<Vec<usize>> = Box::leak(Box::default());
    let network = geometry;
    let estimator = Estimator::new(bundle, Box::new(Noting { network, crops }));
    let prediction = estimator.predict(&rig, &images(&rig, &cameras), options);
    (prediction.unwrap().objects, crops.lock().unwrap().clone())
}

/// Points of the ball, along its axes and the diagonals between them.
pub(super) fn surface() -> Vec<SurfacePoint> {
    let steps = [-1.0, 0.0, 1.0];
    let corners = steps.map(|x| steps.map(|y| steps.map(|z| Vector3::new(x, y, z))));
    let directions = corners.into_iter().flatten().flatten();
    directions
        .filter_map(|direction| direction.try_normalize(0.5))
        .map(|unit| SurfacePoint {
            position: (unit * RADIUS).into(),
            color: [0; 3],
        })
        .collect()
}

fn views(object: &ObjectPose) -> Vec<bool> {
    let seen = object.cameras.iter().map(|seen| seen.bbox.is_some());
    seen.collect()
}

#[test]
fn a_view_that_missed_an_object_gets_a_crop_of_it() {
    let [first, _] = BALLS;
    let plain = PredictOptions::default();
    let seen: [&[[f64; 3]]; 3] = [&[first], &[first], &[]];
    let (objects, crops) = found(surface(), &seen, &plain, |_| ());
    assert_eq!(crops, [2, 3]);
    assert_eq!(objects.len(), 1);
    let position = objects[0].world_from_obj.translation.vector;
    assert!((position - Vector3::from(first)).norm() < 0.02 * RADIUS);
    assert_eq!(
        views(&objects[0]),
        [true, true, false],
        "a crop is no detection"
    );
    // Two views that missed it get one, too.
    let one: [&[[f64; 3]]; 3] = [&[first], &[], &[]];
    let (objects, crops) = found(surface(), &one, &plain, |_| ());
    assert_eq!((objects.len(), crops), (1, vec![1, 3]));
    assert_eq!(views(&objects[0]), [true, false, false]);
    // Of one image, and without points, nothing is known of where to look.
    assert_eq!(found(surface(), &one[..1], &plain, |_| ()).1, [1]);
    assert_eq!(found(vec![], &seen, &plain, |_| ()).1, [2]);
}

#[test]
fn given_boxes_are_not_replaced() {
    let rig = rig();
    let [first, _] = BALLS;
    let bbox = |camera: usize| ball_box(&rig.cameras()[camera], first);
    let options = PredictOptions {
        boxes: Some(vec![given(&[("left", bbox(0)), ("middle", bbox(1))])]),
        ..PredictOptions::default()
    };
    let (objects, crops) = found(surface(), &[&[], &[], &[]], &options, |_| ());
    assert_eq!((objects.len(), crops), (1, vec![2]));
    assert_eq!(views(&objects[0]), [true, true, false]);
}

#[test]
fn a_box_beside_its_line_of_sight_is_not_another_object() {
    let [first, _] = BALLS;
    let seen: [&[[f64; 3]]; 3] = [&[first], &[first], &[first]];
    let shifted = |boxes: &mut [Vec<BBox>], by: f64| {
        let bbox = &mut boxes[2][0];
        let shift = by * bbox.width();
        (bbox.x0, bbox.x1) = (bbox.x0 + shift, bbox.x1 + shift);
    };
    let plain = PredictOptions::default();
    // 0.38 of its width off, half of a ball hidden, it matches no line of sight.
    let (objects, _) = found(surface(), &seen, &plain, |boxes| shifted(boxes, 0.38));
    assert_eq!(objects.len(), 1);
    assert_eq!(views(&objects[0]), [true; 3]);
    // Clear of it, it is something else.
    let (objects, _) = found(surface(), &seen, &plain, |boxes| shifted(boxes, 1.2));
    let mut seen: Vec<Vec<bool>> = objects.iter().map(views).collect();
    seen.sort();
    assert_eq!(seen, [[false, false, true], [true, true, false]]);
}

#[test]
fn rolled_crops_look_at_the_best_pose() {
    let rig = rig();
    let mut bundle = bundle();
    bundle.classes[0].points = surface();
    let [ball, _] = BALLS;
    let network = Geometry::new(&rig, &[(0, &[ball]), (1, &[ball])]);
    let estimator = Estimator::new(bundle, Box::new(network));
    let (images, options) = (images(&rig, &[0, 1]), PredictOptions::default());
    let network = estimator.network.as_ref();
    let pipeline = Pipeline::new(&estimator, network, &rig, &images, &options).unwrap();
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.002,
    };
    let roi = Some(ball_box(&rig.cameras()[0], ball));
    let candidate = |rois: Vec<Option<BBox>>| Candidate {
        world_from_obj: Isometry3::translation(ball[0], ball[1], ball[2]),
        sigma,
        initial_sigma: sigma,
        prior: 1.0,
        rois,
        correspondences: None,
        refinement: None,
        scored: Scored::default(),
    };
    let mut instance = Instance {
        class: 0,
        detections: roi
            .map(|bbox| {
                let (class, score) = (0, 0.9);
                Detection { class, score, bbox }
            })
            .into_iter()
            .map(Some)
            .chain([None])
            .collect(),
        candidates: vec![candidate(vec![roi, roi])],
        excluded: Vec::new(),
    };
    let rolls = &estimator.config.search.rolls_deg;
    let requests = pipeline.rolled(0, &instance);
    assert_eq!(requests.len(), rolls.len());
    for (request, degrees) in requests.iter().zip(rolls) {
        let views: Vec<usize> = request.taken.iter().map(|(view, ..)| *view).collect();
        assert_eq!(views, [0, 1]);
        for (view, _, closeup) in &request.taken {
            let world_from_cam = rig.cameras()[*view].world_from_cam();
            let ahead = world_from_cam.inverse() * Point3::from(ball);
            let close_from_cam =
                UnitQuaternion::rotation_between(&ahead.coords, &Vector3::z()).unwrap();
            let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -degrees.to_radians());
            let expected = world_from_cam.rotation * close_from_cam.inverse() * roll;
            let off = closeup.camera.world_from_cam().rotation.angle_to(&expected);
            assert!(off.to_degrees() < 1.0, "{degrees}: {}", off.to_degrees());
        }
    }
    // Views without a crop get none.
    instance.candidates = vec![candidate(vec![None, roi])];
    let requests = pipeline.rolled(0, &instance);
    assert!(
        requests
            .iter()
            .all(|request| request.taken.len() == 1 && request.taken[0].0 == 1)
    );
    instance.candidates.clear();
    assert!(pipeline.rolled(0, &instance).is_empty());
}

#[test]
fn turned_poses_lie_on_all_sides_of_a_pose_and_keep_the_center() {
    let pose = Isometry3::new(Vector3::new(0.3, 0.1, 1.2), Vector3::new(0.5, -1.0, 0.2));
    let center = Point3::new(0.02, -0.01, 0.05);
    let all = turned(&pose, center, 10.0);
    for one in &all {
        assert!((one * center - pose * center).norm() < 1e-12);
        assert!((rotation_error_deg(&one.rotation, &pose.rotation) - 10.0).abs() < 1e-6);
    }
    let pairs = (0..all.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
    for (a, b) in pairs {
        assert!(rotation_error_deg(&all[a].rotation, &all[b].rotation) > 10.0);
    }
}

#[test]
fn turned_poses_reach_what_refinement_alone_does_not() {
    let cameras = [0.0, 70.0].map(camera);
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.15);
    let mut draw = Draw(9);
    let (mut alone, mut reached) = (0, 0);
    for draws in 0..18 {
        let degrees = [40_f64, 50.0, 60.0][draws % 3];
        let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
        let images = [0, 1].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
        let pyramids = images.each_ref().map(Pyramid::new);
        let views = views_of(&cameras, &pyramids);
        let start = truth * draw.rotation(degrees.to_radians());
        let right = |start: &Isometry3<f64>| {
            let sigma = Sigma {
                rot_deg: 10.0,
                t_m: 0.003,
            };
            let found = refiner.refine(&views, start, sigma);
            let pose = found.unwrap().world_from_obj;
            rotation_error_deg(&pose.rotation, &truth.rotation) < 2.0
        };
        let own = right(&start);
        alone += u32::from(own);
        let any = turned(&start, refiner.center(), 10.0).iter().any(right);
        reached += u32::from(own || any);
    }
    assert!(reached > alone, "of 18: {reached}, {alone} alone");
}
