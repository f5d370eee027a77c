use image::RgbImage;
use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::adjust::adjusted;
use super::single::Alone;
use super::*;
use crate::bundle::{Class, SurfacePoint};
use crate::consistency::extent;
use crate::pose::{rotation_error_deg, translation_error};
use crate::refine::Refiner;
use crate::refine::tests::{Draw, camera, cuboid, seen};
use crate::symmetry::Symmetry;
use crate::{Camera, Intrinsics, Projection};

/// Three cameras 0.6 m from the origin that look at it.
fn rig() -> Rig {
    Rig::new([0.0, 45.0, 90.0].map(camera).to_vec(), 0).unwrap()
}

/// By how much one camera stands otherwise to another in two rigs, degrees and metres.
fn between(a: &Rig, b: &Rig, pair: [usize; 2]) -> (f64, f64) {
    let [a, b] = [a, b].map(|rig| {
        let [from, to] = pair.map(|i| *rig.cameras()[i].world_from_cam());
        from.inv_mul(&to)
    });
    (
        rotation_error_deg(&a.rotation, &b.rotation),
        translation_error(&a, &b),
    )
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

/// A class of a cube's corners, 0.1 m a side.
fn cube() -> Class {
    let corner = |i: u32| SurfacePoint {
        position: [0, 1, 2].map(|axis| if i >> axis & 1 == 1 { 0.05 } else { -0.05 }),
        color: [0; 3],
    };
    Class {
        id: 1,
        name: "cube".into(),
        diameter_m: 0.03f64.sqrt(),
        points: (0..8).map(corner).collect(),
        mesh: None,
        symmetry: Symmetry::default(),
        coordinates_extent_m: None,
    }
}

/// Cubes in several places, as this rig sees them.
fn observed(rig: &Rig) -> Observed {
    let places = [[0.0, 0.0, 0.0], [0.05, -0.03, 0.04], [-0.06, 0.04, 0.02]];
    let objects = places.map(|[x, y, z]| {
        let world_from_obj = Isometry3::new(Vector3::new(x, y, z), Vector3::new(z, 9.0 * x, y));
        let cameras = rig.cameras().iter().enumerate();
        let bbox = |camera: &Camera| extent(&cube().points, camera, &world_from_obj).unwrap();
        Found {
            class: 0,
            world_from_obj,
            boxes: cameras
                .map(|(index, camera)| (index, bbox(camera)))
                .collect(),
        }
    });
    let sigma = Sigma {
        rot_deg: 0.1,
        t_m: 0.001,
    };
    Observed {
        sigmas: (0..rig.cameras().len())
            .map(|i| (i != 0).then_some(sigma))
            .collect(),
        rig: rig.clone(),
        objects: objects.to_vec(),
    }
}

#[test]
fn cameras_come_back_by_the_edges_of_what_they_see() {
    let (truth, mesh) = (rig(), cuboid());
    let given = with_off(&truth, 1, 1.0, 0.008);
    let refiners = [Some(Refiner::new(&mesh, 0.13))];
    let refiner = refiners[0].as_ref().unwrap();
    let mut draw = Draw(3);
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.01,
    };
    let found = (0..4).map(|_| {
        let at = draw.direction() * 0.05;
        let pose = Isometry3::from_parts(at.into(), draw.rotation(3.0));
        let images: Vec<ViewImage> = (0..3)
            .map(|camera| {
                let image: RgbImage = seen(&mesh, &truth.cameras()[camera], &pose, &mut draw);
                ViewImage { camera, image }
            })
            .collect();
        let off = Isometry3::from_parts((draw.direction() * 0.006).into(), draw.rotation(0.06));
        let start = Isometry3::from_parts(
            (off.translation.vector + pose.translation.vector).into(),
            off.rotation * pose.rotation,
        );
        let bbox = BBox::from([0.0, 0.0, 1.0, 1.0]);
        let boxes = vec![(0, bbox), (1, bbox), (2, bbox)];
        let sightings = Sighting::all(refiner, &given, &images, &boxes, &start).unwrap();
        let found = Found {
            class: 0,
            world_from_obj: start,
            boxes,
        };
        (found, sightings, sigma)
    });
    let found = found.collect();
    let after = adjusted(&refiners, &given, &[true; 3], found);
    let better = given.moved(|index, _| after.poses[index]).unwrap();
    assert_eq!(after.sigmas[0], None);
    for camera in [1, 2] {
        let (turned, moved) = between(&better, &truth, [0, camera]);
        let sigma = after.sigmas[camera].unwrap();
        assert!(turned < 3.0 * sigma.rot_deg, "{turned} deg, {sigma:?}");
        assert!(
            moved < 3.0 * 3f64.sqrt() * sigma.t_m,
            "{moved} m, {sigma:?}"
        );
        assert!(
            sigma.rot_deg < UNTOLD.rot_deg && sigma.t_m < UNTOLD.t_m,
            "{sigma:?}"
        );
    }
    let observed = Observed {
        rig: better,
        sigmas: after.sigmas,
        objects: after.objects,
    };
    assert!(observed.compare(&[cube()], &truth).off.is_empty());
    let off = observed.compare(&[cube()], &given).off;
    assert!(off.len() == 1 && off[0].camera == 1, "{off:?}");
}

#[test]
fn rig_is_found_from_single_images_whatever_was_given() {
    let truth = rig();
    let mut draw = Draw(5);
    let mut alone = vec![Vec::new(); 4];
    for set in 0..3 {
        let pose = Isometry3::from_parts((draw.direction() * 0.1).into(), draw.rotation(3.0));
        for (index, camera) in truth.cameras().iter().enumerate() {
            // 3 degrees and 5 mm off; of the last set, one is something else.
            let off = Isometry3::from_parts((draw.direction() * 0.005).into(), draw.rotation(0.05));
            let mut seen = camera.world_from_cam().inv_mul(&pose) * off;
            if (set, index) == (2, 1) {
                seen.translation.x += 0.3;
            }
            alone[index].push(Alone {
                set,
                class: 0,
                diameter: 0.17,
                cam_from_obj: seen,
                middle: seen * Point3::origin(),
            });
        }
    }
    // A fourth camera has seen nothing.
    let mut cameras = truth.cameras().to_vec();
    let pinhole = Intrinsics::new(600.0, 600.0, 239.5, 239.5, Projection::Pinhole).unwrap();
    let idle = Isometry3::translation(3.0, 2.0, 1.0);
    cameras.push(Camera::new("idle", [480; 2], pinhole, idle).unwrap());
    let truth = Rig::new(cameras, 0).unwrap();
    let given = truth
        .moved(|_, camera| camera.world_from_cam().inverse())
        .unwrap();
    let (found, linked) = single::rig(&[cube()], &given, &alone).unwrap();
    assert_eq!(linked, [true, true, true, false]);
    for camera in [1, 2] {
        let (turned, moved) = between(&found, &truth, [0, camera]);
        assert!(turned < 6.0 && moved < 0.06, "{turned} deg, {moved} m");
    }
    assert_eq!(found.cameras()[3], given.cameras()[3]);
    // What fits as it is stays.
    let (kept, _) = single::rig(&[cube()], &truth, &alone).unwrap();
    for camera in 0..4 {
        let (turned, moved) = between(&kept, &truth, [0, camera]);
        assert!(turned < 1e-6 && moved < 1e-9, "{turned} deg, {moved} m");
    }
}

#[test]
fn camera_that_is_off_is_named_with_its_error() {
    let (truth, classes) = (rig(), [cube()]);
    let observed = observed(&truth);
    let comparison = observed.compare(&classes, &truth);
    assert!(comparison.off.is_empty() && comparison.reading.is_none());
    assert_eq!(comparison.pairs.len(), 3);
    for pair in &comparison.pairs {
        assert!(
            pair.px < 1e-3 && (pair.size.unwrap() - 1.0).abs() < 1e-6,
            "{pair:?}"
        );
    }
    // The reference camera is not above suspicion.
    for wrong in [0, 1, 2] {
        let comparison = observed.compare(&classes, &with_off(&truth, wrong, 2.0, 0.0));
        assert!(comparison.is_told && comparison.reading.is_none());
        let [off] = &comparison.off[..] else {
            panic!("{comparison:?}")
        };
        // 600 px of focal length times the tangent of 2 degrees, more to the sides.
        assert!(
            off.camera == wrong && (off.px - 21.0).abs() < 0.5,
            "{off:?}"
        );
        let needed = off.cam_from_shown;
        assert!((needed.rotation.scaled_axis().y.to_degrees() + 2.0).abs() < 1e-6);
        assert!(needed.translation.vector.norm() < 1e-9);
    }
}

#[test]
fn of_two_cameras_none_is_known_to_be_the_wrong_one() {
    let truth = Rig::new(rig().cameras()[..2].to_vec(), 0).unwrap();
    let comparison = observed(&truth).compare(&[cube()], &with_off(&truth, 1, 2.0, 0.0));
    assert!(!comparison.is_told && comparison.off.len() == 1);
}

#[test]
fn readings_that_explain_a_rig_are_named() {
    let (truth, classes) = (rig(), [cube()]);
    let observed = observed(&truth);
    let reading = |change: &dyn Fn(&Isometry3<f64>) -> Isometry3<f64>| {
        let rig = truth
            .moved(|_, camera| change(camera.world_from_cam()))
            .unwrap();
        observed.compare(&classes, &rig).reading
    };
    let flip = Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    assert_eq!(reading(&|pose| pose.inverse()), Some(Reading::Inverse));
    assert_eq!(reading(&|pose| pose * flip), Some(Reading::OpenGl));
    let both = reading(&|pose| (pose * flip).inverse());
    assert_eq!(both, Some(Reading::InverseOpenGl));
    let longer = |pose: &Isometry3<f64>| {
        Isometry3::from_parts((pose.translation.vector * 10.0).into(), pose.rotation)
    };
    let Some(Reading::Scaled(scale)) = reading(&longer) else {
        panic!("expected a scale")
    };
    assert!((scale - 10.0).abs() < 1e-9, "{scale}");
    // One camera alone explains nothing of the others.
    let rig = with_off(&truth, 1, 20.0, 0.1);
    assert_eq!(observed.compare(&classes, &rig).reading, None);
}
