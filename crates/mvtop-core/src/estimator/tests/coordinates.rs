//! Networks with object coordinates, from images to poses: crops, coordinates, PnP, refinement, score.
//!
//! Images are painted so that each pixel's color says which point of the object it shows. So the network
//! need not know where the objects are: it reads the coordinates off the crops.

use std::sync::Mutex;

use super::*;
use crate::bundle::SurfacePoint;
use crate::consistency::extent;
use crate::mesh::Mesh;
use crate::pose::rotation_error_deg;
use crate::refine::tests as scene;

/// Half the sides of the brick, metres.
const HALF: [f64; 3] = [0.03, 0.04, 0.055];
const EXTENT: f64 = 0.06;
const CROP: u32 = 128;
/// Pixels of a crop along each side of a cell.
const CELL: usize = 4;
/// Radius of a ball that is no brick, metres.
const BALL: f64 = 0.045;

/// Steps of blue from one side of the brick to the next.
const BLUE: f64 = 38.0;

/// The color of a point of a side: red and green are the place on it, blue is its number.
fn color(side: usize, point: &Point3<f64>) -> [f64; 3] {
    let axis = side / 2;
    let share = |axis: usize| 128.0 + 60.0 * point[axis] / HALF[axis];
    [
        share((axis + 1) % 3),
        share((axis + 2) % 3),
        25.0 + BLUE * side as f64,
    ]
}

/// The point that has a color; `None` of a color between those of two sides, or of the background.
fn point_of(color: [f64; 3]) -> Option<Point3<f64>> {
    let number = (color[2] - 25.0) / BLUE;
    let side = number.round();
    let place = [0, 1].map(|i| (color[i] - 128.0) / 60.0);
    let known = (number - side).abs() < 0.08
        && (0.0..6.0).contains(&side)
        && place.iter().all(|x| x.abs() < 1.0);
    let (axis, sign) = (side as usize / 2, side % 2.0 * 2.0 - 1.0);
    let mut point = Point3::origin();
    point[axis % 3] = sign * HALF[axis % 3];
    for (n, share) in place.into_iter().enumerate() {
        let axis = (axis + 1 + n) % 3;
        point[axis] = share * HALF[axis];
    }
    known.then_some(point)
}

/// Where a ray leaves the surface of the brick that it comes from inside of, and the side there.
fn outward(direction: &Vector3<f64>) -> (usize, Point3<f64>) {
    let reach = |axis: &usize| HALF[*axis] / direction[*axis].abs();
    let axis = [0, 1, 2]
        .into_iter()
        .min_by(|a, b| reach(a).total_cmp(&reach(b)))
        .unwrap();
    let side = 2 * axis + usize::from(direction[axis] > 0.0);
    (side, Point3::from(direction * reach(&axis)))
}

#[derive(Clone, Copy, PartialEq)]
enum Shape {
    Brick,
    /// With the colors that a brick has in the same direction from its center.
    Ball,
}

/// A thing somewhere in the world.
type Thing = (Shape, Isometry3<f64>);

/// Distance and color of what a ray shows of a thing.
fn hit(thing: &Thing, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<(f64, [f64; 3])> {
    let (shape, pose) = thing;
    let (from, along) = (pose.inverse() * origin, pose.inverse() * direction);
    match shape {
        Shape::Brick => {
            let (mut near, mut far, mut side) = (0.0, f64::INFINITY, 0);
            for axis in 0..3 {
                let ends = [-1.0, 1.0].map(|end| (end * HALF[axis] - from[axis]) / along[axis]);
                let first = ends[0].min(ends[1]);
                if first > near {
                    near = first;
                    side = 2 * axis + usize::from(along[axis] < 0.0);
                }
                far = f64::min(far, ends[0].max(ends[1]));
            }
            (near < far && near > 0.0).then(|| (near, color(side, &(from + along * near))))
        }
        Shape::Ball => {
            let closest = -from.coords.dot(&along);
            let beside = from.coords.norm_squared() - closest * closest;
            let half = (BALL * BALL - beside).max(0.0).sqrt();
            (half > 0.0).then(|| {
                let (side, on_brick) = outward(&(from + along * (closest - half)).coords);
                (closest - half, color(side, &on_brick))
            })
        }
    }
}

fn painted(camera: &Camera, things: &[Thing]) -> RgbImage {
    const FINER: u32 = 2;
    let origin = Point3::from(camera.world_from_cam().translation.vector);
    RgbImage::from_fn(camera.width(), camera.height(), |u, v| {
        let mut sum = [0.0; 3];
        for n in 0..FINER * FINER {
            let part = |n: u32| (f64::from(n) + 0.5) / f64::from(FINER) - 0.5;
            let pixel = [
                f64::from(u) + part(n % FINER),
                f64::from(v) + part(n / FINER),
            ];
            let ray = camera.intrinsics().unproject(&pixel.into()).unwrap();
            let direction = camera.world_from_cam().rotation * ray.into_inner();
            let all = things
                .iter()
                .filter_map(|thing| hit(thing, &origin, &direction));
            let first = all.min_by(|a, b| a.0.total_cmp(&b.0));
            // Dark, with a little texture: an image of one color is warned of.
            let ground = 2.0 * f64::from((u / 7 + v / 5) % 3);
            let color = first.map_or([ground; 3], |(_, color)| color);
            (0..3).for_each(|channel| sum[channel] += color[channel]);
        }
        image::Rgb(sum.map(|x| (x / f64::from(FINER * FINER)).round() as u8))
    })
}

/// The brick, each side of one color.
fn mesh() -> Mesh {
    let sides: Vec<Mesh> = (0..6)
        .map(|side| {
            let middle = color(side, &Point3::origin()).map(|x| x as u8);
            scene::surface(1, 1, middle, |u, v| {
                let (axis, sign) = (side / 2, (side % 2) as f64 * 2.0 - 1.0);
                let mut at = Point3::origin();
                at[axis] = sign * HALF[axis];
                at[(axis + 1) % 3] = (2.0 * u - 1.0) * HALF[(axis + 1) % 3];
                at[(axis + 2) % 3] = (2.0 * v - 1.0) * HALF[(axis + 2) % 3];
                at
            })
        })
        .collect();
    scene::united(&sides)
}

/// Points all over the brick.
fn points() -> Vec<SurfacePoint> {
    let steps = || (0..13).map(|n| f64::from(n) / 6.0 - 1.0);
    let sides =
        (0..6).flat_map(move |side| steps().flat_map(move |a| steps().map(move |b| (side, a, b))));
    let point = |(side, a, b): (usize, f64, f64)| {
        let axis = side / 2;
        let mut at = Point3::origin();
        at[axis] = ((side % 2) as f64 * 2.0 - 1.0) * HALF[axis];
        at[(axis + 1) % 3] = a * HALF[(axis + 1) % 3];
        at[(axis + 2) % 3] = b * HALF[(axis + 2) % 3];
        SurfacePoint {
            position: at.coords.into(),
            color: color(side, &at).map(|x| x.round() as u8),
        }
    };
    sides.map(point).collect()
}

/// The class of the brick.
pub(super) fn brick() -> Class {
    Class {
        id: 3,
        name: "brick".into(),
        diameter_m: 2.0 * Vector3::from(HALF).norm(),
        symmetry: Symmetry::default(),
        mesh: Some(mesh()),
        coordinates_extent_m: Some(EXTENT),
        points: points(),
    }
}

/// Images of a brick at [`brick_pose`].
pub(super) fn painted_images(rig: &Rig) -> Vec<ViewImage> {
    let taken = rig.cameras().iter().enumerate();
    let image = |(camera, of)| ViewImage {
        camera,
        image: painted(of, &[(Shape::Brick, brick_pose())]),
    };
    taken.map(image).collect()
}

/// A network that decodes coordinates from colors, and whose detections are given.
struct Painted<'a> {
    /// Score and box, px of the image, of each view.
    seen: Vec<Vec<(f32, BBox)>>,
    letterboxes: Vec<Letterbox>,
    /// Number of crops of each call.
    crops: &'a Mutex<Vec<usize>>,
}

impl Network for Painted<'_> {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        let (h, w) = (NET.1 as usize / STRIDE, NET.0 as usize / STRIDE);
        assert_eq!(images.dim().0, self.seen.len());
        let mut maps = DetectorMaps {
            scores: Array4::zeros((self.seen.len(), 1, h, w)),
            boxes: Array4::zeros((self.seen.len(), 4, h, w)),
        };
        for (v, seen) in self.seen.iter().enumerate() {
            for &(score, bbox) in seen {
                let bbox = self.letterboxes[v].net_box(bbox);
                let [column, row] = [bbox.center().x, bbox.center().y].map(|x| x as usize / STRIDE);
                maps.scores[(v, 0, row, column)] = score;
                for (side, value) in <[f64; 4]>::from(bbox).into_iter().enumerate() {
                    maps.boxes[(v, side, row, column)] = value as f32;
                }
            }
        }
        Ok(maps)
    }

    fn coordinates(&self, pictures: ArrayView4<f32>) -> Result<Array4<f32>> {
        let count = pictures.dim().0;
        self.crops.lock().unwrap().push(count);
        let cells = CROP as usize / CELL;
        let mut coordinates = Array4::zeros((count, 4, cells, cells));
        for (picture, mut codes) in pictures.outer_iter().zip(coordinates.outer_iter_mut()) {
            for (row, column) in (0..cells * cells).map(|n| (n / cells, n % cells)) {
                // The middle of a cell lies between four pixels.
                let at = |start: usize| start * CELL + CELL / 2 - 1..start * CELL + CELL / 2 + 1;
                let shown = picture.slice(s![.., at(row), at(column)]);
                let mean = |channel| {
                    let of = shown.index_axis(ndarray::Axis(0), channel);
                    (f64::from(of.mean().unwrap()) * 0.25 + 0.5) * 255.0
                };
                if let Some(point) = point_of([0, 1, 2].map(mean)) {
                    (0..3).for_each(|axis| {
                        codes[(axis, row, column)] = (point[axis] / EXTENT) as f32
                    });
                    codes[(3, row, column)] = 1.0;
                }
            }
        }
        Ok(coordinates)
    }

    fn provider(&self) -> &str {
        "painted"
    }
}

pub(super) fn cameras() -> Vec<Camera> {
    let named = |(n, degrees): (usize, f64)| {
        let camera = scene::camera(degrees);
        let size = [camera.width(), camera.height()];
        let id = ["a", "b", "c"][n];
        Camera::new(
            id,
            size,
            camera.intrinsics().clone(),
            *camera.world_from_cam(),
        )
        .unwrap()
    };
    [0.0, 60.0, 130.0]
        .into_iter()
        .enumerate()
        .map(named)
        .collect()
}

pub(super) fn brick_pose() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.7, -1.1, 0.4));
    Isometry3::from_parts(Translation3::new(0.01, -0.08, 0.005), turn)
}

fn ball_pose() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(-0.3, 0.2, 1.0));
    Isometry3::from_parts(Translation3::new(-0.01, 0.08, 0.0), turn)
}

/// What is predicted of a brick and a ball, and the number of crops of each call of the network.
///
/// - `scores`: the detector's, of the brick in each view
fn found(scores: [f32; 3], with_ball: bool, options: &PredictOptions) -> (Prediction, Vec<usize>) {
    let rig = Rig::new(cameras(), 0).unwrap();
    let points = points();
    let round: Vec<SurfacePoint> = super::doubts::sphere()
        .into_iter()
        .map(|one| SurfacePoint {
            position: one.position.map(|x| x * BALL / RADIUS),
            ..one
        })
        .collect();
    let mut things = vec![(Shape::Brick, brick_pose())];
    things.extend(with_ball.then_some((Shape::Ball, ball_pose())));
    let taken = rig.cameras().iter().enumerate();
    let images: Vec<ViewImage> = taken
        .map(|(camera, of)| ViewImage {
            camera,
            image: painted(of, &things),
        })
        .collect();
    let crops: &'static Mutex<Vec<usize>> = Box::leak(Box::default());
    let seen = |(camera, score): (&Camera, f32)| {
        let brick = (score, extent(&points, camera, &brick_pose()).unwrap());
        let ball = (0.85, extent(&round, camera, &ball_pose()).unwrap());
        [Some(brick), with_ball.then_some(ball)]
            .into_iter()
            .flatten()
            .collect()
    };
    let letterbox = |c: &Camera| Letterbox::new(c.width(), c.height(), NET.0, NET.1);
    let network = Painted {
        seen: rig.cameras().iter().zip(scores).map(seen).collect(),
        letterboxes: rig.cameras().iter().map(letterbox).collect(),
        crops,
    };
    let bundle = Bundle {
        classes: vec![brick()],
        closeups: CloseUps {
            size: CROP,
            ..bundle().closeups
        },
        decoder: None,
        ..bundle()
    };
    let estimator = Estimator::new(bundle, Box::new(network));
    let prediction = estimator.predict(&rig, &images, options).unwrap();
    (prediction, crops.lock().unwrap().clone())
}

/// Degrees and metres.
fn off(object: &ObjectPose) -> (f64, f64) {
    let pose = &object.world_from_obj;
    let shift = pose.translation.vector - brick_pose().translation.vector;
    (
        rotation_error_deg(&pose.rotation, &brick_pose().rotation),
        shift.norm(),
    )
}

/// One term of the evidence, by view that should show the object.
fn by_view(object: &ObjectPose, term: &str) -> Vec<f64> {
    let at = crate::scorer::VIEW_TERMS
        .iter()
        .position(|name| *name == term)
        .unwrap();
    let views = &object.evidence.as_ref().unwrap().views;
    views.iter().map(|view| view.terms()[at]).collect()
}

#[test]
fn coordinates_give_the_pose() {
    let plain = PredictOptions::default();
    let network_alone = PredictOptions {
        refine: Some(false),
        ..PredictOptions::default()
    };
    for options in [&plain, &network_alone] {
        let (prediction, crops) = found([0.9; 3], false, options);
        let [object] = &prediction.objects[..] else {
            panic!("{:?}", prediction.objects)
        };
        let (turned, moved) = off(object);
        assert!(turned < 1.0 && moved < 2e-3, "{turned} degrees, {moved} m");
        assert_eq!(object.refinement.is_some(), options.refine.is_none());
        // The boxes are where the pose projects: no further crops.
        assert_eq!(crops, [3]);
        assert!(
            object.coordinate_inliers.unwrap() > 0.6,
            "{:?}",
            object.coordinate_inliers
        );
        assert_eq!(prediction.warnings, []);
    }
}

#[test]
fn a_view_whose_detector_missed_the_object_is_evidence() {
    // Too faint to be a box.
    let (prediction, crops) = found([0.9, 0.8, 0.2], false, &PredictOptions::default());
    let [object] = &prediction.objects[..] else {
        panic!("{:?}", prediction.objects)
    };
    let (turned, moved) = off(object);
    assert!(turned < 1.0 && moved < 2e-3, "{turned} degrees, {moved} m");
    assert_eq!(object.cameras[2].bbox, None);
    // Two crops of boxes, then three where the pose projects.
    assert_eq!(crops, [2, 3]);
    let detector = by_view(object, "detector");
    assert_eq!(detector.len(), 3);
    let expected = [0.9, 0.8, 0.2];
    assert!(
        detector
            .iter()
            .zip(expected)
            .all(|(a, b)| (a - b).abs() < 1e-6),
        "{detector:?}"
    );
    for term in ["coordinates", "contour"] {
        let shown = by_view(object, term);
        assert!(shown.iter().all(|x| *x > 0.5), "{term}: {shown:?}");
    }
}

#[test]
fn a_thing_of_another_shape_scores_lower() {
    let (prediction, _) = found([0.9; 3], true, &PredictOptions::default());
    let middle = |pose: &Isometry3<f64>| pose.translation.vector;
    let at = |place: Isometry3<f64>| {
        let near =
            |object: &&ObjectPose| (middle(&object.world_from_obj) - middle(&place)).norm() < 0.04;
        prediction.objects.iter().find(near)
    };
    let brick = at(brick_pose()).unwrap();
    let (turned, moved) = off(brick);
    assert!(turned < 1.0 && moved < 2e-3, "{turned} degrees, {moved} m");
    let log_odds = |object: &ObjectPose| object.evidence.as_ref().unwrap().log_odds;
    // No pose of a brick explains what a ball shows, or it is the worse one.
    if let Some(ball) = at(ball_pose()) {
        let (right, wrong) = (log_odds(brick), log_odds(ball));
        assert!(right > wrong + 2.0, "{right} {wrong}");
        let shown = |object: &ObjectPose| by_view(object, "contour").iter().sum::<f64>();
        assert!(shown(brick) > shown(ball));
    }
    assert!(prediction.objects.len() <= 2);
}
