//! The binary as a user runs it. Tests of real inference need ONNX Runtime: they fail without it.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

const IDS: [&str; 4] = ["cam0", "cam1", "cam2", "cam3"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn sample(file: &str) -> String {
    root()
        .join("fixtures/tiny/sample")
        .join(file)
        .display()
        .to_string()
}

fn image_of(id: &str) -> String {
    format!("{id}={}", sample(&format!("{id}.png")))
}

fn mvtop(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mvtop-cli"))
        .args(args)
        .current_dir(root())
        .env("MVTOP_MODEL", "fixtures/tiny")
        .output()
        .unwrap()
}

fn stdout(output: &Output) -> String {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// The one line on stderr of a command that must end with code 2.
fn refusal(output: &Output) -> String {
    let stderr = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    assert!(
        stderr.starts_with("error: ") && !stderr.contains("panicked"),
        "{stderr}"
    );
    stderr
}

/// `infer` on the sample's images of some cameras, with its true boxes, as JSON.
fn infer(ids: &[&str], more: &[&str]) -> Value {
    let (rig, boxes) = (sample("rig.json"), sample("truth.json"));
    let images: Vec<String> = ids.iter().map(|id| image_of(id)).collect();
    let mut args = vec!["infer", "--rig", &rig, "--boxes", &boxes, "--json"];
    args.extend(images.iter().map(String::as_str));
    args.extend(more);
    serde_json::from_str(&stdout(&mvtop(&args))).unwrap()
}

fn matrix(value: &Value) -> Vec<f64> {
    let rows = value.as_array().unwrap().iter();
    rows.flat_map(|row| row.as_array().unwrap())
        .map(|x| x.as_f64().unwrap())
        .collect()
}

fn assert_close(a: &[f64], b: &[f64], tolerance: f64) {
    assert_eq!(a.len(), b.len());
    let off = a
        .iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max);
    assert!(off <= tolerance, "{a:?} and {b:?} are {off:.1e} apart");
}

#[test]
fn help_of_every_command_names_its_arguments() {
    assert!(stdout(&mvtop(&["--help"])).contains("infer"));
    let help = stdout(&mvtop(&["infer", "--help"]));
    for argument in [
        "--rig",
        "--reference",
        "--boxes",
        "--json",
        "--overlay",
        "Examples",
    ] {
        assert!(help.contains(argument), "{argument} is missing in:\n{help}");
    }
    let help = stdout(&mvtop(&["eval", "--help"]));
    for argument in [
        "--true-boxes",
        "--box-noise",
        "--rig-noise-deg",
        "--rig-noise-mm",
        "--noise-seed",
        "--resolved-deg",
        "Examples",
    ] {
        assert!(help.contains(argument), "{argument} is missing in:\n{help}");
    }
    assert!(stdout(&mvtop(&["doctor", "--help"])).contains("--ort-lib"));
}

#[test]
fn wrong_arguments_end_with_code_2() {
    for args in [
        &[][..],
        &["guess"],
        &["infer"],
        &["infer", "--rig", "rig.json"],
        &[
            "infer",
            "--rig",
            "rig.json",
            "a.png",
            "--provider",
            "abacus",
        ],
        &[
            "infer",
            "--rig",
            "rig.json",
            "a.png",
            "--json",
            "--truth",
            "truth.json",
        ],
        &["eval", "--samples", "x", "--views", "0"],
    ] {
        let output = mvtop(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(
            output.stdout.is_empty() && !output.stderr.is_empty(),
            "{args:?}"
        );
    }
}

#[test]
fn images_that_do_not_fit_the_rig_are_refused_before_anything_is_loaded() {
    let rig = sample("rig.json");
    // No library, no model: whatever is wrong with them must not come first.
    let infer = |images: &[&str]| {
        let fixed = [
            "infer",
            "--rig",
            &rig,
            "--ort-lib",
            "none.so",
            "--model",
            "none",
        ];
        refusal(&mvtop(&[&fixed, images].concat()))
    };
    let error = infer(&["a.png", "b.png"]);
    assert!(
        error.contains("expected 4 images") && error.contains("ID=PATH"),
        "{error}"
    );
    let error = infer(&["top=a.png"]);
    assert!(
        error.contains("no camera `top`") && error.contains("cam0, cam1"),
        "{error}"
    );
    let error = infer(&["cam0=a.png", "b.png"]);
    assert!(
        error.contains("some images are given as ID=PATH"),
        "{error}"
    );
    let error = infer(&["cam0=none.png"]);
    assert!(error.contains("cannot read none.png"), "{error}");
    let error = infer(&[&format!("cam0={rig}")]);
    assert!(error.contains("none of PNG, JPEG, TIFF and BMP"), "{error}");
    let error = infer(&["cam0=examples/mvball/cam0.png"]);
    assert!(
        error.contains("`cam0`: expected 160x120 px as in the rig, got 640x480"),
        "{error}"
    );
}

#[test]
fn files_that_are_missing_or_wrong_are_named() {
    let image = image_of("cam0");
    let error = refusal(&mvtop(&["infer", "--rig", "none.json", &image]));
    assert!(error.contains("cannot read none.json"), "{error}");
    let error = refusal(&mvtop(&["infer", "--rig", &sample("truth.json"), &image]));
    assert!(error.contains("truth.json"), "{error}");

    let rig = sample("rig.json");
    let with = |option: &str, value: &str| {
        refusal(&mvtop(&["infer", "--rig", &rig, &image, option, value]))
    };
    let error = with("--model", "fixtures");
    assert!(
        error.contains("model.json") && error.contains("model bundle"),
        "{error}"
    );
    let error = with("--ort-lib", "/no/such/libonnxruntime.so");
    assert!(
        error.contains("/no/such/libonnxruntime.so: cannot be loaded"),
        "{error}"
    );
    let error = with("--boxes", &rig);
    assert!(error.contains("rig.json: expected {\"objects\""), "{error}");
    let error = with("--truth", "none.json");
    assert!(error.contains("cannot read none.json"), "{error}");
    let error = with("--reference", "top");
    assert!(error.contains("no camera `top`"), "{error}");
    let error = with("--provider", "cuda");
    assert!(error.contains("`cuda`"), "{error}");
}

#[test]
fn samples_that_are_missing_are_refused() {
    let empty = TempDir::new().unwrap();
    let dir = empty.path().display().to_string();
    assert!(refusal(&mvtop(&["eval", "--samples", &dir])).contains("no sample in"));
    assert!(refusal(&mvtop(&["eval", "--samples", "none"])).contains("cannot read none"));
    let error = refusal(&mvtop(&[
        "eval",
        "--samples",
        "fixtures/tiny",
        "--views",
        "5",
    ]));
    assert!(error.contains("expected at least 5 cameras"), "{error}");
}

#[test]
fn doctor_says_what_was_found_or_what_to_do() {
    let text = stdout(&mvtop(&["doctor"]));
    for found in ["ONNX Runtime", "providers   cpu", "mvball", "all well"] {
        assert!(text.contains(found), "{found} is missing in:\n{text}");
    }
    let output = mvtop(&["doctor", "--ort-lib", "none.so"]);
    assert!(refusal(&output).contains("none.so"));
    assert!(String::from_utf8_lossy(&output.stdout).contains("checksums  match"));
    let error = refusal(&mvtop(&["doctor", "--model", "none"]));
    assert!(error.contains("none"), "{error}");
}

#[test]
fn prediction_is_near_the_truth_and_complete() {
    let json = infer(&IDS, &[]);
    assert_eq!(json["schema_version"], 1);
    assert_eq!(json["reference"], "cam0");
    assert_eq!(json["provider"], "cpu");
    assert!(json["timings_ms"]["total"].as_f64().unwrap() > 0.0);
    let object = &json["objects"][0];
    assert_eq!(
        (&object["class"], &object["class_id"]),
        (&"mvball".into(), &1.into())
    );
    assert!(object["sigma"]["rot_deg"].as_f64().unwrap() > 0.0);
    assert!(object["sigma"]["t_m"].as_f64().unwrap() > 0.0);

    let truth = std::fs::read_to_string(sample("truth.json")).unwrap();
    let truth: Value = serde_json::from_str(&truth).unwrap();
    let world = matrix(&object["T_world_obj"]);
    let known = matrix(&truth["objects"][0]["T_world_obj"]);
    let off = [3, 7, 11].map(|i| world[i] - known[i]);
    // The tiny network is trained for a minute: it knows where, hardly how turned.
    assert!(
        off.iter().map(|x| x * x).sum::<f64>().sqrt() < 0.06,
        "{off:?} m"
    );

    let cameras = object["cameras"].as_array().unwrap();
    let ids: Vec<&str> = cameras
        .iter()
        .map(|camera| camera["id"].as_str().unwrap())
        .collect();
    assert_eq!(ids, IDS);
    assert!(cameras.iter().all(|camera| camera["detected"] == true));
    assert_eq!(matrix(&cameras[0]["T_cam_obj"]).len(), 16);
    assert_close(
        &matrix(&cameras[0]["T_cam_obj"]),
        &matrix(&object["T_ref_obj"]),
        1e-12,
    );
    let t: Vec<f64> = object["t_m"]
        .as_array()
        .unwrap()
        .iter()
        .map(|x| x.as_f64().unwrap())
        .collect();
    let reference = matrix(&object["T_ref_obj"]);
    assert_close(&t, &[reference[3], reference[7], reference[11]], 0.0);
}

#[test]
fn order_of_the_images_does_not_matter_and_every_number_of_views_works() {
    for views in 1..=4 {
        let forward = infer(&IDS[..views], &[]);
        let mut reversed = IDS[..views].to_vec();
        reversed.reverse();
        let backward = infer(&reversed, &[]);
        assert_eq!(forward["objects"], backward["objects"]);
        assert_eq!(
            forward["objects"][0]["cameras"].as_array().unwrap().len(),
            views
        );
    }
}

#[test]
fn reference_chooses_the_frame() {
    let json = infer(&IDS[..3], &["--reference", "cam2"]);
    assert_eq!(json["reference"], "cam2");
    let object = &json["objects"][0];
    assert_close(
        &matrix(&object["cameras"][2]["T_cam_obj"]),
        &matrix(&object["T_ref_obj"]),
        1e-12,
    );
    // A camera without an image only lends its frame.
    let json = infer(&IDS[..2], &["--reference", "cam3"]);
    assert_eq!(json["reference"], "cam3");
    assert_eq!(json["objects"][0]["cameras"].as_array().unwrap().len(), 2);
}

#[test]
fn table_shows_the_pose_beside_the_truth() {
    let (rig, truth) = (sample("rig.json"), sample("truth.json"));
    let images = IDS.map(|id| sample(&format!("{id}.png")));
    let mut args = vec!["infer", "--rig", &rig, "--boxes", &truth, "--truth", &truth];
    args.extend(images.iter().map(String::as_str));
    let text = stdout(&mvtop(&args));
    for part in [
        "frame of camera `cam0`",
        "q_wxyz",
        "cam0 cam1 cam2 cam3",
        "known",
        "total",
    ] {
        assert!(text.contains(part), "{part} is missing in:\n{text}");
    }
}

#[test]
fn overlays_are_drawn_and_never_replace_files_unasked() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("pictures");
    let out = out.to_str().unwrap();
    infer(&IDS[..2], &["--overlay", out]);
    let picture = |name: &str| image::open(Path::new(out).join(name)).unwrap().into_rgb8();
    for id in &IDS[..2] {
        let drawn = picture(&format!("{id}.png"));
        let plain = image::open(sample(&format!("{id}.png")))
            .unwrap()
            .into_rgb8();
        assert_eq!(drawn.dimensions(), plain.dimensions());
        assert_ne!(drawn, plain);
    }
    assert_eq!(picture("all_views.png").height(), 480);

    // The truth is drawn as well where it is known.
    let (rig, image, truth) = (sample("rig.json"), image_of("cam0"), sample("truth.json"));
    let mut pictures = Vec::new();
    for (folder, more) in [("plain", &[][..]), ("known", &["--truth", &truth][..])] {
        let dir = Path::new(out).join(folder);
        let dir = dir.to_str().unwrap();
        let args = [
            "infer",
            "--rig",
            &rig,
            &image,
            "--boxes",
            &truth,
            "--overlay",
            dir,
        ];
        stdout(&mvtop(&[&args[..], more].concat()));
        pictures.push(picture(&format!("{folder}/cam0.png")));
    }
    assert_ne!(pictures[0], pictures[1]);

    let again = ["infer", "--rig", &rig, &image, "--overlay", out];
    assert!(refusal(&mvtop(&again)).contains("exists already; give --force"));
    stdout(&mvtop(&[&again[..], &["--force"]].concat()));

    // Not even --force draws over the images that are looked at.
    let copy = folder.path().join("cam0.png");
    std::fs::copy(sample("cam0.png"), &copy).unwrap();
    let (image, dir) = (
        format!("cam0={}", copy.display()),
        folder.path().display().to_string(),
    );
    let onto = ["infer", "--rig", &rig, &image, "--overlay", &dir, "--force"];
    assert!(refusal(&mvtop(&onto)).contains("is one of the images"));
    assert_eq!(
        std::fs::read(&copy).unwrap(),
        std::fs::read(sample("cam0.png")).unwrap()
    );
}

/// `eval` of the fixture's sample: the summary.
fn eval(more: &[&str]) -> Value {
    let args = [&["eval", "--samples", "fixtures/tiny"][..], more].concat();
    let text = stdout(&mvtop(&args));
    serde_json::from_str(text.lines().last().unwrap()).unwrap()
}

#[test]
fn evaluation_ends_with_one_line_of_json() {
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
    assert!(summary["trans_mean_m"].as_f64().unwrap() < 0.06);
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
    assert_eq!(matrix(&line["T_world_obj"]).len(), 16);
    assert!(line["timings_ms"]["total"].as_f64().unwrap() > 0.0);

    let again = [&["eval", "--samples", "fixtures/tiny"][..], &args].concat();
    assert!(refusal(&mvtop(&again)).contains("exists already"));
    eval(&[&args[..], &["--force"]].concat());
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
        let args = [&["eval", "--samples", "fixtures/tiny"][..], more].concat();
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
