use image::{Rgb, RgbImage};
use mvtop_core::closeup::{CloseUp, FILL};
use mvtop_core::image::Pyramid;
use mvtop_core::rays::BoxRays;
use mvtop_core::{BBox, Camera};
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use ndarray::Axis;
use proptest::prelude::*;

use super::camera;
use super::examples::{lenses, pinhole};

const SIZE: u32 = 64;

fn close(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() < tolerance, "{a} instead of {b}");
}

/// A picture as the mean and std leave it: 0 to 1.
fn picture(closeup: &CloseUp, real: &Camera, image: &RgbImage) -> ndarray::Array3<f32> {
    closeup.picture(real, &Pyramid::new(image), [0.0; 3], [1.0; 3])
}

#[test]
fn box_on_the_axis_by_hand() {
    let real = camera(pinhole(100.0, 50.0, 50.0), 101, 101);
    let closeup = CloseUp::new(&real, [30.0, 40.0, 70.0, 60.0].into(), 100).unwrap();
    // Half its longer side is seen under tan = 0.2 and becomes 30 of 50 px.
    close(closeup.camera.intrinsics().fx(), 150.0, 1e-9);
    close(closeup.camera.intrinsics().fy(), 150.0, 1e-9);
    for (side, expected) in <[f64; 4]>::from(closeup.bbox)
        .into_iter()
        .zip([19.5, 34.5, 79.5, 64.5])
    {
        close(side, expected, 1e-9);
    }
    let turn = closeup.camera.world_from_cam().rotation.angle();
    close(turn, 0.0, 1e-9);
}

/// The corners of a rectangle one unit ahead, twice as wide as high.
fn rectangle() -> [Point3<f64>; 4] {
    [(-0.2, -0.1), (0.2, -0.1), (-0.2, 0.1), (0.2, 0.1)].map(|(x, y)| Point3::new(x, y, 1.0))
}

#[test]
fn rolled_closeup_by_hand() {
    let real = camera(pinhole(100.0, 50.0, 50.0), 101, 101);
    let upright = [19.5, 34.5, 79.5, 64.5];
    let lying = [34.5, 19.5, 64.5, 79.5];
    for (degrees, sides) in [(0.0, upright), (90.0, lying), (180.0, upright)] {
        let roll = f64::to_radians(degrees);
        let closeup = CloseUp::rolled(&real, &rectangle(), roll, 100).unwrap();
        close(closeup.camera.intrinsics().fx(), 150.0, 1e-9);
        let found = <[f64; 4]>::from(closeup.bbox);
        found
            .iter()
            .zip(sides)
            .for_each(|(a, b)| close(*a, b, 1e-9));
        let right = closeup.camera.world_from_cam().inverse() * Point3::new(0.2, 0.0, 1.0);
        close(right.x, 0.2 * roll.cos(), 1e-9);
        close(right.y, 0.2 * roll.sin(), 1e-9);
    }
    let mut behind = rectangle();
    behind[0].z = -1.0;
    assert!(CloseUp::rolled(&real, &behind, 0.3, 100).is_none());
}

#[test]
fn there_is_none_of_a_box_that_spans_half_the_view() {
    let real = camera(pinhole(50.0, 100.0, 240.0), 640, 480);
    assert!(CloseUp::is_of(&real, [90.0, 200.0, 110.0, 280.0].into()));
    // From 63 degrees to the left of the axis to 84 to the right, its middle at 76.
    let wide: BBox = [0.0, 200.0, 600.0, 280.0].into();
    assert!(BoxRays::new(&real, wide).is_some() && !CloseUp::is_of(&real, wide));
}

#[test]
fn image_is_enlarged_by_hand() {
    // A vertical edge at u = 49.5, in the middle of the box.
    let real = camera(pinhole(100.0, 49.5, 49.5), 100, 100);
    let image = RgbImage::from_fn(100, 100, |u, _| Rgb([if u < 50 { 0 } else { 255 }, 51, 7]));
    let closeup = CloseUp::new(&real, [39.5, 39.5, 59.5, 59.5].into(), SIZE).unwrap();
    let picture = picture(&closeup, &real, &image);
    for v in [0, 20, 63] {
        assert_eq!(picture[(0, v, 28)], 0.0);
        assert_eq!(picture[(0, v, 35)], 1.0);
        assert!((picture[(1, v, 31)] - 0.2).abs() < 1e-6);
    }
}

#[test]
fn fine_pattern_becomes_its_mean() {
    let real = camera(pinhole(600.0, 319.5, 239.5), 640, 480);
    let image = RgbImage::from_fn(640, 480, |u, v| Rgb([255 * ((u + v) % 2) as u8; 3]));
    let closeup = CloseUp::new(&real, [120.0, 40.0, 520.0, 440.0].into(), SIZE).unwrap();
    let picture = picture(&closeup, &real, &image);
    for v in 16..48 {
        for u in 16..48 {
            assert!(
                (picture[(0, v, u)] - 0.5).abs() < 0.1,
                "{}",
                picture[(0, v, u)]
            );
        }
    }
}

#[test]
fn what_is_off_the_image_is_zero() {
    let real = camera(pinhole(600.0, 319.5, 239.5), 640, 480);
    let image = RgbImage::from_pixel(640, 480, Rgb([255; 3]));
    let closeup = CloseUp::new(&real, [0.0, 0.0, 80.0, 80.0].into(), SIZE).unwrap();
    let picture = picture(&closeup, &real, &image);
    assert_eq!(picture[(0, 0, 0)], 0.0);
    assert_eq!(picture[(0, 63, 63)], 1.0);
    let rays = closeup.camera_rays(&real, &[8]);
    assert_eq!(rays.row(0).to_vec(), [0.0; 3]);
    let last = rays.row(63);
    assert!((last.dot(&last) - 1.0).abs() < 1e-6);
}

#[test]
fn box_that_spans_half_the_view_has_none() {
    let fisheye = lenses().pop().unwrap();
    let real = camera(fisheye, 640, 480);
    assert!(CloseUp::new(&real, [0.0, 0.0, 639.0, 479.0].into(), SIZE).is_none());
    assert!(CloseUp::new(&real, [280.0, 200.0, 380.0, 300.0].into(), SIZE).is_some());
}

/// The smooth color that lies in a direction of the world.
fn color(direction: &Vector3<f64>) -> [f64; 3] {
    let d = direction.normalize();
    [d.x, d.y, d.z].map(|x| 127.5 + 120.0 * (2.0 * x).sin())
}

/// A picture of these colors by a lens, black where it has no ray.
fn photograph(real: &Camera) -> RgbImage {
    RgbImage::from_fn(real.width(), real.height(), |u, v| {
        let ray = real
            .intrinsics()
            .unproject(&Point2::new(f64::from(u), f64::from(v)));
        Rgb(ray.map_or([0; 3], |ray| {
            color(&(real.world_from_cam() * ray.into_inner())).map(|c| c.round() as u8)
        }))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever the lens: the real and the virtual camera see every direction in the same color,
    /// the box's middle and sides where the real camera has them.
    #[test]
    fn real_and_virtual_camera_agree(
        lens in 0..lenses().len(),
        (u, v) in (60.0..580.0, 60.0..420.0),
        (width, height) in (20.0..90.0, 20.0..90.0),
        turn in prop::array::uniform3(-3.0..3.0),
    ) {
        let world_from_real = Isometry3::from_parts(
            Translation3::new(0.3, -1.0, 2.0),
            UnitQuaternion::from_scaled_axis(turn.into()),
        );
        let real = camera(lenses().swap_remove(lens), 640, 480);
        let real = real.moved_to(world_from_real).unwrap();
        let bbox = BBox {
            x0: u - width / 2.0,
            y0: v - height / 2.0,
            x1: u + width / 2.0,
            y1: v + height / 2.0,
        };
        let Some(closeup) = CloseUp::new(&real, bbox, SIZE) else {
            return Err(TestCaseError::reject("no rays"));
        };
        let virtual_from_real =
            closeup.camera.world_from_cam().inverse() * real.world_from_cam();
        prop_assert!(virtual_from_real.translation.vector.norm() < 1e-12);
        let seen = |u: f64, v: f64| -> [f64; 2] {
            let ray = real.intrinsics().unproject(&Point2::new(u, v)).unwrap();
            let point: Point3<f64> = (virtual_from_real * ray.into_inner()).into();
            closeup.camera.intrinsics().project(&point).unwrap().coords.into()
        };
        let middle = seen(u, v);
        prop_assert!((middle[0] - 31.5).abs() < 1e-6 && (middle[1] - 31.5).abs() < 1e-6);
        prop_assert!((seen(bbox.x0, v)[0] - closeup.bbox.x0).abs() < 1e-6);
        prop_assert!((seen(u, bbox.y1)[1] - closeup.bbox.y1).abs() < 1e-6);
        let BBox { x0, y0, x1, y1 } = closeup.bbox;
        let reach = [31.5 - x0, x1 - 31.5, 31.5 - y0, y1 - 31.5]
            .into_iter()
            .fold(0.0, f64::max);
        prop_assert!((reach - FILL * 32.0).abs() < 1e-6);

        let image = photograph(&real);
        let picture = picture(&closeup, &real, &image);
        let rays = closeup.camera_rays(&real, &[1]);
        for (cell, ray) in rays.axis_iter(Axis(0)).enumerate() {
            let (row, column) = (cell / SIZE as usize, cell % SIZE as usize);
            if ray[0] == 0.0 && ray[1] == 0.0 && ray[2] == 0.0 {
                continue; // off the image
            }
            let direction = Vector3::from_fn(|i, _| f64::from(ray[i]));
            // Away from the edges of what the lens images, where neighbours may be black.
            let at = real.intrinsics().project(&(virtual_from_real.inverse() * direction).into());
            let Some(at) = at else { continue };
            if at.x < 3.0 || at.y < 3.0 || at.x > 636.0 || at.y > 476.0 {
                continue;
            }
            let expected = color(&(closeup.camera.world_from_cam() * direction));
            for channel in 0..3 {
                let got = f64::from(picture[(channel, row, column)]) * 255.0;
                prop_assert!(
                    (got - expected[channel]).abs() < 2.0,
                    "{got} instead of {} at {row}, {column}",
                    expected[channel]
                );
            }
        }
    }

    #[test]
    fn rolled_closeups_stand_where_the_camera_does_and_hold_all_points(
        lens in 0..lenses().len(), roll in -3.2..3.2, x in -0.3..0.3, y in -0.2..0.2,
        sizes in [0.01..0.1, 0.01..0.1, 0.01..0.1],
    ) {
        let real = camera(lenses().swap_remove(lens), 640, 480);
        let points: Vec<Point3<f64>> = (0..8)
            .map(|corner| {
                let side = |axis: usize| (f64::from(corner >> axis & 1) - 0.5) * sizes[axis];
                Point3::new(x + side(0), y + side(1), 1.0 + side(2))
            })
            .collect();
        let closeup = CloseUp::rolled(&real, &points, roll, SIZE).unwrap();
        let world_from_close = closeup.camera.world_from_cam();
        let moved = world_from_close.translation.vector - real.world_from_cam().translation.vector;
        prop_assert!(moved.norm() < 1e-12);
        let [x0, y0, x1, y1] = <[f64; 4]>::from(closeup.bbox);
        for point in &points {
            let point = world_from_close.inverse() * (real.world_from_cam() * point);
            let at = closeup.camera.intrinsics().project(&point).unwrap();
            prop_assert!((x0 - 1e-6..=x1 + 1e-6).contains(&at.x), "{at}");
            prop_assert!((y0 - 1e-6..=y1 + 1e-6).contains(&at.y), "{at}");
        }
        // As large as a box's close-up, and about in the middle.
        let longer = (x1 - x0).max(y1 - y0) / (FILL * f64::from(SIZE));
        prop_assert!((0.95..=1.0 + 1e-9).contains(&longer), "{longer}");
    }
}
