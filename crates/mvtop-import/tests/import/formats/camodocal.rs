use mvtop_import::{Format, Options};
use nalgebra::Point3;

use super::{X, Y, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal};

const PINHOLE: &str = "%YAML:1.0\n---\nmodel_type: PINHOLE\ncamera_name: camera\nimage_width: 752\nimage_height: 480\n\
    distortion_parameters:\n   k1: -0.2\n   k2: 0.05\n   p1: 0.001\n   p2: -0.002\nprojection_parameters:\n   \
    fx: 460\n   fy: 461\n   cx: 367\n   cy: 248\n";
const KANNALA: &str = "%YAML:1.0\n---\nmodel_type: KANNALA_BRANDT\ncamera_name: camera\nimage_width: 640\nimage_height: \
    480\nprojection_parameters:\n   k2: 0.1\n   k3: 0.02\n   k4: 0.003\n   k5: 0.0004\n   mu: 300\n   mv: 301\n   \
    u0: 320\n   v0: 240\n";
const VINS: &str = "%YAML:1.0\n---\nimu: 1\ncam0_calib: \"right.yaml\"\ncam1_calib: \"left.yaml\"\nimage_width: 752\n\
    body_T_cam0: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n   data: [ 1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0, 0, \
    0, 0, 1 ]\nbody_T_cam1: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n   data: [ 0, -1, 0, 0.2, 1, 0, 0, 0, 0, \
    0, 1, 0, 0, 0, 0, 1 ]\n";

#[test]
fn camodocal_cameras_stand_in_the_body_of_vins() {
    let files = [
        ("left.yaml", PINHOLE),
        ("right.yaml", KANNALA),
        ("vins.yaml", VINS),
    ];
    let imported = read(&files, &Options::default()).unwrap();
    assert_eq!(imported.format, Format::Camodocal);
    let [left, right] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!((left.id(), right.id()), ("left", "right"));
    assert_plane(left, [460.0, 461.0, 367.0, 248.0]);
    assert_params(left, &[-0.2, 0.05, 0.001, -0.002]);
    assert_plane(right, [300.0, 301.0, 320.0, 240.0]);
    let lens = right.intrinsics().projection();
    assert_eq!(lens.distortion(), Some("kannala_brandt"));
    assert_params(right, &[0.1, 0.02, 0.003, 0.0004]);
    assert_pose(left, [0.2, 0.0, 0.0], Y, Z);
    assert_pose(right, [0.1, 0.0, 0.0], X, Z);
    let error = refusal(&files[..2], &Options::default());
    assert!(
        error.contains("give VINS' file with body_T_cam0"),
        "{error}"
    );
}

#[test]
fn mei_is_a_sphere_before_a_pinhole() {
    let text = PINHOLE
        .replace("PINHOLE", "MEI")
        .replace("fx: 460", "gamma1: 920")
        .replace("fy: 461", "gamma2: 922")
        .replace("cx:", "u0:")
        .replace("cy:", "v0:")
        .replace("p1: 0.001", "p1: 0")
        .replace("p2: -0.002", "p2: 0")
        + "mirror_parameters:\n   xi: 1.0\n";
    let imported = read(&[("a.yaml", &text)], &Options::default()).unwrap();
    let camera = &imported.rig.cameras()[0];
    // A ray at 30 degrees: the sphere's point (1/2, 0, √3/2) is seen from 1 behind at r = 1/2 / (√3/2 + 1).
    let r: f64 = 0.5 / (0.75f64.sqrt() + 1.0);
    let x = 920.0 * r * (1.0 - 0.2 * r * r + 0.05 * r.powi(4)) + 367.0;
    let pixel = camera
        .intrinsics()
        .project(&Point3::new(0.5, 0.0, 0.75f64.sqrt()))
        .unwrap();
    assert!(
        (pixel.x - x).abs() < 0.1,
        "{} instead of {x}: {:?}",
        pixel.x,
        imported.notes
    );
    assert!((pixel.y - 248.0).abs() < 0.01, "{}", pixel.y);
}

#[test]
fn a_camera_that_no_rig_has_is_named() {
    let text = PINHOLE.replace("PINHOLE", "SCARAMUZZA");
    let error = refusal(&[("a.yaml", &text)], &Options::default());
    assert!(error.contains("got \"SCARAMUZZA\""), "{error}");
}

#[test]
fn what_is_of_another_kind_or_not_known_is_named() {
    let list = PINHOLE.replace(
        "distortion_parameters:\n   k1: -0.2\n   k2: 0.05\n   p1: 0.001\n   p2: -0.002\n",
        "distortion_parameters: [-0.2, 0.05, 0.001, -0.002]\n",
    );
    let error = refusal(&[("a.yaml", &list)], &Options::default());
    assert!(
        error.contains("`distortion_parameters`: expected an object"),
        "{error}"
    );
    for more in [
        "kappa: 0.1",
        "k3: 0.2",
        "model: fisheye",
        "roi: [8, 8, 100, 100]",
        "rotate: 90",
    ] {
        let key = more.split(':').next().unwrap();
        let error = refusal(
            &[("a.yaml", &format!("{PINHOLE}{more}\n"))],
            &Options::default(),
        );
        assert!(
            error.contains(&format!("the key `{key}` is not known")),
            "{error}"
        );
    }
    let file = VINS.replace("cam0_calib: \"right.yaml\"", "cam0_calib: [1]");
    let files = [
        ("left.yaml", PINHOLE),
        ("right.yaml", KANNALA),
        ("vins.yaml", &file),
    ];
    let error = refusal(&files, &Options::default());
    assert!(error.contains("`cam0_calib`: expected text"), "{error}");
}
