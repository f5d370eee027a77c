//! What is stated twice must be the same, and numbers must be those of the stated images.

use mvtop_import::{ImageSize, Options};

use crate::formats::samples::{MATLAB, MULTICAL};
use crate::{read, refusal, scaled};

fn camera(plane: [f64; 4], size: &str) -> String {
    let [fx, fy, cx, cy] = plane;
    format!(
        r#"{{"K": [[{fx}, 0, {cx}], [0, {fy}, {cy}], [0, 0, 1]], "D": [-0.05, 0.01, 0, 0, 0], {size}}}"#
    )
}

#[test]
fn a_camera_matrix_and_its_numbers_by_name_are_the_same() {
    let with = |more: &str| {
        format!(
            r#"{{"K": [[905.5, 0, 643.2], [0, 903.1, 478.9], [0, 0, 1]], "dist": [-0.2, 0.1, 0, 0, 0],
                "image_size": [1280, 960], {more}}}"#
        )
    };
    let same = with(r#""fx": 905.5, "fy": 903.1, "cx": 643.2, "cy": 478.9"#);
    assert!(read(&[("a.json", &same)], &Options::default()).is_ok());
    for (more, words) in [
        (
            r#""fx": 452.7, "fy": 451.5, "cx": 321.6, "cy": 239.4"#,
            "`fx` is there twice and different",
        ),
        (
            r#""cx": 321.6"#,
            "`cx` is there twice and different, 321.6 and 643.2",
        ),
    ] {
        let error = refusal(&[("a.json", &with(more))], &Options::default());
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn matlab_s_matrices_and_numbers_are_the_same() {
    let with = |more: &str| MATLAB.replacen("\"Skew\": 0", &format!("\"Skew\": 0, {more}"), 1);
    let same = with(
        r#""FocalLength": [500, 510], "PrincipalPoint": [321, 241], "K": [[500, 0, 321], [0, 510, 241], [0, 0, 1]]"#,
    );
    assert!(read(&[("a.json", &same)], &Options::default()).is_ok());
    for (more, words) in [
        (
            r#""FocalLength": [450, 450]"#,
            "FocalLength or PrincipalPoint is there twice and different",
        ),
        (
            r#""K": [[450, 0, 321], [0, 510, 241], [0, 0, 1]]"#,
            "IntrinsicMatrix is there twice and different",
        ),
    ] {
        let error = refusal(&[("a.json", &with(more))], &Options::default());
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn kalibr_s_chain_and_its_places_at_the_imu_are_the_same() {
    let at = |x: f64| format!("[[1, 0, 0, {x}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]");
    let camera = |more: &str| {
        format!(
            "  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n  \
             intrinsics: [500, 500, 320, 240]\n  resolution: [640, 480]\n{more}"
        )
    };
    let file =
        |first: &str, second: &str| format!("cam0:\n{}cam1:\n{}", camera(first), camera(second));
    let direct = |x: f64| format!("  T_cam_imu: {}\n", at(x));
    let inverse = |x: f64| format!("  T_imu_cam: {}\n", at(x));
    let chain = |x: f64| format!("  T_cn_cnm1: {}\n", at(x));
    let read = |first: &str, second: &str| {
        read(&[("chain.yaml", &file(first, second))], &Options::default())
            .map_err(|error| error.to_string())
    };
    // cam1 from cam0 is cam1 from the IMU times the IMU from cam0.
    assert!(read(&direct(0.1), &(direct(-0.1) + &chain(-0.2))).is_ok());
    assert!(read(&inverse(-0.1), &(inverse(0.1) + &chain(-0.2))).is_ok());
    for (first, second, words) in [
        (
            direct(0.1),
            direct(0.1) + &chain(-0.2),
            "`T_cn_cnm1` and the transform",
        ),
        (
            direct(0.1) + &inverse(0.1),
            direct(0.2),
            "`T_cam_imu` and the inverse of `T_imu_cam`",
        ),
    ] {
        let error = read(&first, &second).unwrap_err();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn intrinsics_of_images_of_another_size_are_refused_unless_the_size_is_confirmed() {
    let size = r#""image_size": [1280, 960]"#;
    for (plane, size, words) in [
        (
            [452.0, 451.0, 320.0, 240.0],
            size,
            "images of 0.50 times its size",
        ),
        (
            [452.0, 451.0, 321.5, 241.0],
            size,
            "images of 0.50 times its size",
        ),
        (
            [452.0, 451.0, 330.0, 250.0],
            size,
            "images of 0.50 times its size",
        ),
        (
            [600.0, 600.0, 427.0, 321.0],
            size,
            "images of 0.67 times its size",
        ),
        (
            [1810.0, 1806.0, 1286.0, 958.0],
            size,
            "images of 2.00 times its size",
        ),
        (
            [905.0, 903.0, 643.0, 479.0],
            r#""width": 960, "height": 1280"#,
            "images of 1280x960 px",
        ),
    ] {
        let text = camera(plane, size);
        let error = refusal(&[("a.json", &text)], &Options::default());
        assert!(error.contains(words), "{plane:?}: {error}");
        let stated = error.split("--image-size ").nth(1).unwrap();
        let confirmed = Options {
            image_sizes: ImageSize::parse(stated.trim_end_matches(')'))
                .into_iter()
                .collect(),
            ..Options::default()
        };
        assert!(read(&[("a.json", &text)], &confirmed).is_ok(), "{plane:?}");
    }
    for plane in [[905.0, 903.0, 643.0, 479.0], [905.0, 903.0, 700.0, 380.0]] {
        assert!(
            read(&[("a.json", &camera(plane, size))], &Options::default()).is_ok(),
            "{plane:?}"
        );
    }
    for focal in [16.0, 35.0] {
        let text = camera([focal, focal, 643.0, 479.0], size).replace("-0.05, 0.01", "0, 0");
        let error = refusal(&[("a.json", &text)], &scaled(1.0));
        assert!(error.contains("give it in px, not in mm"), "{error}");
    }
}

#[test]
fn multical_s_places_are_of_one_master() {
    let text = MULTICAL.replace("right_to_left", "right_to_top");
    let error = refusal(&[("calibration.json", &text)], &scaled(0.1));
    let words = "the master camera `top`, which has no place";
    assert!(error.contains(words), "{error}");
}

#[test]
fn colmap_s_images_have_a_line_of_points_each() {
    let cameras = "1 PINHOLE 640 480 500 500 320 240\n";
    let image = |id: u32, points: &str| format!("{id} 1 0 0 0 {id} 0 0 1 c{id}.png\n{points}");
    let with = |points: &str| {
        let images = image(1, points) + &image(2, points) + &image(3, points);
        let files = [("cameras.txt", cameras), ("images.txt", &*images)];
        read(&files, &scaled(1.0)).map(|imported| imported.rig.cameras().len())
    };
    for points in ["\n", "1.5 2.5 -1 3.5 4 7\n"] {
        assert_eq!(with(points).unwrap(), 3, "{points:?}");
    }
    for points in ["", "1.5 2.5\n", "a b c\n"] {
        let error = with(points).unwrap_err().to_string();
        assert!(
            error.contains("line 2: expected the points of image 1"),
            "{error}"
        );
    }
}
