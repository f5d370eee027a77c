use mvtop_import::Format;

use crate::{assert_params, read, refusal, scaled};

/// A file with more of all frames, and of its one frame.
fn file(top: &str, frame: &str) -> String {
    format!(
        r#"{{"w": 640, "h": 480, "fl_x": 500, "cx": 320, "cy": 240{top}, "frames": [{{"file_path": "a.png",
            "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]{frame}}}]}}"#
    )
}

#[test]
fn nerf_s_keys_of_scenes_and_training_are_left_alone() {
    let top = r#", "camera_model": "OPENCV", "k1": 0.1, "camera_angle_x": 1.1388, "aabb_scale": 16, "scale": 0.33,
        "offset": [0.5, 0.5, 0.5], "applied_transform": [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]],
        "applied_scale": 0.5, "ply_file_path": "a.ply", "train_filenames": ["a.png"], "is_fisheye": false"#;
    let frame = r#", "colmap_im_id": 7, "sharpness": 31.5, "depth_file_path": "a.exr", "mask_path": "m.png",
        "rotation": 0.0125, "time": 0.2"#;
    let imported = read(&[("transforms.json", &file(top, frame))], &scaled(1.0)).unwrap();
    assert_eq!(imported.format, Format::Nerf);
    assert_params(&imported.rig.cameras()[0], &[0.1]);
}

#[test]
fn nerf_s_other_keys_and_contradictions_are_named() {
    for more in [
        r#""D": [0.1, 0, 0, 0]"#,
        r#""d": 0.1"#,
        r#""kappa": 0.1"#,
        r#""K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]]"#,
        r#""intrinsics": [500, 500, 320, 240]"#,
        r#""type": "fisheye""#,
        r#""model": "fisheye""#,
        r#""camera_type": "fisheye""#,
        r#""projection": "equirect""#,
        r#""convention": "opencv""#,
        r#""b1": 5"#,
        r#""shift_x": 0.1"#,
        r#""flip": 1"#,
        r#""rotate": 90"#,
        r#""from_mitsuba": true"#,
        r#""w2c": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]"#,
    ] {
        let key = more.split('"').nth(1).unwrap();
        let more = format!(", {more}");
        for text in [file(&more, ""), file("", &more)] {
            let error = refusal(&[("transforms.json", &text)], &scaled(1.0));
            assert!(
                error.contains(&format!("the key `{key}` is not known")),
                "{error}"
            );
        }
    }
    for (more, words) in [
        (
            r#", "camera_model": "OPENCV", "is_fisheye": true, "k1": 0.1"#,
            "do not agree",
        ),
        (
            r#", "camera_model": "OPENCV_FISHEYE", "is_fisheye": false"#,
            "do not agree",
        ),
        (r#", "is_fisheye": [1]"#, "expected true or false"),
        (
            r#", "camera_model": "PINHOLE", "k1": 0.1"#,
            "without distortion has coefficients",
        ),
        (
            r#", "camera_angle_x": 0.6"#,
            "the focal length of `camera_angle_x`",
        ),
    ] {
        let error = refusal(&[("transforms.json", &file(more, ""))], &scaled(1.0));
        assert!(error.contains(words), "{error}");
    }
}
