//! More looks at what is hardly seen.

use std::cell::RefCell;

use super::closeups::{Triangulation, closeup_bundle};
use super::completed::surface;
use super::*;
use crate::estimator::pass::Pass;
use crate::estimator::refined::{Looks, on_images};
use crate::estimator::rolled::ROLLS_DEG;
use crate::estimator::view::View;
use crate::pose::rotation_error_deg;
use crate::prediction::{Hypothesis, Sigma};
use crate::refine::tests as scene;

#[test]
fn each_look_is_decoded_from_closeups_of_its_own() {
    let rig = rig();
    let mut bundle = closeup_bundle();
    bundle.classes[0].points = surface();
    let [ball, _] = BALLS;
    let network = Triangulation(Geometry::new(&rig, &[(0, &[ball]), (1, &[ball])]));
    let estimator = Estimator::new(bundle, Box::new(network));
    let (images, options) = (images(&rig, &[0, 1]), PredictOptions::default());
    let network = estimator.network.as_ref();
    let pass = Pass::new(&estimator, network, &rig, &images, &options).unwrap();
    let PoseInput::CloseUps(closeups) = &estimator.bundle.poses else {
        unreachable!("closeup_bundle has close-ups");
    };
    let object = |ball| Sighting {
        class: 0,
        score: 0.9,
        boxes: [0, 1]
            .map(|n| Some(ball_box(&rig.cameras()[n], ball)))
            .to_vec(),
    };
    let objects = BALLS.map(object);
    let place = |n: usize| {
        (
            &objects[n],
            Isometry3::translation(BALLS[n][0], BALLS[n][1], BALLS[n][2]),
        )
    };
    let looks = pass.rolled_looks(closeups, &[place(1), place(0)]).unwrap();
    assert_eq!(looks.len(), 2);
    for (looks, ball) in looks.iter().zip([BALLS[1], BALLS[0]]) {
        assert_eq!(looks.len(), ROLLS_DEG.len());
        // Each answer is turned as its anchor's close-up.
        let turns = rig.cameras()[..2].iter().map(|camera| {
            let ahead = camera.world_from_cam().inverse() * Point3::from(ball);
            let close_from_cam =
                UnitQuaternion::rotation_between(&ahead.coords, &Vector3::z()).unwrap();
            camera.world_from_cam().rotation * close_from_cam.inverse()
        });
        let turns: Vec<UnitQuaternion<f64>> = turns.collect();
        for (pose, degrees) in looks.iter().zip(ROLLS_DEG) {
            let off = pose.world_from_obj.translation.vector - Vector3::from(ball);
            assert!(off.norm() < 5e-3, "{off}");
            let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -degrees.to_radians());
            let expected: Vec<_> = turns.iter().map(|turn| turn * roll).collect();
            let near = |turn: &UnitQuaternion<f64>| {
                rotation_error_deg(&pose.world_from_obj.rotation, turn) < 1.0
            };
            assert!(expected.iter().any(near), "{degrees}");
        }
    }
}

fn decoded(poses: &[(Isometry3<f64>, f64)]) -> DecodedPose {
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.002,
    };
    let one = |(world_from_obj, probability): &(Isometry3<f64>, f64)| Hypothesis {
        world_from_obj: *world_from_obj,
        sigma,
        probability: *probability,
    };
    DecodedPose {
        world_from_obj: poses[0].0,
        sigma,
        support: None,
        hypotheses: poses.iter().map(one).collect(),
    }
}

/// The ball, seen from two sides, refined from a pose, with a look that says another; degrees that
/// the result is off, and the places that were asked for.
fn refined(
    start_deg: f64,
    look_deg: &[(f64, f64)],
    known: Option<f64>,
) -> (DecodedPose, f64, Vec<Isometry3<f64>>) {
    let mesh = scene::ball();
    let cameras = [0.0, 70.0].map(scene::camera);
    let mut draw = scene::Draw(4);
    // The green knob towards the first camera, the red one between both.
    let turn = UnitQuaternion::from_euler_angles(0.3, 1.2, 0.0);
    let truth = Isometry3::from_parts(Translation3::identity(), turn);
    let turned = |degrees: f64| {
        let axis = Vector3::new(0.6, 0.0, 0.8) * degrees.to_radians();
        truth * UnitQuaternion::from_scaled_axis(axis)
    };
    let images = [0, 1].map(|view| {
        let blue = RgbImage::from_pixel(scene::SIDE, scene::SIDE, image::Rgb([40, 60, 130]));
        scene::seen_before(blue, &mesh, &cameras[view], &truth, &mut draw)
    });
    let mut bundle = closeup_bundle();
    bundle.classes[0].diameter_m = 0.13;
    let view = |index: usize| View {
        index,
        camera: &cameras[index],
        image: &images[index],
        letterbox: Letterbox::new(scene::SIDE, scene::SIDE, NET.0, NET.1),
    };
    let views = [view(0), view(1)];
    let sighting = Sighting {
        class: 0,
        score: 0.9,
        boxes: vec![Some([140.0, 140.0, 340.0, 340.0].into()); 2],
    };
    let pose = DecodedPose {
        support: known,
        ..decoded(&[(turned(start_deg), 1.0)])
    };
    let mut found = [(sighting, pose)];
    let asked = RefCell::new(Vec::new());
    let poses: Vec<_> = look_deg
        .iter()
        .map(|&(degrees, p)| (turned(degrees), p))
        .collect();
    let looks: &Looks = &|places| {
        asked
            .borrow_mut()
            .extend(places.iter().map(|(_, place)| *place));
        Ok(vec![vec![decoded(&poses)]; places.len()])
    };
    let refiners = [Some(Refiner::new(&mesh, 0.13))];
    let refinements = on_images(&refiners, &views, &bundle, &mut found, Some(looks)).unwrap();
    assert!(refinements[0].is_some());
    let [(_, pose)] = found;
    let off = rotation_error_deg(&pose.world_from_obj.rotation, &truth.rotation);
    (pose, off, asked.into_inner())
}

#[test]
fn what_the_first_look_has_wrong_another_one_has_right() {
    let (_, off, asked) = refined(90.0, &[(4.0, 0.3), (150.0, 0.7)], None);
    assert_eq!(asked.len(), 1);
    assert!(off < 2.0, "{off}");
    // Probabilities are of all looks together, and poses that are led to the same place are one.
    let (pose, off, _) = refined(90.0, &[(6.0, 0.5), (-6.0, 0.5)], None);
    assert!(off < 2.0, "{off}");
    let total: f64 = pose.hypotheses.iter().map(|one| one.probability).sum();
    assert!((total - 1.0).abs() < 1e-9);
    let near = |pose: &Isometry3<f64>, other: &Isometry3<f64>| {
        pose.rotation.angle_to(&other.rotation) < 0.08
    };
    for (n, one) in pose.hypotheses.iter().enumerate() {
        let mut others = pose.hypotheses[..n].iter();
        assert!(!others.any(|other| near(&one.world_from_obj, &other.world_from_obj)));
    }
}

#[test]
fn what_is_seen_well_or_told_by_coordinates_is_not_looked_at_again() {
    let (_, off, asked) = refined(3.0, &[(90.0, 1.0)], None);
    assert!(asked.is_empty() && off < 2.0, "{off}");
    let (_, _, asked) = refined(90.0, &[(4.0, 1.0)], Some(0.5));
    assert!(asked.is_empty());
}
