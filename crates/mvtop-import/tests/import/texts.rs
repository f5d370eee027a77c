//! Texts and flags that are not known are refused as numbers are, unless their key or their value says nothing of a
//! lens, a place or a size.

use mvtop_import::{Options, Unit};

use crate::{assert_params, read, refusal};

const CAMERA: &str = r#""K": [[905.5, 0, 643.2], [0, 903.1, 478.9], [0, 0, 1]], "image_size": [1280, 960],
    "rvec": [0.1, 0.2, 0.3], "tvec": [1, 2, 3]"#;
const D: &str = r#""D": [-0.21, 0.08, 0.0011, -0.0007, -0.012]"#;

fn metre() -> Options {
    Options {
        unit: Some(Unit::Metre),
        ..Options::default()
    }
}

/// A camera with further entries, and what of them is refused.
fn refused(more: &str) -> String {
    let text = format!("{{{CAMERA}, {D}, {more}}}");
    let error = refusal(&[("a.json", &text)], &metre());
    assert!(error.contains("not known and may state"), "{more}: {error}");
    error
}

#[test]
fn texts_and_flags_of_a_convention_are_named() {
    for (key, value) in [
        // What a place maps to what, and what it is relative to.
        ("c2w", "true"),
        ("extrinsics_are_c2w", "true"),
        ("mapping", r#""camera_to_world""#),
        ("matrix_type", r#""c2w""#),
        ("format", r#""c2w""#),
        ("mode", r#""camera_to_world""#),
        ("world_to_camera", "false"),
        ("world_to_camera", "0"),
        ("from", r#""camera""#),
        ("relative_to", r#""cam0""#),
        ("parent_camera", r#""cam1""#),
        ("reference", r#""cam1""#),
        ("frame_id", r#""world""#),
        // Orders.
        ("coeff_names", r#"["k1", "k2", "k3", "p1", "p2"]"#),
        ("names", r#"["k1", "k2", "k3", "p1", "p2"]"#),
        ("coeffs_order", r#""k1,k2,k3,p1,p2""#),
        ("D_labels", r#""k1 k2 k3 p1 p2""#),
        ("comment", r#""k1 k2 k3 p1 p2""#),
        ("layout", r#""column-major""#),
        ("column_major", "true"),
        ("row_major", "false"),
        ("row_major", r#""no""#),
        ("storage_order", r#""ColMajor""#),
        // Images and pixels.
        ("rot180", "true"),
        ("half_resolution", "true"),
        ("portrait", r#""yes""#),
        ("rectified", "true"),
        ("undistorted", "true"),
        ("distorted", "false"),
        ("images", r#""undistorted""#),
        ("calibrated_for", r#""640x480""#),
        ("calibrated_at", r#""640x480""#),
        ("pixel_origin", r#""corner""#),
        ("one_based", "true"),
        ("zero_based", "false"),
        // Lenses and axes.
        ("equirectangular", "true"),
        ("orthographic", "true"),
        ("sensor", r#""fisheye""#),
        ("device", r#""wide fisheye unit""#),
        ("method", r#""cv2.fisheye.calibrate""#),
        ("left_handed", "true"),
        ("right_handed", "false"),
        ("y_up", "true"),
        ("camera_forward", r#""-z""#),
        ("camera_frame", r#""opengl (RUB)""#),
        ("frame", r#""FLU""#),
        ("source", r#""Blender""#),
        ("engine", r#""Unity 2022""#),
        // Angles and units.
        ("angles", r#""degrees""#),
        ("degrees", "true"),
        ("rvec_format", r#""euler_xyz""#),
        ("measure", r#""inches""#),
        ("in_mm", "true"),
        ("note", r#""mm""#),
        ("description", r#""camera to world""#),
    ] {
        let error = refused(&format!(r#""{key}": {value}"#));
        assert!(error.contains(&format!("`{key}`")), "{key}: {error}");
    }
}

#[test]
fn what_is_inside_an_object_is_not_harmless_by_the_key_around_it() {
    for more in [
        r#""metadata": {"extrinsics": "camera_to_world"}"#,
        r#""info": {"pose": "camera-to-world"}"#,
        r#""device": {"serial": "1", "rotated_deg": 180}"#,
        r#""description": {"extrinsics": "camera_to_world"}"#,
        r#""software": {"extrinsics_convention": "c2w"}"#,
        r#""timestamp": {"crop": [0, 0, 640, 480]}"#,
        r#""exposure": {"binning": 2}"#,
        r#""note": {"unit": "mm"}"#,
        r#""images": {"rotation": 180}"#,
        r#""quality": {"skew": 3.2}"#,
        r#""optics": [{"name": "division"}]"#,
    ] {
        refused(more);
    }
    let board = r#""board": {"type": "charuco", "rows": 6, "cols": 9, "square_size": 25, "dictionary": "DICT_4X4_50"},
        "errors": {"mean": 0.3, "k1": 0.01}, "device": {"name": "D435", "serial_number": "0123"}"#;
    let text = format!("{{{CAMERA}, {D}, {board}}}");
    let imported = read(&[("a.json", &text)], &metre());
    assert!(imported.is_ok(), "{}", imported.unwrap_err());
}

#[test]
fn harmless_texts_and_flags_are_left_alone() {
    for more in [
        r#""calibration_time": "Sat 28 Nov 2026 12:00:00", "flags": "+fix_k3", "camera_name": "left""#,
        r#""topic": "/cam0/image_raw", "rostopic": "/cam0/image_raw", "serial_number": "A1-mm""#,
        r#""firmware": "5.12.7", "product": "RealSense D435", "opencv_version": "4.9.0", "revision": "rev B""#,
        r#""comment": "left-handed screws, 640x480 preview, board in mm", "author": "R. Flu""#,
        r#""date": "2024-05-01", "created_by": "calibrate.py", "made": "2024-05-01T10:11:12", "release": "v1.2.3""#,
        r#""image_dir": "data/left", "board_image": "board.png", "where": "/data/session 3/left""#,
        r#""pixel_format": "Mono8", "color_order": "BGR", "image_type": "png", "dataset": "x", "hostname": "pc""#,
        r#""success": true, "calibrated": true, "fixed": false, "mirrored": false, "legacy_pattern": true"#,
        r#""method": "cv2.calibrateCamera", "rectified": false, "locked": "false", "distortion_note": """#,
        r#""header": {"seq": 5, "stamp": {"sec": 1, "nanosec": 2}, "frame_id": "left"}"#,
    ] {
        let text = format!("{{{CAMERA}, {D}, {more}}}");
        let imported = read(&[("a.json", &text)], &metre());
        assert!(imported.is_ok(), "{more}: {}", imported.unwrap_err());
    }
}

#[test]
fn a_lens_is_named_inside_the_section_of_its_coefficients() {
    let with = |name: &str| {
        format!(
            r#"{{"fx": 905.5, "fy": 903.1, "cx": 643.2, "cy": 478.9, "image_size": [1280, 960],
                "distortion": {{"name": "{name}", "k1": 0.01, "k2": 0.002}}}}"#
        )
    };
    let rig = read(&[("a.json", &with("kannala_brandt"))], &metre())
        .unwrap()
        .rig;
    let camera = &rig.cameras()[0];
    assert_eq!(camera.intrinsics().projection().family(), "fisheye");
    assert_params(camera, &[0.01, 0.002]);
    let error = refusal(&[("a.json", &with("division"))], &metre());
    assert!(error.contains("\"division\" is not known"), "{error}");
}

#[test]
fn other_formats_name_texts_and_flags_as_well() {
    let nerf = |more: &str| {
        format!(
            r#"{{"w": 640, "h": 480, "fl_x": 500, "cx": 320, "cy": 240, {more}, "frames": [{{"file_path": "a.png",
                "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}]}}"#
        )
    };
    for (key, value) in [
        ("w2c", "true"),
        ("opencv_convention", "true"),
        ("from_na", "true"),
        ("latlong", "true"),
        ("rolling_shutter", "[0, 0, 0.1, 0]"),
        ("pose_format", r#""w2c""#),
    ] {
        let text = nerf(&format!(r#""{key}": {value}"#));
        let error = refusal(&[("transforms.json", &text)], &metre());
        assert!(error.contains(&format!("`{key}`")), "{error}");
    }
    let kalibr = "cam0:\n  camera_model: pinhole\n  intrinsics: [500, 500, 320, 240]\n  resolution: [640, 480]\n  \
                  distortion_model: radtan\n  distortion_coeffs: [0.1, 0, 0, 0]\n";
    for (key, value) in [
        ("downsampled", "true"),
        ("intrinsics_order", "fx cx fy cy"),
        ("pose_convention", "imu_from_cam"),
        ("translation", "mm"),
        ("length", "mm"),
    ] {
        let text = format!("{kalibr}  {key}: {value}\n");
        let error = refusal(&[("camchain.yaml", &text)], &metre());
        assert!(error.contains(&format!("`{key}`")), "{error}");
    }
    let halcon = "ParGroup: Camera: Parameter;\nFocus:foc: 0.008;\nKappa:kappa: 0;\nSx:sx: 1e-5;\nSy:sy: 1e-5;\n\
                  Cx:cx: 320;\nCy:cy: 240;\nImageWidth:imgw: 640;\nImageHeight:imgh: 480;\n";
    assert!(read(&[("a.dat", halcon)], &metre()).is_ok());
    let tilt = format!("{halcon}CameraType:camera_type: area_scan_tilt_division;\n");
    let error = refusal(&[("a.dat", &tilt)], &metre());
    assert!(error.contains("`CameraType`"), "{error}");
}
