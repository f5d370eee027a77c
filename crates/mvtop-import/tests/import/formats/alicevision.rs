use mvtop_import::Format;

use super::samples::ALICEVISION;
use super::{MINUS_Y, X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal, scaled};

#[test]
fn alicevision_has_rotations_by_column_and_principal_points_from_the_corner_or_the_middle() {
    let imported = read(&[("cameras.sfm", ALICEVISION)], &scaled(0.1)).unwrap();
    assert_eq!(imported.format, Format::AliceVision);
    let [left, right] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_plane(left, [500.0, 500.0, 321.5, 238.0]);
    assert_params(left, &[-0.2, 0.05, 0.0, 0.0, 0.01]);
    assert_pose(left, [0.0; 3], X, Z);
    assert_plane(right, [510.0, 510.0, 321.0, 241.0]);
    assert_params(right, &[0.1, 0.02, 0.001, 0.002, 0.03]);
    assert_pose(right, [0.4, 0.2, 0.0], MINUS_Y, Z);
}

#[test]
fn alicevision_s_other_lenses_are_refused() {
    for (from, to, expected) in [
        (
            "radial3",
            "3deanamorphic4",
            "its lens `3deanamorphic4` with 3 coefficients is not known",
        ),
        (
            r#""pixelRatio": "1""#,
            r#""pixelRatio": "2""#,
            "a `pixelRatio` of 2 is not read",
        ),
        (
            r#"["1.5", "-2"]"#,
            r#"["1000", "-2"]"#,
            "`principalPoint` of 1000 -2 is neither near",
        ),
        (
            r#""serialNumber": """#,
            r#""mirrorXi": "0.5", "lens_k": 0.1"#,
            "`lens_k`",
        ),
    ] {
        let text = ALICEVISION.replace(from, to);
        assert_ne!(text, ALICEVISION);
        let error = refusal(&[("cameras.sfm", &text)], &scaled(0.1));
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn alicevision_s_distortion_adds_to_its_type() {
    let with = |kind: &str, distortion: &str, params: &str| {
        ALICEVISION.replace(
            r#""type": "radial3""#,
            &format!(
                r#""type": "{kind}", "distortionType": "{distortion}", "undistortionType": "none",
                "undistortionOffset": ["0", "0"]"#
            ),
        )
        .replace(r#"["-0.2", "0.05", "0.01"]"#, params)
    };
    let three = r#"["-0.2", "0.05", "0.01"]"#;
    for (kind, distortion) in [("pinhole", "radialk3"), ("radial3", "")] {
        let text = with(kind, distortion, three);
        let rig = read(&[("cameras.sfm", &text)], &scaled(0.1)).unwrap().rig;
        assert_params(&rig.cameras()[0], &[-0.2, 0.05, 0.0, 0.0, 0.01]);
    }
    for (kind, distortion, params, words) in [
        (
            "equidistant",
            "none",
            "[]",
            "its lens `equidistant with none`",
        ),
        ("equidistant", "", "[]", "its lens `equidistant`"),
        (
            "equidistant",
            "radialk3",
            three,
            "its lens `equidistant with radialk3`",
        ),
        ("radial3", "none", three, "its lens `radial3 with none`"),
    ] {
        let text = with(kind, distortion, params);
        let error = refusal(&[("cameras.sfm", &text)], &scaled(0.1));
        assert!(error.contains(words), "{error}");
    }
    let undistorted = with("pinhole", "none", "[]").replace(
        r#""undistortionType": "none""#,
        r#""undistortionType": "3deanamorphic4""#,
    );
    let error = refusal(&[("cameras.sfm", &undistorted)], &scaled(0.1));
    assert!(error.contains("the key `undistortionType`"), "{error}");
}
