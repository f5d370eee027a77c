//! What a file cannot say is asked for by name, and what cannot be meant is refused.

use mvtop_import::{Format, Options};

use crate::{refusal, scaled};

const K: &str = r#""K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]]"#;

fn pair(dist: &str, more: &str) -> String {
    format!(
        r#"{{"K1": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "D1": {dist}, "K2": [[500, 0, 320],
        [0, 500, 240], [0, 0, 1]], "D2": {dist}, "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": [-4, 0, 0]{more}}}"#
    )
}

#[test]
fn unit_size_direction_and_lens_are_asked_for() {
    let size = r#", "image_size": [640, 480]"#;
    let five = "[0.1, 0, 0, 0, 0]";
    let asks = |text: &str, options: &Options, flag: &str| {
        let error = refusal(&[("a.json", text)], options);
        assert!(error.contains(flag), "{flag} is not asked for: {error}");
    };
    asks(&pair(five, size), &Options::default(), "--scale");
    asks(&pair(five, ""), &scaled(0.03), "--image-size");
    asks(&pair("[0.1, 0, 0, 0.01]", size), &scaled(0.03), "--model");
    let unclear = format!(
        r#"{{"a": {{{K}, "dist": {five}, "image_size": [640, 480], "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "T": [1, 0, 0]}}}}"#
    );
    asks(&unclear, &scaled(0.03), "--direction");
    let alone = format!(
        r#"{{"a": {{{K}, "image_size": [640, 480]}}, "b": {{{K}, "image_size": [640, 480]}}}}"#
    );
    asks(&alone, &scaled(0.03), "rvec and tvec");
    asks("{\"nothing\": 1}", &Options::default(), "--from");
}

#[test]
fn names_decide_the_lens() {
    let size = r#", "image_size": [640, 480]"#;
    let read = |model: &str| {
        let options = Options {
            model: Some(model.to_owned()),
            ..scaled(0.03)
        };
        let rig = crate::read(&[("a.json", &pair("[0.1, 0, 0, 0.01]", size))], &options);
        let rig = rig.unwrap().rig;
        rig.cameras()[0].intrinsics().projection().distortion()
    };
    assert_eq!(read("pinhole"), Some("brown_conrady"));
    assert_eq!(read("fisheye"), Some("kannala_brandt"));
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let five = "[0.1, 0, 0, 0, 0]";
    let good = pair(five, r#", "image_size": [640, 480]"#);
    for (from, to, scale, words) in [
        ("[-4, 0, 0]", "[-4, 0]", 0.03, "expected 3 numbers, got 2"),
        ("[-4, 0, 0]", "[-4, 0, null]", 0.03, "finite numbers"),
        (
            "[[1, 0, 0], [0, 1, 0]",
            "[[2, 0, 0], [0, 1, 0]",
            0.03,
            "not a rotation",
        ),
        // Degrees, most likely, or the radians of a Rodrigues vector.
        (
            "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
            "[10, 20, 30]",
            0.03,
            "`R`: expected a 3x3 matrix, got 3 numbers",
        ),
        (
            r#""R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]"#,
            r#""rvec": [0, 0, 90]"#,
            0.03,
            "in radians, not longer than a whole turn (6.28), got a length of 90.00",
        ),
        ("[[500, 0, 320]", "[[500, 320, 0]", 0.03, "skew"),
        ("[640, 480]", "[640.5, 480]", 0.03, "whole pixels"),
        (five, "[0.1, 0]", 0.03, "0, 4, 5, 8, 12 or 14"),
        ("", "", 1e-6, "--scale"),
    ] {
        let error = refusal(&[("a.json", &good.replacen(from, to, 1))], &scaled(scale));
        assert!(error.contains(words), "{words} is missing in: {error}");
    }
}

#[test]
fn cameras_stand_as_near_together_as_is_said() {
    let good = pair("[0.1, 0, 0, 0, 0]", r#", "image_size": [640, 480]"#);
    let files = [("a.json", good.as_str())];
    let error = refusal(&files, &scaled(1e-6));
    assert!(
        error.contains("`trust_unit` to true (--trust-unit)"),
        "{error}"
    );
    let trusted = Options {
        trust_unit: true,
        ..scaled(1e-6)
    };
    let rig = crate::read(&files, &trusted).unwrap().rig;
    let place = rig.cameras()[1].world_from_cam().translation.vector;
    crate::assert_near([place.x], [4e-6]);
    assert_eq!(mvtop_geometry::Rig::from_json(&rig.to_json()).unwrap(), rig);
}

#[test]
fn broken_files_end_in_one_sentence() {
    let deep = format!("a: {}", "[".repeat(5000));
    let steps = "- ".repeat(50_000);
    for text in [
        "",
        "{",
        "a: b: c",
        "a: &x 1\nb: *x",
        "a: 1\na: 2",
        "\u{0}",
        &deep,
        &steps,
        "[1, 2]",
        "5",
    ] {
        for format in Format::ALL {
            let options = Options {
                format: Some(format),
                ..scaled(1.0)
            };
            refusal(&[("cameras.txt", text)], &options);
            refusal(&[("images.bin", text), ("cameras.bin", text)], &options);
            refusal(&[("a.json", text)], &options);
        }
    }
}
