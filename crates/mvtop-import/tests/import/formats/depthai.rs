use mvtop_import::{Format, Options};

use super::samples::DEPTHAI;
use super::{X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal};

#[test]
fn extrinsics_map_to_the_camera_that_they_name() {
    let imported = read(&[("calib.json", DEPTHAI)], &Options::default()).unwrap();
    assert_eq!(imported.format, Format::DepthAi);
    let [color, left, right] = imported.rig.cameras() else {
        panic!("three cameras")
    };
    assert_eq!(
        [color.id(), left.id(), right.id()],
        ["CAM_A", "CAM_B", "CAM_C"]
    );
    assert_eq!((color.width(), color.height()), (1920, 1080));
    assert_plane(color, [1500.0, 1501.0, 960.0, 540.0]);
    assert_params(color, &[0.1, -0.2, 1e-4, 2e-4, 0.3, 0.01, 0.02, 0.03]);
    assert_eq!(right.intrinsics().projection().family(), "fisheye");
    assert_params(right, &[0.1, 0.0, 0.0, 0.01]);
    // The color camera is the last of the chain, so the world: left -> right -> color.
    assert_pose(color, [0.0; 3], X, Z);
    assert_pose(right, [0.0375, 0.0, 0.0], X, Z);
    // A point at the left camera is 7.5 cm to the right camera's left, whose z is the left one's -x.
    assert_pose(left, [0.0375 - 0.075, 0.0, 0.0], Z, [-1.0, 0.0, 0.0]);
}

#[test]
fn cameras_that_nothing_links_and_unknown_lenses_are_named() {
    for (from, to, expected) in [
        (
            "\"toCameraSocket\": 0",
            "\"toCameraSocket\": 2",
            "extrinsics",
        ),
        (
            "\"cameraType\": 1",
            "\"cameraType\": 2",
            "0 (pinhole) or 1 (fisheye)",
        ),
        (
            "[0.1, 0, 0, 0.01, 0",
            "[0.1, 0, 0, 0.01, 0.5",
            "4 coefficients",
        ),
        ("[2, {", "[1, {", "each socket once"),
        (
            "\"width\": 1920,",
            "\"width\": 1920, \"tilt\": 0.3,",
            "`tilt`",
        ),
    ] {
        assert!(DEPTHAI.contains(from), "{from}");
        let error = refusal(
            &[("a.json", &DEPTHAI.replacen(from, to, 1))],
            &Options::default(),
        );
        assert!(error.contains(expected), "{error}");
    }
}
