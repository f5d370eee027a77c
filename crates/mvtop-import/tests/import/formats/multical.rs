use mvtop_import::{Format, Options};

use super::samples::MULTICAL;
use super::{MINUS_Y, X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal, scaled};

#[test]
fn multical_maps_the_master_camera_to_the_others() {
    let imported = read(&[("calibration.json", MULTICAL)], &scaled(0.1)).unwrap();
    assert_eq!(imported.format, Format::Multical);
    let [left, right] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!([left.id(), right.id()], ["left", "right"]);
    assert_plane(left, [500.0, 510.0, 320.0, 240.0]);
    assert_params(left, &[-0.2, 0.05, 0.001, -0.002, 0.01]);
    assert_pose(left, [0.0; 3], X, Z);
    assert_pose(right, [0.4, 0.2, 0.0], MINUS_Y, Z);
}

#[test]
fn multical_asks_for_the_unit_and_names_a_camera_without_a_place() {
    let files = [("calibration.json", MULTICAL)];
    let error = refusal(&files, &Options::default());
    assert!(error.contains("`unit` (--unit"), "{error}");
    let text = MULTICAL.replace("right_to_left", "other");
    let error = refusal(&[("calibration.json", &text)], &scaled(0.1));
    assert!(error.contains("`right`: its place is missing"), "{error}");
}

#[test]
fn multical_s_other_models_and_keys_are_named() {
    for (from, to, words) in [
        (r#""model": "standard""#, r#""model": "ocam""#, "\"ocam\""),
        (
            r#""model": "standard""#,
            r#""model": 5"#,
            "`model`: expected text",
        ),
        (
            r#""image_sets": {"#,
            r#""distortions": {"left": 0.1}, "image_sets": {"#,
            "`distortions`",
        ),
        (
            r#"{"cameras": {"#,
            r#"{"cameras": {"top": 5, "#,
            "expected an object, got 5",
        ),
    ] {
        let text = MULTICAL.replacen(from, to, 1);
        assert_ne!(text, MULTICAL);
        let error = refusal(&[("calibration.json", &text)], &scaled(0.1));
        assert!(error.contains(words), "{error}");
    }
}
