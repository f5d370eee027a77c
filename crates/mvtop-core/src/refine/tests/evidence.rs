//! Texture gain and visible share of a square, worked by hand.

use super::*;
use crate::bundle::SurfacePoint;

/// Half the side of the square, metres.
const HALF: f64 = 0.05;

/// A square across the line of sight, and points on it that are dark on the left half.
fn square() -> (Mesh, Vec<SurfacePoint>) {
    let mesh = surface(1, 1, [120; 3], |u, v| {
        Point3::new((2.0 * u - 1.0) * HALF, (2.0 * v - 1.0) * HALF, 0.0)
    });
    let place = |i: u32| (f64::from(i) + 0.5) / 40.0 * 2.0 * HALF - HALF;
    let points = (0..1600).map(|i| SurfacePoint {
        position: [place(i % 40), place(i / 40), 0.0],
        color: [if i % 40 < 20 { 60 } else { 180 }; 3],
    });
    (mesh, points.collect())
}

/// A camera at the origin that looks along z.
fn straight() -> Camera {
    let middle = (f64::from(SIDE) - 1.0) / 2.0;
    let pinhole = Intrinsics::new(600.0, 600.0, middle, middle, Projection::Pinhole).unwrap();
    Camera::new("straight", [SIDE; 2], pinhole, Isometry3::identity()).unwrap()
}

/// Evidence of the square at a place in an image that is dark on the left of a column.
fn evidence(at: [f64; 3], column: u32) -> ViewQuality {
    let (mesh, points) = square();
    let diameter = 2.0 * HALF * 2f64.sqrt();
    let config = RefineConfig {
        texture: TextureConfig {
            blur: [1e-6; 2],
            ..TextureConfig::default()
        },
        ..RefineConfig::default()
    };
    let refiner = Refiner::with_config(&mesh, diameter, config).with_texture(&points);
    let (camera, mut image) = (straight(), RgbImage::new(SIDE, SIDE));
    for (u, _, pixel) in image.enumerate_pixels_mut() {
        *pixel = Rgb([if u < column { 60 } else { 180 }; 3]);
    }
    let view = View {
        camera: &camera,
        image: &Pyramid::new(&image),
    };
    let pose = Isometry3::translation(at[0], at[1], at[2]);
    refiner.quality(&[view], &pose).unwrap().views[0]
}

#[test]
fn texture_gain_is_the_correlation_less_that_of_displaced_points() {
    // Up and down nothing changes. To the left or right, 0.1 of the diagonal is 0.1414 of the side, so
    // that a share s = 0.1414 of the points shows the other half. With values of -1 and 1 the
    // image's mean is 2 s = 0.283, its variance 1 - 0.08 = 0.92, and the correlation
    // (1 - 2 s) / sqrt(0.92) = 0.7477.
    let found = evidence([0.0, 0.0, 0.6], SIDE / 2);
    let correlation = found.texture_correlation.unwrap();
    assert!((correlation - 1.0).abs() < 0.02, "{correlation}");
    let gain = found.texture_gain.unwrap();
    assert!((gain - (1.0 - 0.7477) / 2.0).abs() < 0.02, "{gain}");
    // Displaced in the image by 0.2 of the side (100 px), the border fits better on one side:
    // s = 0.2 gives 0.6 / sqrt(1 - 0.16) = 0.655; s = 0.0586 gives 0.8828 / sqrt(1 - 0.0137) = 0.889;
    // s = 0.3414 gives 0.3172 / sqrt(1 - 0.466) = 0.434. The gain is
    // 0.655 - (2 * 0.655 + 0.889 + 0.434) / 4 = -0.003.
    let beside = evidence([0.0, 0.0, 0.6], SIDE / 2 + 20);
    let correlation = beside.texture_correlation.unwrap();
    assert!((correlation - 0.655).abs() < 0.03, "{correlation}");
    let gain = beside.texture_gain.unwrap();
    assert!((gain + 0.003).abs() < 0.02, "{gain}");
}

#[test]
fn visible_share_is_that_of_the_silhouette_inside_the_image() {
    let share = |x: f64, y: f64| evidence([x, y, 2.4], SIDE / 2).visible_share;
    assert_eq!(share(0.0, 0.0), 1.0);
    // At 2.4 m, 240 px from the middle to the border are 0.96 m. The crop looks at the border from
    // the side, so that the half next to the middle is larger in it by 0.6 %.
    let half = share(0.96, 0.0);
    assert!((half - 0.5).abs() < 0.02, "{half}");
    let quarter = share(0.96, -0.96);
    assert!((quarter - 0.25).abs() < 0.02, "{quarter}");
}
