//! `eval samples`.

use std::path::PathBuf;

use serde_json::Value;
use tempfile::TempDir;

use crate::{mvtop, off, refusal, root, sample, stdout};

#[test]
fn samples_that_are_missing_are_refused() {
    let empty = TempDir::new().unwrap();
    let dir = empty.path().display().to_string();
    assert!(refusal(&mvtop(&["eval", "samples", &dir])).contains("no sample in"));
    assert!(refusal(&mvtop(&["eval", "samples", "none"])).contains("cannot read none"));
    let error = refusal(&mvtop(&[
        "eval",
        "samples",
        "fixtures/tiny",
        "--views",
        "5",
    ]));
    assert!(error.contains("expected at least 5 cameras"), "{error}");
}

fn eval(more: &[&str]) -> Value {
    let args = [&["eval", "samples", "fixtures/tiny", "--json"][..], more].concat();
    let text = stdout(&mvtop(&args));
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(&text).unwrap()
}

#[test]
fn evaluation_is_one_line_of_json_and_one_per_object() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("results.jsonl").display().to_string();
    let args = ["--true-boxes", "--views", "2", "--out", &out];
    let summary = eval(&args);
    assert_eq!(
        (&summary["views"], &summary["pairs"]),
        (&2.into(), &1.into())
    );
    assert_eq!(
        (&summary["found"], &summary["extra"]),
        (&1.into(), &0.into())
    );
    assert!(summary["add_mean_m"].as_f64().unwrap() > 0.0);
    assert_eq!(summary["rot_mean_deg"], summary["rot_median_deg"]);
    assert_eq!(summary["resolved_deg"], 15.0);
    assert!(
        summary["sigma_rot_auroc"].is_null(),
        "one pose is no two groups"
    );

    let text = std::fs::read_to_string(&out).unwrap();
    assert_eq!(text.lines().count(), 1);
    let line: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(
        (&line["sample"], &line["found"]),
        (&"sample".into(), &true.into())
    );
    assert_eq!((&line["views"], &line["object"]), (&2.into(), &0.into()));
    assert_eq!(line["rot_deg"], summary["rot_mean_deg"]);
    assert_eq!(line["trans_m"], summary["trans_mean_m"]);
    assert_eq!(line["add_m"], summary["add_mean_m"]);
    assert_eq!(line["sigma"]["rot_deg"], summary["sigma_rot_mean_deg"]);
    assert_eq!(line["score"], 1.0);
    assert_eq!(line["cameras"], serde_json::json!(["cam0", "cam1"]));
    let truth = std::fs::read(sample("truth.json")).unwrap();
    let truth: Value = serde_json::from_slice(&truth).unwrap();
    let (deg, m) = off(&line, &truth["objects"][0]);
    assert!((deg - line["rot_deg"].as_f64().unwrap()).abs() < 1e-6);
    assert!((m - line["trans_m"].as_f64().unwrap()).abs() < 1e-12);
    assert!(line["timings_ms"]["total"].as_f64().unwrap() > 0.0);

    let again = [&["eval", "samples", "fixtures/tiny"][..], &args].concat();
    assert!(refusal(&mvtop(&again)).contains("exists already"));
    eval(&[&args[..], &["--force"]].concat());
}

/// A folder with a copy of the sample.
fn copied() -> (TempDir, PathBuf) {
    let folder = TempDir::new().unwrap();
    let copy = folder.path().join("sample");
    std::fs::create_dir(&copy).unwrap();
    for file in std::fs::read_dir(sample("")).unwrap() {
        let file = file.unwrap();
        std::fs::copy(file.path(), copy.join(file.file_name())).unwrap();
    }
    (folder, copy)
}

#[test]
fn files_of_samples_are_spared() {
    let (folder, copy) = copied();
    let truth = copy.join("truth.json");
    let before = std::fs::read(&truth).unwrap();
    let refused = refusal(&mvtop(&[
        "eval",
        "samples",
        folder.path().to_str().unwrap(),
        "--out",
        truth.to_str().unwrap(),
        "--force",
    ]));
    assert!(
        refused.contains("is one of the files that are read"),
        "{refused}"
    );
    assert_eq!(std::fs::read(&truth).unwrap(), before);
}

#[test]
fn true_boxes_beside_the_image_are_left_out_and_told_of() {
    let (folder, copy) = copied();
    let truth: Value =
        serde_json::from_slice(&std::fs::read(sample("truth.json")).unwrap()).unwrap();
    let with = |boxes: Value| {
        let mut truth = truth.clone();
        for (id, sides) in boxes.as_object().unwrap() {
            truth["objects"][0]["boxes"][id] = sides.clone();
        }
        std::fs::write(copy.join("truth.json"), truth.to_string()).unwrap();
        let samples = folder.path().to_str().unwrap();
        mvtop(&[
            "eval",
            "samples",
            samples,
            "--json",
            "--true-boxes",
            "--views",
            "2",
        ])
    };
    let (beside, thin) = ([900, 10, 950, 60], [20.0, 20.0, 20.4, 80.0]);
    let two = serde_json::json!({"cam0": beside, "cam1": thin, "cam2": beside});
    for (boxes, found, told) in [
        (serde_json::json!({}), 1, None),
        (
            serde_json::json!({"cam0": beside}),
            1,
            Some("1 of the boxes"),
        ),
        // The third camera has no part in it.
        (two, 0, Some("2 of the boxes")),
    ] {
        let output = with(boxes);
        let summary: Value = serde_json::from_str(&stdout(&output)).unwrap();
        assert_eq!(summary["found"], found);
        let warnings = String::from_utf8(output.stderr).unwrap();
        let boxes = warnings.lines().find(|line| line.contains("--true-boxes"));
        assert_eq!(boxes.is_some(), told.is_some(), "{warnings}");
        assert!(
            boxes.is_none_or(|line| line.contains(told.unwrap())),
            "{warnings}"
        );
    }
    let swapped = with(serde_json::json!({"cam0": [80, 20, 20, 80]}));
    assert!(refusal(&swapped).contains("x0 < x1"));
}

#[test]
fn noise_changes_the_poses_the_same_way_each_time() {
    let rot = |more: &[&str]| {
        let args = [&["--true-boxes", "--views", "2"][..], more].concat();
        eval(&args)["rot_mean_deg"].as_f64().unwrap()
    };
    let exact = rot(&[]);
    assert_eq!(rot(&["--rig-noise-deg", "0", "--rig-noise-mm", "0"]), exact);
    for noise in [
        ["--rig-noise-deg", "5"],
        ["--rig-noise-mm", "50"],
        ["--box-noise", "0.1"],
    ] {
        let noisy = rot(&noise);
        assert_ne!(noisy, exact, "{noise:?}");
        assert_eq!(rot(&noise), noisy, "{noise:?}");
        assert_ne!(rot(&[&noise[..], &["--noise-seed", "1"]].concat()), noisy);
    }
    // The reference camera's calibration is never touched.
    let alone = |more: &[&str]| eval(&[&["--true-boxes", "--views", "1"][..], more].concat());
    let noisy = alone(&["--rig-noise-deg", "5"]);
    assert_eq!(noisy["rot_mean_deg"], alone(&[])["rot_mean_deg"]);
}

#[test]
fn noise_that_cannot_be_is_refused() {
    let refused = |more: &[&str]| {
        let args = [&["eval", "samples", "fixtures/tiny"][..], more].concat();
        let output = mvtop(&args);
        assert_eq!(output.status.code(), Some(2));
        String::from_utf8(output.stderr).unwrap()
    };
    for size in ["-1", "nan", "inf", "much"] {
        let error = refused(&[&format!("--rig-noise-mm={size}")]);
        assert!(error.contains("expected a number of 0 or more"), "{error}");
    }
    assert!(refused(&["--box-noise", "0.1"]).contains("--true-boxes"));
}

#[test]
fn text_says_what_the_json_says() {
    let samples = TempDir::new().unwrap();
    let sample = samples.path().join("mvball");
    std::fs::create_dir(&sample).unwrap();
    for file in std::fs::read_dir(root().join("examples/mvball")).unwrap() {
        let file = file.unwrap();
        std::fs::copy(file.path(), sample.join(file.file_name())).unwrap();
    }
    let more = [samples.path().to_str().unwrap(), "--model", "models/mvball"];
    let text = stdout(&mvtop(&[&["eval", "samples"][..], &more].concat()));
    let json = stdout(&mvtop(
        &[&["eval", "samples", "--json"][..], &more].concat(),
    ));
    let json: Value = serde_json::from_str(&json).unwrap();
    assert!(
        text.contains("found: 1 of 1 objects, false positives: 0"),
        "{text}"
    );
    let row = |name: &str| -> Vec<f64> {
        let line = text.lines().find(|line| line.starts_with(name)).unwrap();
        let numbers = line.split_whitespace();
        numbers.filter_map(|word| word.parse().ok()).collect()
    };
    let said = |keys: &[&str], unit: f64| -> Vec<f64> {
        keys.iter()
            .map(|&key| json[key].as_f64().unwrap() * unit)
            .collect()
    };
    let rotation = said(
        &["rot_mean_deg", "rot_median_deg", "sigma_rot_mean_deg"],
        1.0,
    );
    let translation = said(&["trans_mean_m", "sigma_t_mean_m"], 1e3);
    for (shown, said) in [
        (row("rotation,"), rotation),
        (row("translation,"), translation),
        (row("ADD,"), said(&["add_mean_m"], 1e3)),
    ] {
        assert_eq!(shown.len(), said.len(), "{text}");
        for (shown, said) in shown.iter().zip(said) {
            assert!((shown - said).abs() <= 0.05, "{shown} {said}");
        }
    }
    // The shipped model knows how the ball of the example is turned.
    assert!(json["rot_mean_deg"].as_f64().unwrap() < 4.0, "{json}");
    assert_eq!(json["resolved_share"], 1.0);
}

#[test]
fn poses_that_are_not_sure_enough_are_left_out() {
    let folder = TempDir::new().unwrap();
    let ball = folder.path().join("ball");
    std::fs::create_dir(&ball).unwrap();
    for entry in std::fs::read_dir(root().join("examples/mvball")).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, ball.join(path.file_name().unwrap())).unwrap();
    }
    let folder = folder.path().display().to_string();
    let eval = |model: &str, more: &[&str]| {
        let args = ["eval", "samples", &folder, "--json", "--model", model];
        mvtop(&[&args, more].concat())
    };
    // Its confidence is above 0.9, and no pose is certain.
    for (least, found, precision) in [("0.9", 1, Value::from(1.0)), ("1", 0, Value::Null)] {
        let output = eval("models/mvball", &["--min-confidence", least]);
        let summary: Value = serde_json::from_str(&stdout(&output)).unwrap();
        assert_eq!(summary["found"], found, "{least}");
        assert_eq!(summary["precision"], precision, "{least}");
    }
    let error = refusal(&eval("fixtures/tiny", &["--min-confidence", "0.9"]));
    assert!(
        error.contains("a model bundle that says how sure it is"),
        "{error}"
    );
}
