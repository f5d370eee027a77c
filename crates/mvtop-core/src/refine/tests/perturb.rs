//! Poses beyond the basin of convergence of the refinement.

use super::*;

#[test]
fn perturbations_reach_the_correct_pose_from_far_off() {
    let cameras = [0.0, 70.0].map(camera);
    let mut draw = Draw(9);
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.003,
    };
    let (mut alone, mut reached) = (0, 0);
    for mesh in [ball(), cuboid()] {
        let refiner = Refiner::new(&mesh, 0.13);
        for draws in 0..18 {
            let degrees: f64 = if draws < 6 { 20.0 } else { 40.0 };
            let pose = rotation(&mut draw, &cameras);
            let truth = Isometry3::from_parts(Translation3::identity(), pose);
            let images = [0, 1].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
            let views = [0, 1].map(|view| View {
                camera: &cameras[view],
                image: &images[view],
            });
            let start = truth * draw.rotation(degrees.to_radians());
            let perturbed = refiner.perturbed(&views, &start, sigma, 10.0);
            let off = |pose: &Isometry3<f64>| rotation_error_deg(&pose.rotation, &truth.rotation);
            let own = refiner
                .refine(&views, &start, sigma, Schedule::Full)
                .unwrap()
                .world_from_obj;
            let near = |pose: &Isometry3<f64>| off(pose) < 2.0;
            let found = near(&own) || perturbed.iter().any(near);
            if degrees < 30.0 {
                assert!(found, "{degrees} degrees: {}", off(&own));
            } else {
                alone += u32::from(near(&own));
                reached += u32::from(found);
            }
            let mut pairs = (0..perturbed.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
            assert!(pairs.all(|(a, b)| {
                perturbed[a].rotation.angle_to(&perturbed[b].rotation) > 3_f64.to_radians()
            }));
        }
    }
    assert!(
        reached >= 12.max(2 * alone),
        "of 24: {reached}, {alone} alone"
    );
}

#[test]
fn object_behind_the_camera_has_no_perturbations() {
    let camera = camera(0.0);
    let image = RgbImage::from_pixel(SIDE, SIDE, Rgb([128; 3]));
    let views = [View {
        camera: &camera,
        image: &image,
    }];
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.003,
    };
    let behind = camera.world_from_cam() * Isometry3::translation(0.0, 0.0, -1.0);
    let refiner = Refiner::new(&cuboid(), 0.15);
    assert!(refiner.perturbed(&views, &behind, sigma, 10.0).is_empty());
}
