//! Keys beside those that are read: named, or harmless.

use super::*;

#[test]
fn keys_that_are_not_known_are_named_unless_they_are_to_be_ignored() {
    for (key, more) in [
        ("k", format!(r#""k": {D}"#)),
        (
            "undistortion_coeffs",
            format!(r#""undistortion_coeffs": {D}"#),
        ),
        ("kappa", r#""kappa": -0.2"#.into()),
        ("cam_k1", r#""cam_k1": -0.1"#.into()),
        ("poly", r#""poly": [0.1, 0.2]"#.into()),
        ("gamma", r#""gamma": 1.5"#.into()),
        ("fov", r#""fov": 0.92"#.into()),
        ("dist", r#""dist": "-0.1 0.02 0 0 0""#.into()),
        ("k1", r#""k1": "-0.1""#.into()),
        ("dist0", format!(r#""dist0": {D}"#)),
        ("dist_left", format!(r#""dist_left": {D}"#)),
        (
            "thin_prism",
            format!(r#""D": {D}, "thin_prism": [0.1, 0, 0, 0]"#),
        ),
        (
            "T_wc",
            r#""T_wc": [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"#.into(),
        ),
        ("xyz", r#""xyz": [0.1, 0.2, 0.3]"#.into()),
        ("q", r#""q": [0.7, 0, 0, 0.7]"#.into()),
        ("axes", r#""axes": "OpenGL""#.into()),
        ("flip_x", r#""flip_x": true"#.into()),
        ("sensor_name", r#""sensor_name": "omni""#.into()),
        ("warp", r#""warp": [{"r2": 0.1}]"#.into()),
    ] {
        let text = format!("{{{K}, {SIZE}, {more}}}");
        let error = refusal(&[("a.json", &text)], &Options::default());
        assert!(
            error.contains(&format!("the key `{key}` is not known")),
            "{key}: {error}"
        );
        assert!(
            error.contains(&format!("(--ignore {key})")),
            "{key}: {error}"
        );
        let ignoring = Options {
            ignore: vec![key.into()],
            ..Options::default()
        };
        assert!(read(&[("a.json", &text)], &ignoring).is_ok(), "{key}");
    }
}

#[test]
fn what_programs_write_beside_a_camera_is_left_alone() {
    for more in [
        r#""calibration_time": "Sat 28", "nframes": 13, "board_width": 9, "square_size": 25.0, "flags": 2"#,
        r#""avg_reprojection_error": 0.25, "per_view_reprojection_errors": [0.2, 0.3], "aspectRatio": 1.0"#,
        r#""extrinsic_parameters": [[0.1, 0.2, 0.3, 1, 2, 3], [0.1, 0.2, 0.3, 1, 2, 4]]"#,
        r#""R1": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "P1": [[9, 0, 3, 0], [0, 9, 2, 0], [0, 0, 1, 0]]"#,
        r#""name": "00_01", "type": "hd", "panel": 0, "node": 1, "serial": "1234567", "exposure_us": 900"#,
        r#""fisheye": false, "std_intrinsics": [0.1, 0.2], "lens": "8 mm", "focal_length_mm": 8, "ret": 0.3"#,
    ] {
        let text = format!(r#"{{{K}, {SIZE}, "dist": {D}, {more}}}"#);
        let imported = read(&[("a.json", &text)], &Options::default());
        assert!(imported.is_ok(), "{more}: {}", imported.unwrap_err());
    }
}

#[test]
fn words_of_a_lens_or_a_place_outrank_harmless_ones() {
    let pose = "[[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]";
    for (key, value) in [
        ("calibrated_distortion", D),
        ("calibrated_dist_coeffs", D),
        ("best_distortion", D),
        ("first_distortion", D),
        ("updatedDistortion", D),
        ("unrectified_distortion", D),
        ("target_distortion", D),
        ("distortion_at_temperature", D),
        ("Calibrated_Distortion", D),
        ("radial_distances", D),
        ("optimal_new_camera", D),
        (
            "calibrated_K",
            "[[1100, 0, 633], [0, 1100, 481], [0, 0, 1]]",
        ),
        ("distortion_grid", "[[[0.1, 0.2], [0.3, 0.4]]]"),
        ("k1_updated", "0.1"),
        ("calibrated_pose", pose),
        ("T_target_cam", pose),
        ("updated_image_size", "[640, 480]"),
        ("fisheye_flag", "true"),
        (
            "extrinsic_parameters",
            "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]",
        ),
        ("images", r#"[{"T_wc": [1, 2, 3]}]"#),
    ] {
        let text = format!(r#"{{{K}, {SIZE}, "D": [0, 0, 0, 0], "{key}": {value}}}"#);
        let error = refusal(&[("a.json", &text)], &Options::default());
        let named = key == "images" || error.contains(&format!("the key `{key}` is not known"));
        assert!(named, "{key}: {error}");
    }
    for (key, value) in [
        ("board_size", "[9, 6]"),
        ("boardSize", "[9, 6]"),
        ("rms_error", "0.3"),
        ("intrinsics_std", "[0.1, 0.2]"),
        ("distortion_uncertainty", "[0.1, 0.2]"),
        ("timestamp", "1700000000"),
        ("calibration_time", "12"),
        ("pixelSize", "[3.45, 3.45]"),
        ("sensor_width_mm", "8.5"),
        ("validPixROI1", "[10, 12, 1200, 900]"),
        (
            "rectified_camera_matrix",
            "[[1100, 0, 633], [0, 1100, 481], [0, 0, 1]]",
        ),
        (
            "newCameraMatrix",
            "[[1100, 0, 633], [0, 1100, 481], [0, 0, 1]]",
        ),
        ("calibrated", "1"),
        ("frames", "120"),
        (
            "header",
            r#"{"seq": 5, "stamp": {"sec": 1, "nanosec": 2}, "frame_id": "left"}"#,
        ),
    ] {
        let text = format!(r#"{{{K}, {SIZE}, "D": {D}, "{key}": {value}}}"#);
        let imported = read(&[("a.json", &text)], &Options::default());
        assert!(imported.is_ok(), "{key}: {}", imported.unwrap_err());
    }
}

#[test]
fn each_key_is_named_once_with_what_ignores_all() {
    let camera = format!(r#"{{{K}, {SIZE}, "D": {D}, "kappa": 0.1, "warp": 0.2}}"#);
    let text = format!(r#"{{"left": {camera}, "right": {camera}}}"#);
    let error = refusal(&[("a.json", &text)], &placed());
    assert!(
        error.contains("the keys `kappa`, `warp` are not known")
            && error.contains("(--ignore kappa --ignore warp)"),
        "{error}"
    );
}
