//! Calibrations that are wrong are warned of.

use super::closeups::{Triangulation, closeup_bundle};
use super::*;
use crate::bundle::SurfacePoint;
use crate::consistency::extent;
use crate::prediction::WarningCode;

/// Puts an object where its lines of sight meet, and what one view sees as far away as its size tells.
struct BySize(Triangulation);

impl Network for BySize {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        self.0.detect(images)
    }

    fn encode(&self, pictures: ArrayView4<f32>, rays: ArrayView3<f32>) -> Result<Encoded> {
        self.0.encode(pictures, rays)
    }

    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        let mut decoded = self.0.decode(memory, queries)?;
        if memory.dim().0 == 1 {
            let numbers = queries.box_rays.slice(s![0, 0, ..]);
            let half_width = numbers.slice(s![6..9]).mapv(|x| x * x).sum().sqrt() / 10.0;
            let distance = RADIUS as f32 / half_width;
            let place = numbers.slice(s![3..6]).mapv(|x| x * distance);
            decoded.translation.row_mut(0).assign(&place);
        }
        Ok(decoded)
    }

    fn provider(&self) -> &str {
        "by size"
    }
}

/// Points all over the ball.
fn sphere() -> Vec<SurfacePoint> {
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
    let mut bundle = closeup_bundle();
    bundle.classes[0].points = points;
    let estimator = Estimator::new(bundle, Box::new(BySize(Triangulation(geometry))));
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
    let says = ["is seen along lines that miss each other", "camera `right`"];
    let all = says.iter().all(|part| warning.message.contains(part));
    assert!(all, "{}", warning.message);
    assert_eq!(prediction.rig_consistency.unwrap().worst_camera, Some(2));
    // The network expects 10 mm; 8.7 px at 1.7 m are 30 mm, shared between the lines.
    let sigma = prediction.objects[0].sigma.t_m;
    assert!((0.011..0.03).contains(&sigma), "{sigma}");
    assert!((told(&seen, &rig()).objects[0].sigma.t_m - 0.01).abs() < 1e-6);
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
    assert!(message.contains("by 12 %"), "{message}");
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
    assert_eq!(prediction.objects.len(), 2);
    assert_eq!(codes(&prediction), [WarningCode::ViewsContradict]);
    assert!(prediction.rig_consistency.is_none());
    // OpenGL's axes: both look away from the balls.
    let half = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
    let opengl = rig().moved(|_, camera| camera.world_from_cam() * half);
    let prediction = told(&seen, &opengl.unwrap());
    assert_eq!(codes(&prediction), [WarningCode::NothingMatches]);
}

#[test]
fn rig_on_which_an_object_agrees_is_not_doubted_for_what_single_views_find() {
    let [first, second] = BALLS;
    // In sight of both cameras, but on no line of sight to the second ball.
    let third = [second[0], second[1] + 0.25, second[2]];
    assert_eq!(
        codes(&told(&[&[second], &[third]], &rig())),
        [WarningCode::ViewsContradict]
    );
    let prediction = told(&[&[first, second], &[first, third]], &rig());
    assert_eq!(prediction.objects.len(), 1);
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
