//! `eval bop`, on the fixture's sample written in BOP's layout.

use std::fs;
use std::path::Path;
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
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
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

#[test]
fn what_was_cut_short_goes_on_and_nothing_is_doubled() {
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
    let whole = summary(&eval(&dataset, &report, &["--views", "2"]));
    let journal = report.join("groups.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 4);
    // As a kill leaves it: two lines and a part of the third.
    let cut = format!(
        "{}\n{}\n{}",
        lines[0],
        lines[1],
        &lines[2][..lines[2].len() / 2]
    );
    fs::write(&journal, &cut).unwrap();
    let resumed = summary(&eval(&dataset, &report, &["--views", "2"]));
    assert_eq!(resumed, whole);
    let after = fs::read_to_string(&journal).unwrap();
    assert!(after.starts_with(&format!("{}\n{}\n", lines[0], lines[1])));
    let groups = |text: &str| -> Vec<Value> {
        let lines = text
            .lines()
            .map(|line| serde_json::from_str::<Value>(line).unwrap());
        lines.map(|line| line["group"].clone()).collect()
    };
    assert_eq!(groups(&after), groups(&text));
    // Once more: all is there, nothing is computed.
    assert_eq!(summary(&eval(&dataset, &report, &["--views", "2"])), whole);
    assert_eq!(fs::read_to_string(&journal).unwrap(), after);

    let other = refusal(&eval(&dataset, &report, &["--views", "1"]));
    assert!(
        other.contains("views was 2, is 1") && other.contains("--force"),
        "{other}"
    );
    let anew = summary(&eval(&dataset, &report, &["--views", "1", "--force"]));
    assert_eq!(anew["views"], 1);
}

#[test]
fn kill_before_the_first_word_leaves_nothing_in_the_way() {
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
    fs::create_dir(&report).unwrap();
    fs::write(report.join("groups.jsonl"), "").unwrap();
    summary(&eval(&dataset, &report, &["--views", "2"]));
}

#[test]
fn results_of_data_that_have_changed_are_not_gone_on_with() {
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
    let views = ["--views", "2"];
    summary(&eval(&dataset, &report, &views));
    let (gt, image) = ("test/000001/scene_gt.json", "test/000001/rgb/000002.png");
    let models = ["models/models_info.json", "models/obj_000001.ply"];
    for (file, what) in [
        (gt, "annotations_sha256"),
        (image, "images_sha256"),
        (models[0], "annotations_sha256"),
        (models[1], "meshes_sha256"),
    ] {
        let path = dataset.join(file);
        let (bytes, time) = (
            fs::read(&path).unwrap(),
            path.metadata().unwrap().modified().unwrap(),
        );
        // White space at the end changes nothing but the file.
        fs::write(&path, [&bytes[..], b"\n"].concat()).unwrap();
        let error = refusal(&eval(&dataset, &report, &views));
        assert!(error.contains(what) && error.contains("--force"), "{error}");
        fs::write(&path, bytes).unwrap();
        fs::File::options()
            .write(true)
            .open(&path)
            .unwrap()
            .set_modified(time)
            .unwrap();
    }
    summary(&eval(&dataset, &report, &views));
}

#[test]
fn group_that_stands_twice_is_refused() {
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
    summary(&eval(&dataset, &report, &["--views", "2"]));
    let journal = report.join("groups.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    let first = text.lines().next().unwrap();
    fs::write(&journal, format!("{text}{first}\n")).unwrap();
    let error = refusal(&eval(&dataset, &report, &["--views", "2"]));
    assert!(error.contains("stands twice"), "{error}");
}

#[test]
fn second_evaluation_into_a_folder_is_refused_as_long_as_the_first_runs() {
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
    let whole = summary(&eval(&dataset, &report, &["--views", "2"]));
    let journal = fs::File::open(report.join("groups.jsonl")).unwrap();
    journal.lock().unwrap();
    for more in [&["--views", "2"][..], &["--views", "2", "--force"]] {
        let error = refusal(&eval(&dataset, &report, more));
        assert!(error.contains("another evaluation is writing"), "{error}");
    }
    // As when the process that held it has ended.
    drop(journal);
    assert_eq!(summary(&eval(&dataset, &report, &["--views", "2"])), whole);
}

#[test]
fn files_of_others_are_never_replaced() {
    let dir = TempDir::new().unwrap();
    let dataset = dir.path().join("balls");
    write_dataset(&dataset, false);
    let files = [
        "report.html",
        "summary.json",
        "mvtop_balls-test.csv",
        "run.json",
        "groups.jsonl",
    ];
    for (i, name) in files.into_iter().enumerate() {
        let report = dir.path().join(i.to_string());
        fs::create_dir(&report).unwrap();
        fs::write(report.join(name), "{\"theirs\": true}").unwrap();
        for more in [&[][..], &["--force"]] {
            let error = refusal(&eval(&dataset, &report, more));
            assert!(
                error.contains(name) && error.contains("another folder"),
                "{error}"
            );
        }
        assert_eq!(
            fs::read_to_string(report.join(name)).unwrap(),
            "{\"theirs\": true}"
        );
        assert_eq!(fs::read_dir(&report).unwrap().count(), 1);
    }
}

#[test]
fn image_too_large_for_any_camera_is_refused_before_it_is_decoded() {
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
    let image = dataset.join("test/000001/rgb/000000.png");
    let mut png = fs::read(&image).unwrap();
    // Only the header says so; its checksum is made to agree.
    png[16..24].copy_from_slice(&[0, 0, 0x4E, 0x20, 0, 0, 0x4E, 0x20]);
    let crc = png[12..29].iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg())
        })
    });
    png[29..33].copy_from_slice(&(!crc).to_be_bytes());
    fs::write(&image, png).unwrap();
    change(&dataset.join("test/000001/scene_camera.json"), |cameras| {
        cameras["0"]["cam_K"] = json!([9000, 0, 9999.5, 0, 9000, 9999.5, 0, 0, 1]);
    });
    let error = refusal(&eval(&dataset, &report, &["--views", "2"]));
    assert!(
        error.contains("268435456 px at most, got 20000x20000"),
        "{error}"
    );
}

fn change(path: &Path, change: impl FnOnce(&mut Value)) {
    let mut content: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    change(&mut content);
    fs::write(path, content.to_string()).unwrap();
}

#[test]
fn numbers_that_look_like_a_mistake_are_refused() {
    type Mistake = (&'static str, fn(&mut Value), &'static str);
    let mistakes: [Mistake; 5] = [
        // Metres, where BOP has millimetres: within the ball.
        (
            "test/000001/scene_gt.json",
            |gt| gt["0"][0]["cam_t_m2c"] = json!([0.01, 0.02, 0.9]),
            "expected millimetres",
        ),
        (
            "test/000001/scene_camera.json",
            |cameras| cameras["0"]["depth_scale"] = json!(0.0),
            "depth_scale above 0",
        ),
        (
            "test/000001/scene_camera.json",
            |cameras| cameras["0"]["cam_K"] = json!([1.5, 0, 80, 0, 1.5, 60, 0, 0, 1]),
            "too short",
        ),
        (
            "models/models_info.json",
            |info| info["1"]["diameter"] = json!(0.1308),
            "obj_000001.ply",
        ),
        (
            "models/models_info.json",
            |info| info["1"]["diameter"] = json!(130_800),
            "obj_000001.ply",
        ),
    ];
    for (file, mistake, part) in mistakes {
        let dir = TempDir::new().unwrap();
        let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
        write_dataset(&dataset, false);
        change(&dataset.join(file), mistake);
        let error = refusal(&eval(&dataset, &report, &["--views", "2"]));
        assert!(error.contains(part), "{file}: {error}");
    }
}

#[test]
fn data_sets_that_do_not_fit_are_refused() {
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
    let refused = |more: &[&str], hint: &str| {
        let text = refusal(&eval(&dataset, &report, more));
        assert!(text.contains(hint), "{text}");
    };
    refused(&["--split", "val"], "val");
    refused(&["--views", "5"], "5 views");
    refused(&["--objects", "2"], "none of the objects");
    let info = dataset.join("models/models_info.json");
    fs::write(&info, r#"{"1": {"diameter": 130.8, "name": "box"}}"#).unwrap();
    refused(&[], "`box` in models_info.json and `mvball` in the model");
    fs::write(&info, r#"{"2": {"diameter": 130.8}}"#).unwrap();
    refused(&[], "expected object 1 in models_info.json");
    assert!(!report.exists());
}

/// Scores of results, without a network: there is none to be found.
fn score(dataset: &Path, predictions: &[&str], more: &[&str]) -> Output {
    let fixed = [
        "eval",
        "bop",
        "--json",
        "--dataset",
        dataset.to_str().unwrap(),
    ];
    let args = [&fixed, more, &["--predictions"], predictions].concat();
    std::process::Command::new(env!("CARGO_BIN_EXE_mvtop-cli"))
        .args(args)
        .env("MVTOP_MODEL", "nowhere")
        .env("ORT_DYLIB_PATH", "nowhere")
        .output()
        .unwrap()
}

#[test]
fn results_that_an_evaluation_wrote_give_its_scores_without_the_network() {
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
    let depth = dataset.join("test/000001/depth");
    fs::create_dir(&depth).unwrap();
    for frame in 0..4 {
        let open = image::ImageBuffer::from_pixel(160, 120, image::Luma([0u16]));
        open.save(depth.join(format!("{frame:06}.png"))).unwrap();
    }
    let of_network = summary(&eval(&dataset, &report, &["--views", "2"]));
    let csv = report.join("mvtop_balls-test.csv").display().to_string();
    let again = dir.path().join("again");
    let of_file = summary(&score(
        &dataset,
        &[&csv],
        &["--report", again.to_str().unwrap()],
    ));
    assert!(of_network["all"]["ar"].as_f64().unwrap() > 0.0);
    for part in ["all", "objects"] {
        let numbers = |value: &Value| -> Vec<(String, Value)> {
            let value = if part == "all" { value } else { &value["1"] };
            let scores = value.as_object().unwrap().clone();
            scores
                .into_iter()
                .filter(|(_, score)| score.is_number())
                .collect()
        };
        let (a, b) = (numbers(&of_network[part]), numbers(&of_file[part]));
        assert!(a.len() > 8);
        for ((name, a), (same, b)) in a.iter().zip(&b) {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            assert_eq!(name, same);
            assert!((a - b).abs() < 1e-9, "{name}: {a} {b}");
        }
    }
    for name in ["pairs", "found", "extra", "right", "precision", "recall"] {
        assert_eq!(of_file[name], of_network[name], "{name}");
    }
    assert_eq!(of_file["sigma_rot_mean_deg"], Value::Null);
    assert!(of_file["time_mean_s"].as_f64().unwrap() > 0.0);
    let page = fs::read_to_string(again.join("report.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), 5);
    // It goes on, and is not mistaken for the results of another file.
    summary(&score(
        &dataset,
        &[&csv],
        &["--report", again.to_str().unwrap()],
    ));
    let other = dir.path().join("other.csv");
    let text = fs::read_to_string(&csv).unwrap();
    fs::write(&other, text.lines().take(3).collect::<Vec<_>>().join("\n")).unwrap();
    let other = other.display().to_string();
    let error = refusal(&score(
        &dataset,
        &[&other],
        &["--report", again.to_str().unwrap()],
    ));
    assert!(error.contains("predictions_sha256"), "{error}");

    // Two files side by side, without a folder.
    let both = summary(&score(&dataset, &[&csv, &other], &[]));
    assert_eq!(both["mvtop_balls-test"]["all"], of_file["all"]);
    assert_eq!(both["other"]["all"]["found"], 2);
    assert_eq!(both["other"]["all"]["objects"], 4);

    // With one, a page that compares them beside the page of each.
    let pages = dir.path().join("pages");
    let with_pages = ["--report", pages.to_str().unwrap()];
    assert_eq!(
        summary(&score(&dataset, &[&csv, &other], &with_pages)),
        both
    );
    let page = fs::read_to_string(pages.join("compared.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), 1);
    // A row of all scores each, and a column each by object.
    assert_eq!(page.matches("<td>mvtop_balls-test</td>").count(), 1);
    assert_eq!(page.matches("<th>other</th>").count(), 3);
    let ar = format!(
        "<td>{:.1} %</td>",
        100.0 * both["other"]["all"]["ar"].as_f64().unwrap()
    );
    assert!(page.matches(&ar).count() >= 2, "{ar}: {page}");
    for name in ["mvtop_balls-test", "other"] {
        assert!(pages.join(name).join("report.html").is_file());
    }
}

/// A data set of two balls in one image, 0.3 m apart, of which the second one is seen better.
fn two_balls(dir: &Path) {
    write_dataset(dir, false);
    change(&dir.join("test/000001/scene_gt.json"), |gt| {
        let mut other = gt["0"][0].clone();
        let x = other["cam_t_m2c"][0].as_f64().unwrap();
        other["cam_t_m2c"][0] = json!(x + 300.0);
        gt["0"].as_array_mut().unwrap().push(other);
    });
    change(&dir.join("test/000001/scene_gt_info.json"), |info| {
        let bbox = info["0"][0]["bbox_obj"].clone();
        info["0"] = json!([
            {"bbox_obj": bbox, "visib_fract": 0.05}, {"bbox_obj": bbox, "visib_fract": 0.9},
        ]);
    });
}

#[test]
fn targets_are_the_most_visible_and_estimates_the_surest() {
    let dir = TempDir::new().unwrap();
    let dataset = dir.path().join("balls");
    two_balls(&dataset);
    let gt = fs::read(dataset.join("test/000001/scene_gt.json")).unwrap();
    let gt: Value = serde_json::from_slice(&gt).unwrap();
    let line = |row: usize, score: f64, shift_mm: f64| {
        let numbers = |value: &Value| -> Vec<f64> {
            value
                .as_array()
                .unwrap()
                .iter()
                .map(|x| x.as_f64().unwrap())
                .collect()
        };
        let (r, mut t) = (
            numbers(&gt["0"][row]["cam_R_m2c"]),
            numbers(&gt["0"][row]["cam_t_m2c"]),
        );
        t[0] += shift_mm;
        let text = |numbers: &[f64]| {
            numbers
                .iter()
                .map(f64::to_string)
                .collect::<Vec<_>>()
                .join(" ")
        };
        format!("1,0,mvball,{score},{},{},0.5\n", text(&r), text(&t))
    };
    let csv = dir.path().join("all.csv");
    let targets = dir.path().join("targets.json");
    let rows = |count: u32| json!([{"scene_id": 1, "im_id": 0, "obj_id": 1, "inst_count": count}]);
    let of = |lines: &[&String], count: Option<u32>| {
        let text: String = lines.iter().map(|line| line.as_str()).collect();
        fs::write(&csv, text).unwrap();
        let more = count.map(|count| {
            fs::write(&targets, rows(count).to_string()).unwrap();
            targets.display().to_string()
        });
        let more: Vec<&str> = more.iter().flat_map(|path| ["--targets", path]).collect();
        summary(&score(&dataset, &[csv.to_str().unwrap()], &more))["all"].clone()
    };
    let scores =
        |all: &Value| ["objects", "found", "ar_mssd"].map(|name| all[name].as_f64().unwrap());
    let (hidden, seen) = (line(0, 0.9, 0.0), line(1, 0.5, 0.0));
    // One instance is asked for: the second, which is seen better; the surest estimate is of the first.
    assert_eq!(scores(&of(&[&hidden, &seen], Some(1))), [1.0, 0.0, 0.0]);
    assert_eq!(scores(&of(&[&seen], Some(1))), [1.0, 1.0, 1.0]);
    assert_eq!(scores(&of(&[&hidden, &seen], Some(2))), [2.0, 2.0, 1.0]);
    // Images 1 to 3 count, too, without targets: five balls.
    assert_eq!(scores(&of(&[&hidden, &seen], None)), [5.0, 2.0, 0.4]);
    // 20 mm are 0.153 diameters: not below 0.05, 0.1 and 0.15, but below the seven others.
    let off = line(1, 0.5, 20.0);
    assert_eq!(scores(&of(&[&off], Some(1))), [1.0, 1.0, 0.7]);
    // The surer one is off: at each threshold each target is taken once, by what is below it.
    let exact = line(1, 0.4, 0.0);
    assert_eq!(scores(&of(&[&off, &exact, &hidden], None)), [5.0, 2.0, 0.4]);
}

#[test]
fn results_that_do_not_fit_are_refused_or_told_of() {
    let dir = TempDir::new().unwrap();
    let dataset = dir.path().join("balls");
    write_dataset(&dataset, false);
    let csv = dir.path().join("some.csv");
    let with = |text: &str, more: &[&str]| {
        fs::write(&csv, text).unwrap();
        score(&dataset, &[csv.to_str().unwrap()], more)
    };
    let pose = "1 0 0 0 1 0 0 0 1,0 0 900,-1";
    let error = refusal(&with(&format!("7,0,1,0.5,{pose}\n"), &[]));
    assert!(
        error.contains("got none in 1 lines") && error.contains("--split"),
        "{error}"
    );
    let error = refusal(&with(&format!("1,0,ball,0.5,{pose}\n"), &[]));
    assert!(
        error.contains("some.csv: line 1: ") && error.contains("--map NAME=ID"),
        "{error}"
    );
    let mapped = with(
        &format!("1,0,ball,0.5,{pose}\n7,0,1,0.5,{pose}\n"),
        &["--map", "ball=1"],
    );
    let warnings = String::from_utf8_lossy(&mapped.stderr).into_owned();
    assert!(
        warnings.starts_with("warning: 1 of 2 poses in "),
        "{warnings}"
    );
    assert_eq!(summary(&mapped)["time_mean_s"], Value::Null);
    for (more, part) in [
        (&["--views", "2"][..], "--views"),
        (&["--model", "x"], "--model"),
        (&["--objects", "3"], "object 3 of --objects"),
    ] {
        let output = with(&format!("1,0,1,0.5,{pose}\n"), more);
        assert_eq!(output.status.code(), Some(2));
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn class_of_another_number_is_evaluated_where_it_is_mapped() {
    let dir = TempDir::new().unwrap();
    let (dataset, report) = (dir.path().join("balls"), dir.path().join("report"));
    write_dataset(&dataset, false);
    let models = dataset.join("models");
    fs::rename(models.join("obj_000001.ply"), models.join("obj_000007.ply")).unwrap();
    fs::write(
        models.join("models_info.json"),
        r#"{"7": {"diameter": 130.8}}"#,
    )
    .unwrap();
    change(&dataset.join("test/000001/scene_gt.json"), |gt| {
        for poses in gt.as_object_mut().unwrap().values_mut() {
            poses[0]["obj_id"] = json!(7);
        }
    });
    let error = refusal(&eval(&dataset, &report, &["--views", "2"]));
    assert!(
        error.contains("--map NAME=ID") && error.contains("docs/training.md"),
        "{error}"
    );
    let error = refusal(&eval(&dataset, &report, &["--map", "ball=7"]));
    assert!(
        error.contains("no class `ball` in the model, expected one of: mvball"),
        "{error}"
    );
    let found = summary(&eval(
        &dataset,
        &report,
        &["--views", "2", "--map", "mvball=7"],
    ));
    assert_eq!(found["objects"]["7"]["found"], 4);
}

#[test]
fn doubtful_data_sets_are_evaluated_with_warnings() {
    let dir = TempDir::new().unwrap();
    let dataset = dir.path().join("balls");
    write_dataset(&dataset, false);
    let warnings = |name: &str, more: &[&str]| {
        let output = eval(&dataset, &dir.path().join(name), more);
        summary(&output);
        String::from_utf8(output.stderr).unwrap()
    };
    assert_eq!(warnings("plain", &["--views", "2"]), "");
    let targets = dir.path().join("targets.json");
    let list = r#"[{"scene_id": 1, "im_id": [0, 1, 0, 2]}, {"scene_id": 1, "im_id": [1, 2]},
                   {"scene_id": 1, "im_id": [["default", 3]]}]"#;
    fs::write(&targets, list).unwrap();
    let targets = targets.display().to_string();
    let text = warnings("lists", &["--views", "3", "--targets", &targets]);
    // An untrained network's rotation may contradict the boxes: that is not about the data.
    let of_data = |line: &&str| !line.contains("check the rig");
    let lines: Vec<&str> = text.lines().filter(of_data).collect();
    assert!(
        lines[0].contains("1 of 3 groups have one view, the first is 000001/000003"),
        "{text}"
    );
    assert!(
        lines[1].contains("1 of 3 groups in --targets have fewer than 3 views"),
        "{text}"
    );
    assert_eq!(lines.len(), 2, "{text}");
    let journal = fs::read_to_string(dir.path().join("lists/groups.jsonl")).unwrap();
    assert!(
        journal.contains("\"000001/000000+000001+000002\""),
        "{journal}"
    );

    change(&dataset.join("test/000001/scene_gt.json"), |gt| {
        let x = gt["1"][0]["cam_R_m2c"][0].as_f64().unwrap();
        gt["1"][0]["cam_R_m2c"][0] = json!(x + 0.004);
    });
    let text = warnings("off", &["--views", "2"]);
    assert!(
        text.starts_with("warning: 1 of 4 rotations of the ground truth"),
        "{text}"
    );
    assert!(text.contains("scene_gt.json: image 1, row 0"), "{text}");
    fs::remove_file(dataset.join("test/000001/scene_gt_info.json")).unwrap();
    let text = warnings("no boxes", &["--views", "2"]);
    assert!(
        text.contains("1 scenes have no bbox_obj") && text.contains("--true-boxes"),
        "{text}"
    );
}

#[test]
fn results_of_several_sensors_are_scored_one_at_a_time() {
    let dir = TempDir::new().unwrap();
    let dataset = dir.path().join("balls");
    write_dataset(&dataset, true);
    let targets = dir.path().join("targets.json");
    let list = r#"[{"scene_id": 1, "im_id": [["cam0", 0], ["cam1", 0]]},
                   {"scene_id": 1, "im_id": [["cam1", 0], ["cam0", 0]]},
                   {"scene_id": 1, "im_id": [["cam1", 0], ["cam2", 0]]}]"#;
    fs::write(&targets, list).unwrap();
    let csv = dir.path().join("poses.csv");
    fs::write(&csv, "1,0,1,0.5,1 0 0 0 1 0 0 0 1,0 0 900,-1\n").unwrap();
    let [targets, csv] = [targets, csv].map(|path| path.display().to_string());
    let more = ["--targets", &targets];
    let error = refusal(&score(&dataset, &[&csv], &more));
    assert!(
        error.contains("several sensors (cam0, cam1)") && error.contains("--sensor"),
        "{error}"
    );
    let more = [&more[..], &["--sensor", "cam1"]].concat();
    assert_eq!(summary(&score(&dataset, &[&csv], &more))["pairs"], 1);
}
