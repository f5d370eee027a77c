use std::path::Path;

use image::{Rgb, RgbImage};
use mvtop_core::closeup::{CloseUp, FILL};
use mvtop_core::{BBox, Camera, Intrinsics, Projection};
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use ndarray::Axis;
use proptest::prelude::*;
use safetensors::SafeTensors;

use super::{camera, lenses, pinhole};

const SIZE: u32 = 64;

fn close(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() < tolerance, "{a} instead of {b}");
}

/// A picture as the mean and std leave it: 0 to 1.
fn picture(closeup: &CloseUp, real: &Camera, image: &RgbImage) -> ndarray::Array3<f32> {
    closeup.picture(real, image, [0.0; 3], [1.0; 3])
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
}

/// Against OpenCV, whose bilinear weights are multiples of 1/32.
#[test]
fn equals_the_training_side() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/closeup.safetensors");
    let bytes = std::fs::read(path).unwrap();
    let fixture = SafeTensors::deserialize(&bytes).unwrap();
    let numbers = |name: &str| -> Vec<f64> {
        let tensor = fixture.tensor(name).unwrap();
        tensor
            .data()
            .chunks_exact(8)
            .map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap()))
            .collect()
    };
    let image = fixture.tensor("image").unwrap();
    let (height, width) = (image.shape()[0] as u32, image.shape()[1] as u32);
    let image = RgbImage::from_raw(width, height, image.data().to_vec()).unwrap();
    let k = numbers("k");
    let lens = Intrinsics::new(k[0], k[4], k[2], k[5], Projection::Pinhole).unwrap();
    let real = camera(lens, width, height);
    let (boxes, pictures) = (numbers("boxes"), fixture.tensor("pictures").unwrap());
    let (size, on_image) = (pictures.shape()[1], fixture.tensor("on_image").unwrap());
    for (i, bbox) in boxes.chunks_exact(4).enumerate() {
        let bbox = BBox::from([0, 1, 2, 3].map(|i| bbox[i]));
        let closeup = CloseUp::new(&real, bbox, size as u32).unwrap();
        close(closeup.camera.intrinsics().fx(), numbers("focals")[i], 1e-8);
        for (side, expected) in <[f64; 4]>::from(closeup.bbox)
            .into_iter()
            .zip(&numbers("close_boxes")[4 * i..])
        {
            close(side, *expected, 1e-8);
        }
        let rotation = closeup.camera.world_from_cam().rotation.inverse();
        let rotation = rotation.to_rotation_matrix();
        for (n, expected) in numbers("close_from_cam")[9 * i..9 * i + 9]
            .iter()
            .enumerate()
        {
            close(rotation[(n / 3, n % 3)], *expected, 1e-9);
        }
        let ours = picture(&closeup, &real, &image);
        let area = size * size;
        for pixel in 0..area {
            let theirs = &pictures.data()[3 * (i * area + pixel)..][..3];
            let lies_on_it = on_image.data()[i * area + pixel] == 1;
            for channel in 0..3 {
                let got = 255.0 * f64::from(ours[(channel, pixel / size, pixel % size)]);
                if lies_on_it {
                    close(got, f64::from(theirs[channel]), 3.0);
                } else {
                    assert_eq!(got, 0.0);
                }
            }
        }
    }
}
