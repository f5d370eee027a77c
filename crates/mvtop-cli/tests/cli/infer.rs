//! `infer`.

mod images;
mod overlays;
mod shipped;

use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::{matrix, mvtop, refusal, root, sample, stdout};

const IDS: [&str; 4] = ["cam0", "cam1", "cam2", "cam3"];

fn image_of(id: &str) -> String {
    format!("{id}={}", sample(&format!("{id}.png")))
}

fn infer(ids: &[&str], more: &[&str]) -> Value {
    let (rig, boxes) = (sample("rig.json"), sample("truth.json"));
    let images: Vec<String> = ids.iter().map(|id| image_of(id)).collect();
    let mut args = vec!["infer", "--rig", &rig, "--boxes", &boxes, "--json"];
    args.extend(images.iter().map(String::as_str));
    args.extend(more);
    serde_json::from_str(&stdout(&mvtop(&args))).unwrap()
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
    let error = with("--threads", "1000000000");
    assert!(error.contains("threads: expected 0 to 1024"), "{error}");
    let error = with("--provider", "cuda");
    assert!(error.contains("`cuda`"), "{error}");
}

#[test]
fn prediction_is_complete() {
    let json = infer(&IDS, &[]);
    assert_eq!(json["schema_version"], 1);
    assert_eq!(json["reference"], "cam0");
    assert_eq!(json["model"], "fixtures/tiny");
    assert_eq!(json["provider"], "cpu");
    assert!(json["timings_ms"]["total"].as_f64().unwrap() > 0.0);
    let object = &json["objects"][0];
    assert_eq!(
        (&object["class"], &object["class_id"]),
        (&"mvball".into(), &1.into())
    );
    assert!(object["sigma"]["rot_deg"].as_f64().unwrap() > 0.0);
    assert!(object["sigma"]["t_m"].as_f64().unwrap() > 0.0);

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
        "model fixtures/tiny ($MVTOP_MODEL)",
    ] {
        assert!(text.contains(part), "{part} is missing in:\n{text}");
    }
}

#[test]
fn priors_exclude_what_is_found_elsewhere_and_the_reason_is_told() {
    let ids = ["cam0", "cam1"];
    let found = infer(&ids, &[]);
    let mut pose = found["objects"][0]["T_world_obj"].clone();
    let x = pose[0][3].as_f64().unwrap();
    pose[0][3] = (x + 0.4).into();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("request.json");
    let ask = |sigma_m: f64| {
        let prior = serde_json::json!({
            "class": found["objects"][0]["class"], "T_world_obj": pose,
            "sigma_m": sigma_m, "sigma_deg": 60,
        });
        let request = serde_json::json!({"priors": [prior], "why": true});
        std::fs::write(&file, request.to_string()).unwrap();
        infer(&ids, &["--request", file.to_str().unwrap()])
    };
    let near = ask(0.2);
    assert_eq!(near["objects"].as_array().unwrap().len(), 1);
    assert_eq!(near["why"], serde_json::json!([]));
    let far = ask(0.1);
    assert_eq!(far["objects"], serde_json::json!([]));
    assert_eq!(far["why"][0]["reason"], "prior");
    let off = far["why"][0]["value"].as_f64().unwrap();
    assert!((off - 4.0).abs() < 0.05, "{off}");
}

#[cfg(unix)]
#[test]
fn files_that_do_not_end_or_lie_are_refused() {
    let (rig, image, folder) = (
        sample("rig.json"),
        image_of("cam0"),
        tempfile::tempdir().unwrap(),
    );
    let pipe = folder.path().join("pipe");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.unwrap().success());
    for endless in [pipe.to_str().unwrap(), "/dev/zero"] {
        let of_camera = format!("cam0={endless}");
        for args in [
            &["--rig", endless, &image][..],
            &["--rig", &rig, &of_camera],
            &["--rig", &rig, &image, "--boxes", endless],
            &["--rig", &rig, &image, "--truth", endless],
        ] {
            let error = refusal(&mvtop(&[&["infer"], args].concat()));
            assert!(error.contains("pipe or device"), "{error}");
        }
    }
    let name = folder.path().join("a\u{1b}[2J.json").display().to_string();
    let error = refusal(&mvtop(&["infer", "--rig", &name, &image]));
    assert!(
        !error.contains('\u{1b}') && error.contains(r"\u001b[2J"),
        "{error}"
    );
}

#[cfg(target_os = "linux")]
#[test]
fn stderr_that_is_full_is_no_panic() {
    let full = std::fs::File::options()
        .write(true)
        .open("/dev/full")
        .unwrap();
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_mvtop-cli"))
        .args(["infer", "--rig", "none.json", "a.png"])
        .stderr(full)
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(2));
}

#[test]
fn image_of_one_color_is_warned_of_on_stderr_and_in_the_json() {
    let folder = tempfile::tempdir().unwrap();
    let dark = folder.path().join("dark.png");
    image::RgbImage::new(160, 120).save(&dark).unwrap();
    let images = [image_of("cam0"), format!("cam1={}", dark.display())];
    let output = mvtop(&[
        "infer",
        "--rig",
        &sample("rig.json"),
        &images[0],
        &images[1],
        "--json",
    ]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        stderr.starts_with("warning: image of camera `cam1` is of one color"),
        "{stderr}"
    );
    let json: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert_eq!(json["warnings"][0]["code"], "one_color");
    assert_eq!(json["warnings"][0]["camera"], "cam1");
    assert_eq!(json["warnings"].as_array().unwrap().len(), 1);
}

#[test]
fn wrong_calibration_is_warned_of_on_stderr_and_in_the_json() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read(root().join("examples/mvball/rig.json")).unwrap();
    let mut rig: Value = serde_json::from_slice(&text).unwrap();
    let infer = |rig: &Value| {
        let path = folder.path().join("rig.json");
        std::fs::write(&path, rig.to_string()).unwrap();
        mvtop(&[
            "infer",
            "--rig",
            path.to_str().unwrap(),
            "examples/mvball/cam0.png",
            "examples/mvball/cam1.png",
            "--model",
            "models/mvball",
            "--json",
        ])
    };
    let output = infer(&rig);
    let json: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert_eq!(json["warnings"], serde_json::json!([]));
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    assert!(json["rig_consistency"]["px"].as_f64().unwrap() < 1.0);
    assert_eq!(json["rig_consistency"]["worst_camera"], Value::Null);

    for (axis, by) in [(0, 0.05), (0, -0.05), (1, 0.05), (2, 0.05), (2, -0.05)] {
        let mut moved = rig.clone();
        let along = &mut moved["cameras"][1]["T_cam_world"][axis][3];
        *along = (along.as_f64().unwrap() + by).into();
        let json: Value = serde_json::from_str(&stdout(&infer(&moved))).unwrap();
        let warned = !json["warnings"].as_array().unwrap().is_empty();
        assert!(warned, "{axis} {by}");
    }

    for camera in rig["cameras"].as_array_mut().unwrap() {
        for key in ["fx", "fy"] {
            camera[key] = (1.1 * camera[key].as_f64().unwrap()).into();
        }
    }
    let output = infer(&rig);
    let json: Value = serde_json::from_str(&stdout(&output)).unwrap();
    let codes = ["lines_miss", "sizes_disagree", "views_contradict"];
    let warning = &json["warnings"][0];
    assert!(
        codes.contains(&warning["code"].as_str().unwrap()),
        "{warning}"
    );
    assert_eq!(warning["camera"], Value::Null);
    let stderr = String::from_utf8_lossy(&output.stderr);
    let message = warning["message"].as_str().unwrap();
    assert_eq!(stderr.trim_end(), format!("warning: {message}"));
}
