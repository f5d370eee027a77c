//! Scenes rendered with known poses, and disturbed poses that must converge to them.

mod alone;
mod config;
mod evidence;
mod one_view;
mod quality;
mod robust_step;
mod scene;
mod texture;

use image::{Rgb, RgbImage};
use nalgebra::{Point2, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};

pub(crate) use self::scene::*;
use super::*;
use crate::Projection;
use crate::camera::Intrinsics;
use crate::closeup::CloseUp;
use crate::pose::{rotation_error_deg, translation_error};
use crate::symmetry::Axis;

/// Any rotation at which some camera sees x and one sees y, where the ball's knobs are.
fn rotation(draw: &mut Draw, cameras: &[Camera]) -> UnitQuaternion<f64> {
    loop {
        let rotation = draw.rotation(3.0);
        let towards = |axis: Vector3<f64>| {
            let cameras = cameras
                .iter()
                .map(|c| c.world_from_cam().translation.vector);
            cameras
                .map(|at| at.normalize().dot(&(rotation * axis)))
                .fold(-1.0, f64::max)
        };
        if towards(Vector3::x()).min(towards(Vector3::y())) > 0.5 {
            return rotation;
        }
    }
}

/// Errors, degrees and metres, of poses that were up to 15 degrees and 15 mm off.
fn errors(mesh: &Mesh, axis: Option<Axis>, draws: usize) -> Vec<[f64; 2]> {
    let refiner = Refiner::new(mesh, 0.13);
    let cameras = [0.0, 70.0, 140.0].map(camera);
    let mut draw = Draw(1);
    let sigma = Sigma {
        rot_deg: 15.0,
        t_m: 0.015,
    };
    let one = |_| {
        let truth = Isometry3::from_parts(Translation3::identity(), rotation(&mut draw, &cameras));
        let images: Vec<RgbImage> = cameras
            .iter()
            .map(|camera| seen(mesh, camera, &truth, &mut draw))
            .collect();
        let pyramids: Vec<Pyramid> = images.iter().map(Pyramid::new).collect();
        let views = views_of(&cameras, &pyramids);
        let turn = draw.rotation(15_f64.to_radians()) * truth.rotation;
        let shift = truth.translation.vector + draw.direction() * 0.015;
        let start = Isometry3::from_parts(shift.into(), turn);
        let found = refiner
            .refine(&views, &start, sigma)
            .unwrap()
            .world_from_obj;
        let symmetry = crate::symmetry::Symmetry {
            axis,
            discrete: vec![],
        };
        let found = symmetry.nearest(&found, &truth, 0.13);
        [
            rotation_error_deg(&found.rotation, &truth.rotation),
            translation_error(&found, &truth),
        ]
    };
    (0..draws).map(one).collect()
}

#[test]
fn boxes_cans_and_balls_with_knobs_come_back() {
    let about_z = Axis {
        direction: Vector3::z_axis(),
        point: Point3::origin(),
    };
    for (name, mesh, axis, bound) in [
        ("box", cuboid(), None, [0.2, 0.0002]),
        ("can", can(), Some(about_z), [0.2, 0.0002]),
        ("ball", ball(), None, [0.2, 0.0002]),
    ] {
        let errors = errors(&mesh, axis, 40);
        let near = errors
            .iter()
            .filter(|[turn, shift]| *turn < bound[0] && *shift < bound[1]);
        let share = near.count() as f64 / errors.len() as f64;
        assert!(
            share >= 0.95,
            "{name}: {share} within {bound:?}: {errors:?}"
        );
    }
}

#[test]
fn change_of_a_line_is_that_of_its_point_through_every_lens() {
    let lens = |family: &str, distortion, params: &[f64]| {
        let projection = Projection::from_params(family, distortion, params).unwrap();
        Intrinsics::new(500.0, 510.0, 320.0, 240.0, projection).unwrap()
    };
    for intrinsics in [
        lens("pinhole", None, &[]),
        lens(
            "pinhole",
            Some("brown_conrady"),
            &[-0.2, 0.08, 0.001, -0.002, 0.01],
        ),
        lens("fisheye", None, &[-0.006, 0.016, -0.024, 0.0155]),
    ] {
        let pose = Isometry3::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.2, 0.3, -0.1));
        let camera = Camera::new("a", [640, 480], intrinsics, pose).unwrap();
        let closeup = CloseUp::new(&camera, [400.0, 100.0, 500.0, 220.0].into(), 160).unwrap();
        // Projection by the real camera, in the crop.
        let close = &closeup.camera;
        let close_from_cam = close.world_from_cam().inv_mul(camera.world_from_cam());
        let pixel = |point: &Point3<f64>| {
            let real = camera.world_from_cam().inverse_transform_point(point);
            let real = camera.intrinsics().project(&real).unwrap();
            let ray = camera.intrinsics().unproject(&real).unwrap();
            close
                .intrinsics()
                .project(&Point3::from(close_from_cam * ray.into_inner()))
                .unwrap()
        };
        let ray = camera
            .intrinsics()
            .unproject(&Point2::new(450.0, 150.0))
            .unwrap();
        let point = camera.world_from_cam() * Point3::from(ray.into_inner() * 0.7);
        let center = point + Vector3::new(0.02, -0.03, 0.05);
        let normal = Vector2::new(0.6, -0.8);
        let in_close = close.world_from_cam().inverse_transform_point(&point);
        let (world_from_close, focal) = (close.world_from_cam(), close.intrinsics().fx());
        let change = gauss_newton::jacobian(world_from_close, focal, &in_close, &normal, &center);
        let world_from_obj =
            Isometry3::from_parts(center.coords.into(), UnitQuaternion::identity());
        let place = world_from_obj.inverse_transform_point(&point);
        for i in 0..6 {
            let along = |by: f64| {
                let motion = Vector6::from_fn(|row, _| if row == i { by } else { 0.0 });
                let pose = gauss_newton::moved(&world_from_obj, &Point3::origin(), &motion);
                pixel(&(pose * place)).coords.dot(&normal)
            };
            let numeric = (along(1e-6) - along(-1e-6)) / 2e-6;
            assert!(
                (change[i] - numeric).abs() < 1e-4 * change.norm(),
                "{i}: {} instead of {numeric}",
                change[i]
            );
        }
    }
}

#[test]
fn unobservable_rotation_stays_at_the_prior() {
    let mesh = can();
    let refiner = Refiner::new(&mesh, 0.13);
    let axis = Axis {
        direction: Vector3::z_axis(),
        point: Point3::origin(),
    };
    let round = Refiner::new(&mesh, 0.13).with_symmetry(Symmetry {
        discrete: Vec::new(),
        axis: Some(axis),
    });
    let cameras = [0.0, 70.0].map(camera);
    let mut draw = Draw(5);
    for _ in 0..5 {
        let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
        let images: Vec<RgbImage> = cameras
            .iter()
            .map(|camera| seen(&mesh, camera, &truth, &mut draw))
            .collect();
        let pyramids: Vec<Pyramid> = images.iter().map(Pyramid::new).collect();
        let views = views_of(&cameras, &pyramids);
        // Off by a tilt, which is seen, and by a turn about the axis, which is not.
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.2);
        let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.1);
        let start = truth * turn * tilt;
        let sigma = Sigma {
            rot_deg: 10.0,
            t_m: 0.01,
        };
        let found = refiner.refine(&views, &start, sigma).unwrap();
        let left = truth.inv_mul(&found.world_from_obj).rotation;
        let about_axis = 2.0 * left.k.atan2(left.w);
        assert!((about_axis - 0.2).abs() < 0.02, "{about_axis}");
        let tilted = (left * Vector3::z()).angle(&Vector3::z()).to_degrees();
        assert!(found.accepted && tilted < 2.0, "{tilted}");
        // It is known to be open: as open as it was.
        assert!(found.sigma.rot_deg > 4.0, "{:?}", found.sigma);
        // A symmetric part has no ambiguous rotation.
        let round = round.refine(&views, &start, sigma).unwrap().sigma;
        assert!(
            tilted < 2.0 * round.rot_deg && round.rot_deg < 3.0,
            "{round:?}"
        );
    }
}

#[test]
fn result_does_not_depend_on_the_number_of_threads() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0, 140.0].map(camera);
    let mut draw = Draw(9);
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(1.0));
    let images = [0, 1, 2].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
    let pyramids = images.each_ref().map(Pyramid::new);
    let views = views_of(&cameras, &pyramids);
    let start = Isometry3::new(Vector3::new(0.003, 0.0, 0.002), Vector3::zeros()) * truth;
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.005,
    };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            refiner
                .refine(&views, &start, sigma)
                .unwrap()
                .world_from_obj
        })
    };
    assert_eq!(with(1), with(4));
}

#[test]
fn pose_that_the_images_do_not_show_is_left_alone() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0].map(camera);
    let image = RgbImage::from_pixel(SIDE, SIDE, Rgb([90, 90, 90]));
    let pyramids = [0, 1].map(|_| Pyramid::new(&image));
    let views = views_of(&cameras, &pyramids);
    let start = Isometry3::identity();
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.005,
    };
    let found = refiner.refine(&views, &start, sigma).unwrap();
    assert_eq!((found.accepted, found.world_from_obj), (false, start));
    assert_eq!(found.sigma, sigma);
    // And where it is in no image, there is nothing to refine.
    let away = Isometry3::translation(0.0, 5.0, 0.0);
    assert!(refiner.refine(&views, &away, sigma).is_none());
}
