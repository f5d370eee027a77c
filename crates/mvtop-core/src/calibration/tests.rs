use image::RgbImage;
use nalgebra::{Matrix6, Point3, UnitQuaternion, Vector3};

use super::*;
use crate::pose::{rotation_error_deg, translation_error};
use crate::refine::Refiner;
use crate::refine::tests::{Draw, camera, cuboid, seen};

/// What a view tells of an object: px by radians of turns and metres of shifts, camera frame.
const EDGES: [f64; 6] = [30.0, 30.0, 60.0, 900.0, 900.0, 120.0];

/// Three cameras 0.6 m from the origin that look at it.
fn rig() -> Rig {
    Rig::new([0.0, 45.0, 90.0].map(camera).to_vec(), 0).unwrap()
}

/// How one camera stands otherwise to another in two rigs, degrees and metres.
fn between(a: &Rig, b: &Rig, pair: [usize; 2]) -> (f64, f64) {
    let [a, b] = [a, b].map(|rig| {
        let [from, to] = pair.map(|i| *rig.cameras()[i].world_from_cam());
        from.inv_mul(&to)
    });
    let turned = rotation_error_deg(&a.rotation, &b.rotation);
    (turned, translation_error(&a, &b))
}

/// One camera turned about its y axis and moved along its x axis, by degrees and metres.
fn with_off(rig: &Rig, index: usize, degrees: f64, x: f64) -> Rig {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), degrees.to_radians());
    let motion = Isometry3::from_parts(Vector3::new(x, 0.0, 0.0).into(), turn);
    rig.moved(|i, camera| match i == index {
        true => camera.world_from_cam() * motion,
        false => *camera.world_from_cam(),
    })
    .unwrap()
}

/// What is told of `given` by views of three sets of four objects that see these off by `noise` px in
/// each direction; `wrong` of them see something else.
fn observed(truth: &Rig, given: &Rig, noise: f64, wrong: usize, draw: &mut Draw) -> Observed {
    let (mut sightings, mut objects) = (Vec::new(), Vec::new());
    for object in 0..12 {
        let at = draw.direction() * 0.15;
        let world_from_obj = Isometry3::from_parts(at.into(), draw.rotation(3.0));
        for (camera, pose) in cams_from_world(truth).iter().enumerate() {
            let px = |draw: &mut Draw| draw.direction() * (noise * 3f64.sqrt());
            let (turn, shift) = (px(draw), px(draw));
            let mut seen = pose * world_from_obj;
            let turn = Vector3::from_fn(|i, _| turn[i] / EDGES[i]);
            seen.rotation = UnitQuaternion::from_scaled_axis(turn) * seen.rotation;
            let shift = Vector3::from_fn(|i, _| shift[i] / EDGES[3 + i]);
            seen.translation.vector += shift;
            if camera == 1 && object < wrong {
                seen.translation.x += 0.1;
            }
            sightings.push(Sighting {
                camera,
                object,
                cam_from_obj: seen,
                edges: Matrix6::from_diagonal(&Vector6::from(EDGES).map(|px| px * px)),
            });
        }
        objects.push(Object {
            world_from_obj,
            center: Point3::origin(),
        });
    }
    let scene = Scene {
        cams_from_world: cams_from_world(given),
        objects,
        outwards: 0.0,
    };
    let expected = Expected::default();
    let all = vec![expected; given.cameras().len()];
    Observed {
        adjusted: adjusted(&cams_from_world(given), &all, scene, &sightings, 100.0).unwrap(),
        given: given.clone(),
        expected,
        sightings,
        set_of: (0..12).map(|object| object / 4).collect(),
    }
}

#[test]
fn true_rig_is_left_alone_and_what_it_is_off_by_is_as_expected() {
    let (truth, mut draw) = (rig(), Draw(7));
    for _ in 0..40 {
        let observed = observed(&truth, &truth, 0.4, 0, &mut draw);
        assert!(observed.off().cameras.is_empty(), "{:?}", observed.off());
        for correction in observed.corrections(0) {
            assert!(correction.is_told(), "{correction:?}");
            // Edges err by no more than is believed of them.
            assert!(correction.deviation < 4.0, "{correction:?}");
        }
    }
}

#[test]
fn camera_that_is_off_is_named_and_moved_back_alone() {
    let truth = rig();
    let mut draw = Draw(3);
    // The reference camera is not above suspicion.
    for wrong in [0, 1, 2] {
        for (degrees, x) in [(2.0, 0.0), (0.0, 0.02), (5.0, 0.0), (-1.0, 0.02)] {
            let given = with_off(&truth, wrong, degrees, x);
            let observed = observed(&truth, &given, 0.2, 0, &mut draw);
            let off = observed.off();
            assert!(off.is_told && off.cameras.len() == 1, "{off:?}");
            assert_eq!(off.cameras[0].camera, wrong);
            let refined = observed.refined(&[wrong]).unwrap();
            let [correction] = &refined.moved[..] else {
                panic!("{refined:?}")
            };
            assert!(correction.is_told() && correction.is_off());
            for camera in (0..3).filter(|camera| *camera != wrong) {
                assert_eq!(refined.rig.cameras()[camera], truth.cameras()[camera]);
                let (turned, moved) = between(&refined.rig, &truth, [camera, wrong]);
                assert!(turned < 3.0 * correction.sigma.turn_deg, "{turned} deg");
                assert!(moved < 3.0 * correction.sigma.shift_m, "{moved} m");
            }
            assert_eq!(refined.accepted().unwrap(), &refined.rig);
            let named = format!("`{}` does not stand", truth.cameras()[wrong].id());
            assert!(observed.problem().unwrap().starts_with(&named));
            assert_eq!(refined.held_out.len(), 3);
            let better = |[before, after]: &[f64; 2]| after < before;
            assert!(refined.held_out.iter().all(better), "{refined:?}");
            let [before, after] = [&given, &refined.rig].map(|rig| observed.pairs(rig));
            for (before, after) in before.iter().zip(&after) {
                assert_eq!(before.objects, 12);
                let untouched = !before.cameras.contains(&wrong);
                assert!(after.px < before.px || untouched, "{before:?}, {after:?}");
            }
        }
    }
}

#[test]
fn views_that_see_something_else_move_no_camera() {
    let truth = rig();
    let observed = observed(&truth, &truth, 0.2, 3, &mut Draw(11));
    assert!(observed.off().cameras.is_empty(), "{:?}", observed.off());
    assert_eq!(observed.problem(), None);
    let none = observed.refined(&[]).unwrap();
    assert_eq!(none.rig, truth);
    assert!(
        none.accepted()
            .unwrap_err()
            .to_string()
            .contains("do not contradict")
    );
    let (turned, moved) = between(&observed.refined(&[1]).unwrap().rig, &truth, [0, 1]);
    assert!(turned < 0.5 && moved < 0.005, "{turned} deg, {moved} m");
}

#[test]
fn of_two_cameras_none_is_known_to_be_the_wrong_one() {
    let truth = Rig::new(rig().cameras()[..2].to_vec(), 0).unwrap();
    let given = with_off(&truth, 1, 2.0, 0.0);
    let off = observed(&truth, &given, 0.2, 0, &mut Draw(5)).off();
    assert!(!off.is_told && off.cameras.len() == 1, "{off:?}");
}

#[test]
fn held_out_sets_that_fit_no_better_refuse_a_rig() {
    let truth = rig();
    let given = with_off(&truth, 1, 2.0, 0.0);
    let observed = observed(&truth, &given, 0.2, 0, &mut Draw(5));
    let mut refined = observed.refined(&[1]).unwrap();
    assert!(refined.accepted().is_ok());
    refined.held_out = vec![[1.0, 0.5], [1.0, 1.5]];
    assert_eq!(refined.held_out_px(), Some([1.0, 1.0]));
    assert!(
        refined
            .accepted()
            .unwrap_err()
            .to_string()
            .contains("held out")
    );
}

#[test]
fn where_little_is_seen_little_is_told() {
    let truth = rig();
    let mut observed = observed(&truth, &truth, 0.2, 0, &mut Draw(9));
    observed.sightings.retain(|sighting| sighting.object == 0);
    let given = cams_from_world(&truth);
    let (all, scene) = (vec![observed.expected; 3], observed.adjusted.scene.clone());
    observed.adjusted = adjusted(&given, &all, scene, &observed.sightings, 4.0).unwrap();
    let by_one = observed.corrections(0);
    // Nor is any called off for what it alone says.
    assert!(by_one.iter().all(|one| one.objects == 1 && !one.is_off()));
    assert!(by_one.iter().any(|one| !one.is_told()), "{by_one:?}");
    let refined = observed.refined(&[1, 2]).unwrap();
    assert!(
        refined
            .accepted()
            .unwrap_err()
            .to_string()
            .contains("too little")
    );
}

#[test]
fn cameras_come_back_by_the_edges_of_what_they_see() {
    let (truth, mesh) = (rig(), cuboid());
    let given = with_off(&truth, 1, 1.0, 0.008);
    let refiner = Refiner::new(&mesh, 0.13);
    let mut draw = Draw(3);
    let (mut objects, mut views) = (Vec::new(), Vec::new());
    for object in 0..6 {
        let at = draw.direction() * 0.08;
        let pose = Isometry3::from_parts(at.into(), draw.rotation(3.0));
        for (index, camera) in truth.cameras().iter().enumerate() {
            let image: RgbImage = seen(&mesh, camera, &pose, &mut draw);
            let cam_from_obj = camera.world_from_cam().inv_mul(&pose);
            let view = View {
                camera,
                image: &Pyramid::new(&image),
            };
            views.push(Seen {
                camera: index,
                object,
                lines: CorrespondenceLines::new(&refiner, &view, &cam_from_obj)
                    .unwrap()
                    .unwrap(),
            });
        }
        let off = Isometry3::from_parts((draw.direction() * 0.003).into(), draw.rotation(0.05));
        objects.push(Object {
            world_from_obj: Isometry3::from_parts(
                (at + off.translation.vector).into(),
                off.rotation * pose.rotation,
            ),
            center: refiner.center(),
        });
    }
    let scene = Scene {
        cams_from_world: cams_from_world(&given),
        objects,
        outwards: 0.0,
    };
    let expected = Expected::default();
    let (sightings, adjusted) = on_images(&given, &expected, scene, &mut views).unwrap();
    let observed = Observed {
        given,
        expected,
        sightings,
        set_of: vec![0; 6],
        adjusted,
    };
    let off = observed.off();
    assert!(
        off.cameras.len() == 1 && off.cameras[0].camera == 1,
        "{off:?}"
    );
    let refined = observed.refined(&[1]).unwrap();
    let (turned, moved) = between(&refined.rig, &truth, [0, 1]);
    let sigma = refined.moved[0].sigma;
    assert!(turned < 3.0 * sigma.turn_deg, "{turned} deg, {sigma:?}");
    assert!(moved < 3.0 * sigma.shift_m, "{moved} m, {sigma:?}");
    assert!(sigma.turn_deg < 0.5 && sigma.shift_m < 0.006, "{sigma:?}");
}
