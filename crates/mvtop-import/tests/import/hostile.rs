//! Files that mean harm, or are not what their writer thinks.

use mvtop_import::{Options, import};

use crate::{refusal, scaled};

#[cfg(unix)]
#[test]
fn pipes_and_devices_are_no_calibrations() {
    let folder = tempfile::TempDir::new().unwrap();
    let pipe = folder.path().join("rig.yaml");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.unwrap().success());
    // Nobody writes to the pipe: whoever opens it waits forever.
    for path in [pipe, "/dev/zero".into()] {
        let error = import(&[path], &Options::default()).unwrap_err();
        assert!(error.to_string().contains("pipe or device"), "{error}");
    }
}

#[test]
fn key_that_comes_twice_is_refused_in_yaml_and_json() {
    let json = r#"{"a": {"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "K": [[5, 0, 3], [0, 5, 2],
        [0, 0, 1]], "image_size": [640, 480], "rvec": [0, 0, 0], "tvec": [0, 0, 0]}}"#;
    let options = Options {
        format: mvtop_import::Format::named("opencv"),
        ..scaled(1.0)
    };
    for name in ["rig.json", "rig.yaml"] {
        let error = refusal(&[(name, json)], &options);
        assert!(error.contains("`K`") && error.contains("twice"), "{error}");
    }
}

#[test]
fn nesting_without_end_is_refused() {
    let options = Options {
        format: mvtop_import::Format::named("opencv"),
        ..scaled(1.0)
    };
    let deep = "[".repeat(100_000);
    for (name, text) in [
        ("rig.json", deep.clone()),
        ("rig.yaml", format!("a: {deep}")),
    ] {
        refusal(&[(name, &text)], &options);
    }
}
