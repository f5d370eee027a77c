use mvtop_geometry::Camera;
use mvtop_import::{Direction, Options};

use super::{X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal, scaled};

fn camera(text: &str, options: &Options) -> Camera {
    read(&[("a.json", text)], options).unwrap().rig.cameras()[0].clone()
}

#[test]
fn focal_lengths_and_coefficients_may_have_keys_of_their_own() {
    let text = r#"{"cameras": [{"id": "left", "width": 640, "height": 480, "fx": 500, "fy": 510, "cx": 321, "cy": 239,
        "k1": -0.2, "k2": 0.05, "p1": 0.001, "p2": -0.002, "k3": 0.01, "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "t": [-200, 0, 0]}]}"#;
    let options = Options {
        direction: Some(Direction::CamFromWorld),
        ..scaled(0.001)
    };
    let left = camera(text, &options);
    assert_eq!(left.id(), "left");
    assert_plane(&left, [500.0, 510.0, 321.0, 239.0]);
    assert_params(&left, &[-0.2, 0.05, 0.001, -0.002, 0.01]);
    assert_pose(&left, [0.2, 0.0, 0.0], X, Z);
}

#[test]
fn realsense_names_its_principal_point_and_lens() {
    let text = |model: &str, coeffs: &str| {
        format!(
            r#"{{"width": 640, "height": 480, "ppx": 321, "ppy": 239, "fx": 500, "fy": 510, "model": "{model}",
            "coeffs": {coeffs}}}"#
        )
    };
    let plain = camera(
        &text("distortion.inverse_brown_conrady", "[0, 0, 0, 0, 0]"),
        &Options::default(),
    );
    assert_plane(&plain, [500.0, 510.0, 321.0, 239.0]);
    assert!(plain.intrinsics().is_pinhole());
    let brown = text("Brown Conrady", "[0.1, 0.02, 0.003, 0.004, 0.005]");
    assert_params(
        &camera(&brown, &Options::default()),
        &[0.1, 0.02, 0.003, 0.004, 0.005],
    );
    let inverse = text("Inverse Brown Conrady", "[0.1, 0, 0, 0, 0]");
    let error = refusal(&[("a.json", &inverse)], &Options::default());
    assert!(error.contains("\"Inverse Brown Conrady\""), "{error}");
}

#[test]
fn coefficients_by_their_keys_may_be_a_fisheye_s() {
    let text = |more: &str| {
        format!(
            r#"{{"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "image_size": [640, 480], "k1": 0.1, "k2": 0.02{more}}}"#
        )
    };
    assert_params(
        &camera(&text(""), &Options::default()),
        &[0.1, 0.02, 0.0, 0.0],
    );
    assert_params(
        &camera(
            &text(r#", "k3": 0.3, "k4": 0.4, "fisheye": true"#),
            &Options::default(),
        ),
        &[0.1, 0.02, 0.3, 0.4],
    );
    for (more, words) in [
        (r#", "k3": 0.3, "k4": 0.4"#, "--model fisheye"),
        (r#", "dist": [0.1, 0, 0, 0, 0]"#, "there twice"),
    ] {
        let error = refusal(&[("a.json", &text(more))], &Options::default());
        assert!(error.contains(words), "{error}");
    }
}
