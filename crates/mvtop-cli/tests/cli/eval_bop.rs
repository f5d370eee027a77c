//! `eval bop`, on the fixture's sample written in BOP's layout.

mod doubts;
mod journal;
mod results;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use mvtop_core::Rig;
use mvtop_core::annotations::load_truth;
use nalgebra::Isometry3;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{refusal, root, stdout};

fn rotation(pose: &Isometry3<f64>) -> Vec<f64> {
    let rotation = pose.rotation.to_rotation_matrix();
    (0..9).map(|i| rotation[(i / 3, i % 3)]).collect()
}

fn translation_mm(pose: &Isometry3<f64>) -> Vec<f64> {
    pose.translation.vector.iter().map(|t| t * 1e3).collect()
}

/// The sample's views as frames 0 to 3 of a scene, or as cameras of frame 0.
pub fn write_dataset(dir: &Path, one_frame: bool) {
    let sample = root().join("fixtures/tiny/sample");
    let rig = Rig::load(&sample.join("rig.json")).unwrap();
    let truth = &load_truth(&sample.join("truth.json")).unwrap()[0];
    let scene = dir.join("test/000001");
    let files = |end: &str, frames: &[(usize, &mvtop_core::Camera)]| {
        fs::create_dir_all(scene.join(format!("rgb{end}"))).unwrap();
        let (mut cameras, mut gt, mut info) = (json!({}), json!({}), json!({}));
        for (frame, camera) in frames {
            let (key, of) = (frame.to_string(), camera.intrinsics());
            let cam_from_world = camera.world_from_cam().inverse();
            let cam_from_obj = cam_from_world * truth.world_from_obj;
            cameras[&key] = json!({
                "cam_K": [of.fx(), 0, of.cx(), 0, of.fy(), of.cy(), 0, 0, 1],
                "depth_scale": 1.0,
                "cam_R_w2c": rotation(&cam_from_world), "cam_t_w2c": translation_mm(&cam_from_world),
            });
            gt[&key] = json!([{
                "obj_id": 1, "cam_R_m2c": rotation(&cam_from_obj),
                "cam_t_m2c": translation_mm(&cam_from_obj),
            }]);
            let [x0, y0, x1, y1] = truth.seen.boxes[camera.id()].into();
            info[&key] = json!([{"bbox_obj": [x0, y0, x1 - x0, y1 - y0]}]);
            let image = scene.join(format!("rgb{end}/{frame:06}.png"));
            fs::copy(sample.join(format!("{}.png", camera.id())), image).unwrap();
        }
        for (name, content) in [("camera", cameras), ("gt", gt), ("gt_info", info)] {
            fs::write(
                scene.join(format!("scene_{name}{end}.json")),
                content.to_string(),
            )
            .unwrap();
        }
    };
    if one_frame {
        for camera in rig.cameras() {
            files(&format!("_{}", camera.id()), &[(0, camera)]);
        }
    } else {
        let frames: Vec<_> = rig.cameras().iter().enumerate().collect();
        files("", &frames);
    }
    fs::create_dir_all(dir.join("models")).unwrap();
    let info = json!({"1": {"diameter": 130.8, "name": "mvball"}});
    fs::write(dir.join("models/models_info.json"), info.to_string()).unwrap();
    let ply = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n\
               property float z\nelement face 8\nproperty list uchar int vertex_indices\n\
               end_header\n60 0 0\n-60 0 0\n0 60 0\n0 -60 0\n0 0 60\n0 0 -60\n\
               3 0 2 4\n3 2 1 4\n3 1 3 4\n3 3 0 4\n3 2 0 5\n3 1 2 5\n3 3 1 5\n3 0 3 5\n";
    fs::write(dir.join("models/obj_000001.ply"), ply).unwrap();
}

fn change(path: &Path, change: impl FnOnce(&mut Value)) {
    let mut content: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    change(&mut content);
    fs::write(path, content.to_string()).unwrap();
}

/// The sample as a scene, and where its report will be.
fn balls() -> (TempDir, PathBuf, PathBuf) {
    let dir = TempDir::new().unwrap();
    let [dataset, report] = ["balls", "report"].map(|name| dir.path().join(name));
    write_dataset(&dataset, false);
    (dir, dataset, report)
}

fn eval(dataset: &Path, report: &Path, more: &[&str]) -> Output {
    let (dataset, report) = (dataset.to_str().unwrap(), report.to_str().unwrap());
    let fixed = ["eval", "bop", "--true-boxes", "--dataset", dataset];
    let folder = ["--report", report, "--json"];
    crate::mvtop(&[&fixed, &folder[..], more].concat())
}

fn summary(output: &Output) -> Value {
    let text = stdout(output);
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(&text).unwrap()
}

#[test]
fn a_split_gives_csv_json_and_a_page() {
    let (_dir, dataset, report) = balls();
    let summary = summary(&eval(&dataset, &report, &["--views", "2"]));
    assert_eq!(
        (&summary["pairs"], &summary["found"]),
        (&4.into(), &4.into())
    );
    assert_eq!(summary["views"], 2);
    assert_eq!(summary["all"]["objects"], 4);
    assert_eq!(summary["objects"]["1"], summary["all"]);
    // The ball's points are up to 60 mm from its origin.
    let add = summary["add_mean_m"].as_f64().unwrap();
    assert!(add > 0.0 && add < 0.2, "{add}");
    let written: Value =
        serde_json::from_slice(&fs::read(report.join("summary.json")).unwrap()).unwrap();
    assert_eq!(written, summary);

    let csv = fs::read_to_string(report.join("mvtop_balls-test.csv")).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(
        rows[0],
        ["scene_id", "im_id", "obj_id", "score", "R", "t", "time"]
    );
    assert_eq!(rows.len(), 5);
    for (image, row) in rows[1..].iter().enumerate() {
        assert_eq!(row[..4], ["1", &image.to_string(), "1", "1"]);
        assert_eq!(row[4].split(' ').count(), 9);
        // About 0.6 m before the camera, in millimetres.
        let z: f64 = row[5].split(' ').nth(2).unwrap().parse().unwrap();
        assert!((300.0..1200.0).contains(&z), "{z}");
        assert!(row[6].parse::<f64>().unwrap() > 0.0);
    }
    let page = fs::read_to_string(report.join("report.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), 5);
    assert_eq!(page.matches("data:image/jpeg;base64,").count(), 4);
    assert!(!page.contains("http://") || page.matches("http://www.w3.org/2000/svg").count() == 5);
    assert!(
        page.contains("<td>1 mvball</td>") && page.contains("<h1>balls, test</h1>"),
        "{page}"
    );
}

#[test]
fn a_split_without_a_page_is_text_and_files_for_programs() {
    let dir = TempDir::new().unwrap();
    let (dataset, out) = (dir.path().join("balls"), dir.path().join("out"));
    write_dataset(&dataset, false);
    let paths = [&dataset, &out].map(|path| path.to_str().unwrap());
    let args = [
        "eval",
        "bop",
        "--true-boxes",
        "--views",
        "2",
        "--dataset",
        paths[0],
        "--out",
        paths[1],
    ];
    let text = stdout(&crate::mvtop(&args));
    assert!(
        text.contains("groups: 4, views: 2, found: 4 of 4 objects"),
        "{text}"
    );
    let row = |name: &str| {
        let line = text.lines().find(|line| line.starts_with(name)).unwrap();
        line[name.len()..]
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" ")
    };
    assert_eq!(row("1 mvball"), row("all"));
    assert!(row("all").starts_with("4 4 "), "{text}");
    for line in text.lines() {
        assert!(
            line.chars().count() <= 100 || line.starts_with("in "),
            "{line}"
        );
    }
    let mut names: Vec<String> = fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let expected = [
        "groups.jsonl",
        "mvtop_balls-test.csv",
        "run.json",
        "summary.json",
    ];
    assert_eq!(names, expected);
    // A page of the same results needs no new ones.
    let journal = fs::read(out.join("groups.jsonl")).unwrap();
    summary(&eval(&dataset, &out, &["--views", "2"]));
    assert_eq!(fs::read(out.join("groups.jsonl")).unwrap(), journal);
    assert!(out.join("report.html").exists());
}

#[test]
fn split_in_a_folder_of_its_own_gives_a_file_of_its_name() {
    let (_dir, dataset, report) = balls();
    fs::create_dir(dataset.join("val")).unwrap();
    fs::rename(dataset.join("test"), dataset.join("val/near")).unwrap();
    for split in ["val/near", "./val/near/"] {
        summary(&eval(
            &dataset,
            &report,
            &["--views", "1", "--split", split, "--force"],
        ));
        assert!(report.join("mvtop_balls-val-near.csv").is_file(), "{split}");
        fs::remove_dir_all(&report).unwrap();
    }
}

#[test]
fn depth_images_bring_vsd() {
    let dir = TempDir::new().unwrap();
    let dataset = dir.path().join("balls");
    write_dataset(&dataset, false);
    let views = ["--views", "2"];
    let without = summary(&eval(&dataset, &dir.path().join("without"), &views));
    assert_eq!(without["all"]["ar_vsd"], Value::Null);
    assert_eq!(without["all"]["ar"], Value::Null);

    // Nothing measured: all is seen. A wall 0.1 m before the cameras: nothing is.
    let depth = dataset.join("test/000001/depth");
    fs::create_dir(&depth).unwrap();
    let of = |name: &str, mm: u16| {
        for frame in 0..4 {
            let wall = image::ImageBuffer::from_pixel(160, 120, image::Luma([mm]));
            wall.save(depth.join(format!("{frame:06}.png"))).unwrap();
        }
        summary(&eval(&dataset, &dir.path().join(name), &views))["all"].clone()
    };
    let (open, hidden) = (of("open", 0), of("hidden", 100));
    let number = |scores: &Value, name: &str| scores[name].as_f64().unwrap();
    assert!(number(&open, "ar_vsd") > 0.0);
    let of_three = ["ar_mssd", "ar_mspd", "ar_vsd"].map(|name| number(&open, name));
    let mean = of_three.iter().sum::<f64>() / 3.0;
    assert!((number(&open, "ar") - mean).abs() < 1e-12);
    assert_eq!(number(&hidden, "ar_vsd"), 0.0);
    assert_eq!(hidden["ar_mssd"], open["ar_mssd"]);
}

#[test]
fn views_of_one_frame_give_what_a_scene_of_the_same_images_gives() {
    let dir = TempDir::new().unwrap();
    let (scene, frame) = (dir.path().join("a"), dir.path().join("b"));
    write_dataset(&scene, false);
    write_dataset(&frame, true);
    let targets = dir.path().join("targets.json");
    fs::write(
        &targets,
        r#"[{"scene_id": 1, "im_id": 0, "obj_id": 1, "inst_count": 1}]"#,
    )
    .unwrap();
    let targets = targets.display().to_string();
    let of_scene = eval(&scene, &dir.path().join("ra"), &["--targets", &targets]);
    let of_frame = eval(&frame, &dir.path().join("rb"), &["--grouping", "frame"]);
    let (of_scene, of_frame) = (summary(&of_scene), summary(&of_frame));
    assert_eq!(
        (&of_scene["views"], &of_scene["pairs"]),
        (&4.into(), &1.into())
    );
    assert_eq!(
        (&of_frame["views"], &of_frame["pairs"]),
        (&4.into(), &1.into())
    );
    for error in ["rot_mean_deg", "trans_mean_m", "add_mean_m"] {
        let (a, b) = (
            of_scene[error].as_f64().unwrap(),
            of_frame[error].as_f64().unwrap(),
        );
        assert!((a - b).abs() < 1e-4 * (1.0 + a), "{error}: {a} {b}");
    }
}
