use mvtop_core::Intrinsics;
use mvtop_core::image::Letterbox;
use mvtop_core::rays::{BoxRays, LosEncoding, camera_rays, encode};
use nalgebra::{Isometry3, Point2, Point3, Rotation3, UnitQuaternion, Vector3, matrix};
use ndarray::{Array2, ArrayView1, array};
use proptest::prelude::*;

use super::camera;
use super::examples::{lenses, pinhole};

const STRIDES: [usize; 3] = [8, 16, 32];

fn assert_close(got: ArrayView1<f32>, expected: &[f32]) {
    assert_eq!(got.len(), expected.len());
    let far = got.iter().zip(expected).any(|(a, b)| (a - b).abs() > 2e-6);
    assert!(!far, "{got} instead of {expected:?}");
}

/// Turned half round about y, 2 m in front.
fn facing() -> Isometry3<f64> {
    let half_turn = Rotation3::from_matrix_unchecked(matrix![
        -1.0, 0.0, 0.0;
        0.0, 1.0, 0.0;
        0.0, 0.0, -1.0
    ]);
    Isometry3::from_parts(
        Vector3::new(0.0, 0.0, 2.0).into(),
        UnitQuaternion::from_rotation_matrix(&half_turn),
    )
}

#[test]
fn first_cell_of_a_pinhole_by_hand() {
    let camera = camera(pinhole(600.0, 320.0, 240.0), 640, 480);
    let rays = camera_rays(&camera, &Letterbox::new(640, 480, 640, 480), &[16]);
    assert_eq!(rays.dim(), (30 * 40, 3));
    assert_close(rays.row(0), &[-0.436855, -0.325020, 0.838761]);

    let (d, m) = (
        [0.436855, -0.325020, -0.838761],
        [-0.650040, -0.873709, 0.0],
    );
    let o = [0.0, 0.0, 2.0];
    for (encoding, expected) in [
        (LosEncoding::Direction, vec![d]),
        (LosEncoding::OriginDirection, vec![o, d]),
        (LosEncoding::Plucker, vec![d, m]),
        (LosEncoding::PluckerOrigin, vec![d, m, o]),
    ] {
        let lines = encode(rays.view(), &facing(), encoding);
        assert_eq!(lines.dim(), (30 * 40, encoding.width()));
        assert_close(lines.row(0), &expected.concat());
    }
}

#[test]
fn levels_follow_each_other_row_by_row() {
    let camera = camera(pinhole(1.0, -0.5, -0.5), 8, 4);
    let rays = camera_rays(&camera, &Letterbox::new(8, 4, 8, 4), &[2, 4]);
    let centers = [
        (1, 1),
        (3, 1),
        (5, 1),
        (7, 1),
        (1, 3),
        (3, 3),
        (5, 3),
        (7, 3),
        (2, 2),
        (6, 2),
    ];
    assert_eq!(rays.nrows(), centers.len());
    for (ray, (x, y)) in rays.rows().into_iter().zip(centers) {
        assert_close((&ray / ray[2]).view(), &[x as f32, y as f32, 1.0]);
    }
}

#[test]
fn every_lens_images_each_ray_at_its_cell() {
    let letterbox = Letterbox::new(640, 480, 320, 240);
    for lens in lenses() {
        let camera = camera(lens, 640, 480);
        let rays = camera_rays(&camera, &letterbox, &[16]);
        for (cell, ray) in rays.rows().into_iter().enumerate() {
            let point = Point3::new(ray[0], ray[1], ray[2]).cast::<f64>();
            let pixel = camera.intrinsics().project(&point).expect("a pixel");
            // Cells of 32 image pixels.
            let center = |i: usize| i as f64 * 32.0 + 15.5;
            let expected = Point2::new(center(cell % 20), center(cell / 20));
            // The rays are f32: 1e-7 of some 1000 px.
            assert!(
                (pixel - expected).norm() < 1e-3,
                "{pixel} instead of {expected}"
            );
        }
    }
}

#[test]
fn padding_and_cells_without_a_ray_are_zero() {
    // 640x360 in 640x480: rows from 360 on are padding; the last cells with a ray are at 355.5.
    let wide = camera(pinhole(600.0, 640.0, 360.0), 1280, 720);
    let rays = camera_rays(&wide, &Letterbox::new(1280, 720, 640, 480), &[8]);
    for (cell, ray) in rays.rows().into_iter().enumerate() {
        let norm = ray.dot(&ray).sqrt();
        let expected = if cell / 80 < 45 { 1.0 } else { 0.0 };
        assert!((norm - expected).abs() < 1e-6, "cell {cell}: {norm}");
    }
    // An equidistant fisheye of 50 px per radian sees nothing past 50π = 157 px from its center.
    let equidistant = super::examples::kannala_brandt(&[0.0; 4]);
    let lens = Intrinsics::new(50.0, 50.0, 318.2, 243.9, equidistant).unwrap();
    let fisheye = camera(lens, 640, 480);
    let rays = camera_rays(&fisheye, &Letterbox::new(640, 480, 640, 480), &[8]);
    assert!(rays.row(0).iter().all(|&x| x == 0.0));
    assert!(rays.row(30 * 80 + 40).iter().any(|&x| x != 0.0));
    for encoding in LosEncoding::ALL {
        let lines = encode(rays.view(), &facing(), encoding);
        assert!(lines.row(0).iter().all(|&x| x == 0.0), "{encoding:?}");
    }
}

#[test]
fn box_by_hand() {
    let camera = camera(pinhole(100.0, 0.0, 0.0), 640, 480);
    let rays = BoxRays::new(&camera, [-10.0, -20.0, 10.0, 20.0].into()).unwrap();
    let line = rays.encode(&facing());
    let (x, y) = (1.0 / 1.01_f32.sqrt(), 2.0 / 1.04_f32.sqrt());
    let expected = [0.0, 0.0, 2.0, 0.0, 0.0, -1.0, -x, 0.0, 0.0, 0.0, y, 0.0];
    assert_close(array![line].row(0), &expected);
    assert_eq!(BoxRays::new(&camera, [f64::NAN; 4].into()), None);
}

fn any_pose() -> impl Strategy<Value = Isometry3<f64>> {
    (
        prop::array::uniform3(-2.0..2.0f64),
        prop::array::uniform3(-2.0..2.0f64),
    )
        .prop_map(|(t, axis)| Isometry3::new(Vector3::from(t), Vector3::from(axis)))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn the_world_frame_does_not_matter(
        reference in any_pose(),
        other in any_pose(),
        new_from_old_world in any_pose(),
    ) {
        let letterbox = Letterbox::new(640, 480, 640, 480);
        for lens in lenses() {
            let camera = camera(lens, 640, 480);
            let cameras = [reference, other].map(|pose| camera.moved_to(pose).unwrap());
            let lines = |cameras: &[mvtop_core::Camera; 2]| -> (Array2<f32>, _) {
                let ref_from_cam =
                    cameras[0].world_from_cam().inverse() * cameras[1].world_from_cam();
                let rays = camera_rays(&cameras[1], &letterbox, &[32]);
                let box_rays = BoxRays::new(&cameras[1], [100.0, 50.0, 300.0, 260.0].into());
                (
                    encode(rays.view(), &ref_from_cam, LosEncoding::PluckerOrigin),
                    box_rays.unwrap().encode(&ref_from_cam),
                )
            };
            let before = lines(&cameras);
            let moved = cameras.map(|camera| {
                camera.moved_to(new_from_old_world * camera.world_from_cam()).unwrap()
            });
            let after = lines(&moved);
            prop_assert!((before.0 - after.0).iter().all(|x| x.abs() < 1e-5));
            prop_assert!(before.1.iter().zip(after.1).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }

    #[test]
    fn the_moment_is_that_of_any_point_of_the_ray(pose in any_pose(), along in -3.0..3.0f32) {
        let camera = camera(lenses().swap_remove(2), 640, 480);
        let rays = camera_rays(&camera, &Letterbox::new(640, 480, 640, 480), &STRIDES);
        let lines = encode(rays.view(), &pose, LosEncoding::PluckerOrigin);
        for line in lines.rows() {
            let part = |i: usize| Vector3::new(line[i], line[i + 1], line[i + 2]);
            let (d, m, o) = (part(0), part(3), part(6));
            prop_assert!((d.cross(&(o + d * along)) - m).norm() < 1e-5);
        }
    }
}
