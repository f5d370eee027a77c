//! `audit leakage`.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::stdout;

const UPRIGHT: [i32; 9] = [1, 0, 0, 0, 1, 0, 0, 0, 1];
const UPSIDE_DOWN: [i32; 9] = [1, 0, 0, 0, -1, 0, 0, 0, -1];

fn write(path: &Path, text: &str) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

fn pose(object: u32, rotation: [i32; 9], t_mm: [f64; 3]) -> Value {
    json!({"obj_id": object, "cam_R_m2c": rotation, "cam_t_m2c": t_mm})
}

/// Of object 1 in `test`, one pose in `train` exactly, one within 0.01 mm, one upside down, one
/// 0.02 mm off; object 2 only in `test`.
fn data() -> TempDir {
    let folder = TempDir::new().unwrap();
    let at = |x: f64| [x, 0.0, 900.0];
    let test = json!({
        "4": [pose(1, UPRIGHT, at(0.0)), pose(2, UPRIGHT, at(0.0))],
        "5": [pose(1, UPRIGHT, at(100.0)), pose(1, UPRIGHT, at(200.0)), pose(1, UPRIGHT, at(300.0))],
    });
    let train = json!({
        "0": [pose(1, UPRIGHT, at(0.0)), pose(1, UPRIGHT, at(100.008))],
        "9": [pose(1, UPSIDE_DOWN, at(200.0)), pose(1, UPRIGHT, at(300.02)), pose(1, UPRIGHT, at(0.0))],
    });
    write(
        &folder.path().join("test/000048/scene_gt.json"),
        &test.to_string(),
    );
    write(
        &folder.path().join("train/000002/scene_gt.json"),
        &train.to_string(),
    );
    write(
        &folder.path().join("models/models_info.json"),
        r#"{"1": {"diameter": 100.0}}"#,
    );
    let ply = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
               property float z\nend_header\n0 -50 0\n0 50 0\n";
    write(&folder.path().join("models/obj_000001.ply"), ply);
    folder
}

fn audit(folder: &TempDir, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mvtop-cli"))
        .args(["audit", "leakage"])
        .args(args)
        .current_dir(folder.path())
        .output()
        .unwrap()
}

const SPLITS: [&str; 4] = ["--a", "test", "--b", "train"];

#[test]
fn splits_in_different_units_and_rotations_that_are_off_are_warned_of() {
    let folder = data();
    let warnings = || {
        let output = audit(&folder, &SPLITS);
        stdout(&output);
        String::from_utf8(output.stderr).unwrap()
    };
    assert_eq!(warnings(), "");
    let metres = json!({"0": [pose(1, UPRIGHT, [0.0, 0.0, 0.9])]});
    let train = folder.path().join("train/000002/scene_gt.json");
    write(&train, &metres.to_string());
    let units = warnings();
    assert_eq!(units.lines().count(), 1, "{units}");
    assert!(units.starts_with("warning: objects are 90"), "{units}");
    assert!(units.contains("0.9000 mm in split b") && units.contains("looks like metres"));
    let off = json!({"0": [{"obj_id": 1, "cam_R_m2c": [1.005, 0, 0, 0, 1, 0, 0, 0, 1],
                            "cam_t_m2c": [0, 0, 900]}]});
    write(&train, &off.to_string());
    let off = warnings();
    assert!(
        off.starts_with("warning: split b: 1 of 1 rotations"),
        "{off}"
    );
    assert!(
        off.contains("1.0e-2") && off.contains("image 0, row 0"),
        "{off}"
    );
}

#[test]
fn table_json_pairs_and_page_say_the_same() {
    let folder = data();
    let args = [&SPLITS[..], &["--meshes", "models", "--report", "out"]].concat();
    let table = stdout(&audit(&folder, &args));
    let total = table
        .lines()
        .find(|line| line.trim_start().starts_with("total"))
        .unwrap();
    let numbers: Vec<&str> = total
        .split_whitespace()
        .filter(|cell| *cell != "%")
        .collect();
    let of_a = ["total", "5", "3", "60.00", "2", "40.00", "0"];
    let of_b = ["5", "4", "80.00", "3", "60.00", "2"];
    assert_eq!(numbers, [&of_a[..], &of_b].concat());

    let read = |name: &str| fs::read_to_string(folder.path().join("out").join(name)).unwrap();
    let json: Value = serde_json::from_str(&read("leakage.json")).unwrap();
    assert_eq!(json["measure"], "add_percent");
    let expected = json!({"poses": 5, "same_translation": 3, "recurring": 2, "repeated": 0});
    assert_eq!(json["total"]["a"], expected);
    // Upside down, the two points change places.
    let histogram = json!({"bins": [3, 0, 0, 0, 0, 0, 0, 0, 0, 0], "beyond": 2});
    assert_eq!(json["total"]["histogram"], histogram);
    let objects = json["objects"].as_array().unwrap();
    assert_eq!(objects.len(), 2);
    assert_eq!(objects[1]["a"]["recurring"], 0);

    let csv = read("pairs.csv");
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines.len(), 3, "{csv}");
    assert_eq!(lines[1], "1,000048,4,0,000002,0,0,0,0,0");
    assert!(
        lines[2].starts_with("1,000048,5,0,000002,0,1,0.00"),
        "{csv}"
    );

    let svg = read("histogram.svg");
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    assert!(svg.contains("60.0 %") && svg.contains("40.0 %"), "{svg}");
    let page = read("report.html");
    assert!(page.contains(svg.trim_end()), "{page}");
    let cells = "<td>5</td><td>3 (60.00 %)</td><td>2 (40.00 %)</td><td>0</td>";
    assert!(page.contains(&format!("<td>total</td>{cells}")), "{page}");

    // Without a page, the same data.
    let args = [&SPLITS[..], &["--meshes", "models", "--out", "data"]].concat();
    assert_eq!(stdout(&audit(&folder, &args)), table);
    let data = folder.path().join("data");
    for name in ["leakage.json", "pairs.csv"] {
        assert_eq!(fs::read_to_string(data.join(name)).unwrap(), read(name));
    }
    assert_eq!(fs::read_dir(data).unwrap().count(), 2);
}

#[test]
fn rotations_are_compared_without_models_and_thresholds_are_the_users() {
    let folder = data();
    let total = |more: &[&str]| {
        let args = [&SPLITS[..], &["--json"], more].concat();
        let json: Value = serde_json::from_str(&stdout(&audit(&folder, &args))).unwrap();
        assert_eq!(json["measure"], "rot_deg");
        let count = |key: &str| json["total"]["a"][key].as_u64().unwrap();
        (count("same_translation"), count("recurring"))
    };
    assert_eq!(total(&[]), (3, 2));
    assert_eq!(total(&["--within-mm", "0.03"]), (4, 3));
    assert_eq!(total(&["--within-mm", "0.005"]), (2, 1));
    assert_eq!(total(&["--rot-deg", "180"]), (3, 3));
}

#[test]
fn what_cannot_be_compared_is_refused_in_one_sentence_and_nothing_is_overwritten() {
    let folder = data();
    write(&folder.path().join("text/000000/scene_gt.json"), "poses");
    let other = json!({"0": [pose(9, UPRIGHT, [0.0; 3])]}).to_string();
    write(&folder.path().join("other/000000/scene_gt.json"), &other);
    write(&folder.path().join("pairs.csv"), "mine");
    let cases: [(&[&str], &str); 7] = [
        (&["--a", "test", "--b", "none"], "cannot read none"),
        (&["--a", "test", "--b", "models"], "expected a split"),
        (
            &["--a", "test", "--b", "text"],
            "scene_gt.json: expected {IMAGE",
        ),
        (
            &["--a", "test", "--b", "other"],
            "no object is in both splits",
        ),
        (&["--a", "test", "--b", "test/000048"], "is in both splits"),
        (
            &["--a", "test", "--b", "train", "--meshes", "test"],
            "models_info.json",
        ),
        (
            &["--a", "test", "--b", "train", "--out", "."],
            "exists already",
        ),
    ];
    for (args, expected) in cases {
        let output = audit(&folder, args);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(
            stderr.starts_with("error: ") && stderr.lines().count() == 1,
            "{stderr}"
        );
        assert!(stderr.contains(expected), "{stderr}");
    }
    assert_eq!(
        fs::read_to_string(folder.path().join("pairs.csv")).unwrap(),
        "mine"
    );
}
