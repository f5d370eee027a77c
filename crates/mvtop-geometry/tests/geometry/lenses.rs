use std::f64::consts::{FRAC_PI_4, PI};
use std::path::Path;

use mvtop_geometry::{Intrinsics, Projection};
use nalgebra::{Point2, Point3};
use proptest::prelude::*;
use safetensors::SafeTensors;

use super::examples::{brown_conrady, kannala_brandt, lenses, pinhole};

/// Focal length 1 px, principal point (0, 0).
fn unit(projection: Projection) -> Intrinsics {
    Intrinsics::new(1.0, 1.0, 0.0, 0.0, projection).unwrap()
}

fn project(lens: &Intrinsics, x: f64, y: f64, z: f64) -> Option<[f64; 2]> {
    lens.project(&Point3::new(x, y, z)).map(|p| [p.x, p.y])
}

fn unproject(lens: &Intrinsics, u: f64, v: f64) -> Option<[f64; 3]> {
    lens.unproject(&Point2::new(u, v))
        .map(|ray| [ray.x, ray.y, ray.z])
}

fn assert_close<const N: usize>(got: Option<[f64; N]>, expected: [f64; N]) {
    let got = got.expect("a point");
    let far = got.iter().zip(expected).any(|(a, b)| (a - b).abs() > 1e-12);
    assert!(!far, "{got:?} instead of {expected:?}");
}

#[test]
fn pinhole_by_hand() {
    let lens = pinhole(600.0, 320.0, 240.0);
    assert_close(project(&lens, 1.0, 2.0, 4.0), [470.0, 540.0]);
    assert_close(unproject(&lens, 770.0, 240.0), [0.6, 0.0, 0.8]);
}

#[test]
fn brown_conrady_by_hand() {
    let radial = unit(brown_conrady(&[0.1, 0.0, 0.0, 0.0]));
    assert_close(project(&radial, 1.0, 0.0, 2.0), [0.5125, 0.0]);
    let tangential = unit(brown_conrady(&[0.0, 0.0, 0.01, 0.0]));
    assert_close(project(&tangential, 1.0, 0.5, 2.0), [0.5025, 0.254375]);
    let rational = unit(brown_conrady(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]));
    assert_close(
        project(&rational, 0.5, 0.0, 1.0),
        [0.5 / (1.0 + 1.0 / 64.0), 0.0],
    );
}

#[test]
fn skew_moves_x_by_y_for_every_lens() {
    for lens in lenses() {
        let askew = lens.clone().with_skew(-12.5).unwrap();
        assert_eq!(askew.skew(), -12.5);
        for [x, y, z] in [[0.1, 0.2, 1.0], [-0.3, 0.25, 2.0], [0.0, -0.1, 0.5]] {
            let [u, v] = project(&lens, x, y, z).unwrap();
            let down = (v - lens.cy()) / lens.fy();
            let pixel = project(&askew, x, y, z);
            assert_close(pixel, [u - 12.5 * down, v]);
            let [u, v] = pixel.unwrap();
            let ray = unproject(&askew, u, v).unwrap();
            let straight = Point3::new(x, y, z).coords.normalize();
            assert_close(Some(ray), straight.into());
        }
    }
    let lens = pinhole(600.0, 320.0, 240.0);
    let matrix = lens.clone().with_skew(3.0).unwrap().matrix();
    assert_eq!(matrix, [[600., 3., 320.], [0., 600., 240.], [0., 0., 1.]]);
    for wrong in [60.1, -60.1, f64::NAN, f64::INFINITY] {
        let error = lens.clone().with_skew(wrong).unwrap_err().to_string();
        assert!(error.contains("`skew`"), "{error}");
    }
}

#[test]
fn nothing_is_seen_beyond_the_largest_angle() {
    // 100 px from the middle are 30 degrees off the axis of an equidistant lens of 100 / (pi / 6) px.
    let focal = 600.0 / std::f64::consts::PI;
    let fisheye = kannala_brandt(&[0.0; 4]);
    let lens = Intrinsics::new(focal, focal, 0.0, 0.0, fisheye).unwrap();
    let limited = lens.clone().with_max_angle(30.0).unwrap();
    assert_eq!(limited.max_angle_deg(), Some(30.0));
    for degrees in [-29.9f64, 0.0, 29.9, 30.1, 90.0, 179.0] {
        let (x, z) = degrees.to_radians().sin_cos();
        let within = degrees.abs() < 30.0;
        let all = project(&lens, 2.0 * x, 0.0, 2.0 * z);
        let kept = project(&limited, 2.0 * x, 0.0, 2.0 * z);
        assert_eq!(kept, all.filter(|_| within), "{degrees}");
        let pixel = degrees * 10.0 / 3.0;
        let (all, kept) = (
            unproject(&lens, pixel, 0.0),
            unproject(&limited, pixel, 0.0),
        );
        assert!(all.is_some());
        assert_eq!(kept, all.filter(|_| within), "{degrees}");
    }
    for wrong in [0.0, -1.0, 180.1, f64::NAN, f64::INFINITY] {
        let error = lens.clone().with_max_angle(wrong).unwrap_err().to_string();
        assert!(error.contains("max_angle_deg"), "{error}");
    }
}

#[test]
fn thin_prism_and_tilt_by_hand() {
    let eight = [0.0; 8];
    let with = |more: &[f64]| unit(brown_conrady(&[&eight, more].concat()));
    // r² = 0.25 + 0.0625 = 0.3125: x + s1 r² + s2 r⁴, y + s3 r² + s4 r⁴.
    let prism = with(&[0.1, 0.2, -0.1, 0.4]);
    assert_close(project(&prism, 0.5, 0.25, 1.0), [0.55078125, 0.2578125]);
    // A sensor turned by 60° about its x axis: the plane's point in the sensor's frame, seen along its
    // axis again.
    let tilted = with(&[0.0, 0.0, 0.0, 0.0, 60f64.to_radians(), 0.0]);
    let (cos, sin) = (0.5, 0.75f64.sqrt());
    let (x, y, z) = (0.2, 0.1 * cos + sin, cos - 0.1 * sin);
    assert_close(
        project(&tilted, 0.2, 0.1, 1.0),
        [cos * x / z, (cos * y - sin * z) / z],
    );
}

#[test]
fn coefficients_that_are_0_at_the_end_are_left_out() {
    let projection = |params: &[f64]| brown_conrady(&[&[0.1; 8], params].concat());
    assert_eq!(projection(&[0.0; 4]), brown_conrady(&[0.1; 8]));
    assert_eq!(projection(&[0.0; 6]).params(), [0.1; 8]);
    let prism = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(projection(&prism).params().len(), 12);
}

#[test]
fn kannala_brandt_by_hand() {
    let lens = unit(kannala_brandt(&[0.1, 0.0, 0.0, 0.0]));
    let radius = FRAC_PI_4 * (1.0 + 0.1 * FRAC_PI_4 * FRAC_PI_4);
    assert_close(project(&lens, 0.0, 3.0, 3.0), [0.0, radius]);
    assert_close(project(&lens, 0.0, 0.0, 1.0), [0.0, 0.0]);
}

#[test]
fn fisheyes_see_behind_the_image_plane_and_pinholes_do_not() {
    let fisheye = unit(kannala_brandt(&[0.0; 4]));
    assert_close(project(&fisheye, 1.0, 0.0, -1.0), [3.0 * FRAC_PI_4, 0.0]);
    assert_eq!(
        project(&fisheye, 0.0, 0.0, -1.0),
        None,
        "all directions are alike there"
    );
    assert_eq!(unproject(&fisheye, PI + 0.01, 0.0), None);
    for distortion in [Projection::Pinhole, brown_conrady(&[0.1, 0.0, 0.0, 0.0])] {
        let lens = unit(distortion);
        assert_eq!(project(&lens, 1.0, 0.0, -1.0), None);
        assert_eq!(project(&lens, 1.0, 0.0, 0.0), None);
    }
}

#[test]
fn nothing_is_imaged_past_the_fold() {
    // r (1 - r²/2) rises up to r = √(2/3), where it is 0.5443.
    let lens = unit(brown_conrady(&[-0.5, 0.0, 0.0, 0.0]));
    assert_close(project(&lens, 0.8, 0.0, 1.0), [0.544, 0.0]);
    assert_eq!(project(&lens, 0.83, 0.0, 1.0), None);
    assert_eq!(project(&lens, 10.0, 0.0, 1.0), None);
    assert!(unproject(&lens, 0.544, 0.0).is_some());
    assert_eq!(unproject(&lens, 0.545, 0.0), None);
    // r / (1 - r²) has its pole at r = 1; beyond it the image would be mirrored.
    let lens = unit(brown_conrady(&[0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0]));
    assert_close(project(&lens, 0.9, 0.0, 1.0), [0.9 / 0.19, 0.0]);
    assert_eq!(project(&lens, 1.1, 0.0, 1.0), None);
    // θ (1 - θ²/3) rises up to θ = 1, where it is 2/3.
    let lens = unit(kannala_brandt(&[-1.0 / 3.0, 0.0, 0.0, 0.0]));
    assert!(project(&lens, 0.99_f64.tan(), 0.0, 1.0).is_some());
    assert_eq!(project(&lens, 1.01_f64.tan(), 0.0, 1.0), None);
    assert!(unproject(&lens, 0.666, 0.0).is_some());
    assert_eq!(unproject(&lens, 0.667, 0.0), None);
}

#[test]
fn every_registered_projection_is_in_the_list() {
    for &(family, distortion) in Projection::NAMES {
        let listed = lenses().into_iter().any(|lens| {
            let projection = lens.projection();
            (projection.family(), projection.distortion()) == (family, Some(distortion))
        });
        assert!(listed, "{family} with {distortion}");
    }
}

#[test]
fn every_lens_returns_to_its_pixel() {
    for lens in lenses() {
        for u in (0..640).step_by(13) {
            for v in (0..480).step_by(13) {
                let pixel = Point2::new(f64::from(u), f64::from(v));
                let ray = lens
                    .unproject(&pixel)
                    .unwrap_or_else(|| panic!("{lens:?}: {pixel}"));
                let back = lens
                    .project(&Point3::from(ray.scale(2.5)))
                    .expect("a pixel");
                assert!(
                    (back - pixel).norm() < 1e-8,
                    "{lens:?}: {pixel} came back as {back}"
                );
            }
        }
    }
}

#[test]
fn every_lens_agrees_with_opencv() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/lens.safetensors");
    let bytes = std::fs::read(path).unwrap();
    let fixture = SafeTensors::deserialize(&bytes).unwrap();
    let numbers = |name: &str, field: &str| -> Vec<f64> {
        let tensor = fixture.tensor(&format!("{name}.{field}")).unwrap();
        let chunks = tensor.data().chunks_exact(8);
        chunks
            .map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap()))
            .collect()
    };
    for name in [
        "pinhole_0",
        "pinhole_4",
        "pinhole_5",
        "pinhole_8",
        "pinhole_12",
        "pinhole_14",
        "fisheye",
    ] {
        let params = numbers(name, "params");
        let (family, _) = name.split_once('_').unwrap_or((name, ""));
        let projection = Projection::from_params(family, None, &params).unwrap();
        let [fx, fy, cx, cy] = numbers(name, "intrinsics").try_into().unwrap();
        let lens = Intrinsics::new(fx, fy, cx, cy, projection).unwrap();
        let (points, pixels) = (numbers(name, "points"), numbers(name, "pixels"));
        assert_eq!(points.len() / 3, 64);
        for (point, pixel) in points.chunks(3).zip(pixels.chunks(2)) {
            let (point, pixel) = (Point3::from_slice(point), Point2::from_slice(pixel));
            let got = lens
                .project(&point)
                .unwrap_or_else(|| panic!("{name}: {point}"));
            assert!(
                (got - pixel).norm() < 1e-8,
                "{name}: {point} at {got}, not at {pixel}"
            );
            let ray = lens
                .unproject(&pixel)
                .unwrap_or_else(|| panic!("{name}: {pixel}"));
            let angle = ray.angle(&point.coords);
            // acos resolves no better than the root of f64's precision.
            assert!(
                angle < 1e-7,
                "{name}: {pixel} looks {angle} rad past {point}"
            );
        }
    }
}

fn any_distortion() -> impl Strategy<Value = Projection> {
    let k = -0.5..0.5f64;
    let p = -0.005..0.005f64;
    let rational = [
        k.clone(),
        k.clone(),
        p.clone(),
        p,
        k.clone(),
        k.clone(),
        k.clone(),
        k,
    ];
    prop_oneof![
        Just(Projection::Pinhole),
        (
            rational,
            prop_oneof![Just(0), Just(4), Just(5), Just(8usize)]
        )
            .prop_map(|(params, count)| brown_conrady(&params[..count])),
        [-0.1..0.1f64, -0.1..0.1, -0.1..0.1, -0.1..0.1].prop_map(|k| kannala_brandt(&k)),
    ]
}

/// A rational lens whose factor has a pole at the fold: a search that starts there never comes back.
#[test]
fn a_point_far_outside_the_image_is_found_again_under_a_lens_with_a_pole() {
    let (k1, k4, k6) = (
        0.37170297771149613,
        -0.3494232821645114,
        -0.031174266543974614,
    );
    let projection = brown_conrady(&[k1, 0.0, 0.0, 0.0, 0.0, k4, 0.0, k6]);
    let lens = Intrinsics::new(500.0, 500.0, 320.0, 240.0, projection).unwrap();
    let point = Point3::new(0.0, -1.0164053241369115, 1.086220529326746);
    let pixel = lens.project(&point).expect("imaged");
    assert!((pixel.y + 681.28).abs() < 0.01, "{pixel}");
    let ray = lens.unproject(&pixel).expect("has a ray");
    assert!(ray.angle(&point.coords) < 1e-7);
}

proptest! {
    #[test]
    fn every_imaged_point_is_found_again(
        distortion in any_distortion(),
        x in -1.5..1.5f64,
        y in -1.5..1.5f64,
        z in -0.5..1.5f64,
    ) {
        let lens = Intrinsics::new(500.0, 500.0, 320.0, 240.0, distortion).unwrap();
        let point = Point3::new(x, y, z);
        if let Some(pixel) = lens.project(&point) {
            let ray = lens.unproject(&pixel);
            prop_assert!(ray.is_some(), "{pixel} has no ray");
            let back = lens.project(&Point3::from(ray.unwrap().into_inner()));
            let allowed = 1e-6 * (1.0 + pixel.coords.norm());
            prop_assert!(back.is_some_and(|back| (back - pixel).norm() < allowed));
        }
    }

    #[test]
    fn no_number_makes_a_lens_panic(
        params in prop::array::uniform8(any::<f64>()),
        intrinsics in prop::array::uniform4(any::<f64>()),
        point in prop::array::uniform3(any::<f64>()),
    ) {
        let [fx, fy, cx, cy] = intrinsics;
        let projections = [
            Ok(Projection::Pinhole),
            Projection::from_params("pinhole", None, &params),
            Projection::from_params("fisheye", None, &params[..4]),
        ];
        for projection in projections.into_iter().flatten() {
            // Any numbers as they are, and a usable camera for any coefficients.
            let lenses = [[fx, fy, cx, cy], [500.0, 510.0, 320.0, 240.0]]
                .map(|[fx, fy, cx, cy]| Intrinsics::new(fx, fy, cx, cy, projection.clone()));
            for lens in lenses.into_iter().flatten() {
                if let Some(pixel) = lens.project(&Point3::from(point)) {
                    prop_assert!(pixel.iter().all(|c| c.is_finite()));
                }
                if let Some(ray) = lens.unproject(&Point2::new(point[0], point[1])) {
                    prop_assert!((ray.norm() - 1.0).abs() < 1e-9);
                }
            }
        }
    }
}
