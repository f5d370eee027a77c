//! What one view has missed, the others bring back.

use super::closeups::{Triangulation, closeup_bundle};
use super::*;
use crate::bundle::SurfacePoint;
use crate::prediction::Sigma;

/// Expects less of an error the more views it is shown.
struct SurerWithViews(Triangulation);

impl Network for SurerWithViews {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        self.0.detect(images)
    }

    fn encode(&self, pictures: ArrayView4<f32>, rays: ArrayView3<f32>) -> Result<Encoded> {
        self.0.encode(pictures, rays)
    }

    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        let views = memory.dim().0 as f32;
        let mut decoded = self.0.decode(memory, queries)?;
        decoded.sigma[(0, 0)] = 12.0 / views;
        // Turned in the same way whichever view is the anchor: by where all cameras are.
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
        "surer with views"
    }
}

/// - `seen`: for cameras 0, 1, ... the balls seen there
/// - `change`: of the boxes of each view
fn found(
    points: Vec<SurfacePoint>,
    seen: &[&[[f64; 3]]],
    change: impl Fn(&mut [Vec<BBox>]),
) -> Vec<ObjectPose> {
    let rig = rig();
    let mut bundle = closeup_bundle();
    bundle.classes[0].points = points;
    let seen: Vec<(usize, &[[f64; 3]])> = seen.iter().copied().enumerate().collect();
    let cameras: Vec<usize> = (0..seen.len()).collect();
    let mut geometry = Geometry::new(&rig, &seen);
    change(&mut geometry.boxes);
    let network = SurerWithViews(Triangulation(geometry));
    let estimator = Estimator::new(bundle, Box::new(network));
    let images = images(&rig, &cameras);
    let prediction = estimator.predict(&rig, &images, &PredictOptions::default());
    prediction.unwrap().objects
}

/// Points of the ball, along its axes and the diagonals between them.
pub fn surface() -> Vec<SurfacePoint> {
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
    object
        .cameras
        .iter()
        .map(|seen| seen.bbox.is_some())
        .collect()
}

#[test]
fn an_object_that_two_views_have_settled_is_looked_for_in_the_third() {
    let [first, _] = BALLS;
    let seen: [&[[f64; 3]]; 3] = [&[first], &[first], &[]];
    let objects = found(surface(), &seen, |_| ());
    assert_eq!(objects.len(), 1);
    let expected = objects[0].sigma.rot_deg;
    assert!(
        (expected - 4.0).abs() < 0.01,
        "decoded from three views: {expected}"
    );
    // The middle of 26 points' extent is a little beside the ball's.
    let position = objects[0].world_from_obj.translation.vector;
    assert!((position - Vector3::from(first)).norm() < 0.02 * RADIUS);
    assert_eq!(
        views(&objects[0]),
        [true, true, false],
        "no detector saw it there"
    );
    // Of one view, and without points, nothing is known of where to look.
    assert_eq!(
        found(surface(), &[&[first], &[], &[]], |_| ())[0]
            .sigma
            .rot_deg,
        12.0
    );
    let expected = found(vec![], &seen, |_| ())[0].sigma.rot_deg;
    assert!((expected - 6.0).abs() < 0.01, "{expected}");
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
    // 0.38 of its width off, half of a ball hidden, it matches no line of sight.
    let objects = found(surface(), &seen, |boxes| shifted(boxes, 0.38));
    assert_eq!(objects.len(), 1);
    assert_eq!(views(&objects[0]), [true; 3]);
    // Clear of it, it is something else.
    let objects = found(surface(), &seen, |boxes| shifted(boxes, 1.2));
    assert_eq!(objects.len(), 2);
    assert_eq!(views(&objects[0]), [true, true, false]);
    assert_eq!(views(&objects[1]), [false, false, true]);
}

#[test]
fn what_one_view_alone_has_found_is_missed_by_the_others() {
    let rig = rig();
    let mut bundle = closeup_bundle();
    bundle.classes[0].points = surface();
    let images = images(&rig, &[0, 1, 2]);
    let views = view::gather(&bundle, &rig, &images).unwrap();
    let share = |place: [f64; 3], seen: [bool; 3]| {
        let bbox = [10.0, 10.0, 20.0, 20.0].into();
        let sighting = Sighting {
            class: 0,
            score: 0.5,
            boxes: seen.map(|seen| seen.then_some(bbox)).into(),
        };
        let pose = DecodedPose {
            world_from_obj: Isometry3::translation(place[0], place[1], place[2]),
            sigma: Sigma {
                rot_deg: 1.0,
                t_m: 0.01,
            },
            support: None,
            hypotheses: Vec::new(),
        };
        complete::share_of_views(&bundle.classes[0], &views, &sighting, &pose)
    };
    let [first, _] = BALLS;
    let third = share(first, [true, false, false]);
    assert!((third - 1.0 / 3.0).abs() < 1e-12, "{third}");
    assert_eq!(share(first, [true, true, false]), 1.0, "it is looked for");
    let beside = [first[0] + 100.0, first[1], first[2]];
    assert_eq!(share(beside, [true, false, false]), 1.0, "off the images");
}
