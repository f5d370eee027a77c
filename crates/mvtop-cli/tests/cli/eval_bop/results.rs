//! Scores of results in BOP's format.

use super::*;

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
    let (dir, dataset, report) = balls();
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

#[test]
fn results_that_are_read_are_never_removed() {
    let (dir, dataset, report) = balls();
    summary(&eval(&dataset, &report, &["--views", "2"]));
    let [csv, page] = ["mvtop_balls-test.csv", "report.html"].map(|name| report.join(name));
    let text = fs::read(&csv).unwrap();
    let into = ["--report", report.to_str().unwrap(), "--force"];
    let of = |path: &Path, more: &[&str]| score(&dataset, &[path.to_str().unwrap()], more);
    // Scored into the folder that they came from, whatever they are called there.
    summary(&of(&csv, &into));
    assert_eq!(fs::read(&csv).unwrap(), text);
    fs::write(&page, &text).unwrap();
    let error = refusal(&of(&page, &into));
    assert!(
        error.contains("report.html is one of the files that are read"),
        "{error}"
    );
    assert_eq!(fs::read(&page).unwrap(), text);

    // Nor is a page of others, before anything is evaluated.
    let (pages, other) = (dir.path().join("pages"), dir.path().join("other.csv"));
    let compared = pages.join("compared.html");
    fs::create_dir(&pages).unwrap();
    fs::write(&compared, "theirs").unwrap();
    fs::copy(&csv, &other).unwrap();
    let both = [&csv, &other].map(|path| path.to_str().unwrap());
    let into = ["--report", pages.to_str().unwrap()];
    assert!(refusal(&score(&dataset, &both, &into)).contains("exists already"));
    assert_eq!(fs::read(&compared).unwrap(), b"theirs");
    assert_eq!(fs::read_dir(&pages).unwrap().count(), 1);
    summary(&score(&dataset, &both, &[&into[..], &["--force"]].concat()));
    assert!(fs::read(&compared).unwrap() != b"theirs");
}

#[test]
fn folders_of_results_have_names_and_lead_nowhere_else() {
    let (dir, dataset, report) = balls();
    summary(&eval(&dataset, &report, &["--views", "2"]));
    let csv = report.join("mvtop_balls-test.csv");
    let [dots, other] = ["...csv", "other.csv"].map(|name| dir.path().join(name));
    for copy in [&dots, &other] {
        fs::copy(&csv, copy).unwrap();
    }
    let pages = dir.path().join("pages");
    let into = ["--report", pages.to_str().unwrap(), "--force"];
    let with = |file: &Path| {
        let both = [csv.as_path(), file].map(|path| path.to_str().unwrap());
        refusal(&score(&dataset, &both, &into))
    };
    let error = with(&dots);
    assert!(
        error.contains("expected files with a name before their ending"),
        "{error}"
    );

    #[cfg(unix)]
    {
        let elsewhere = dir.path().join("elsewhere");
        fs::create_dir(&elsewhere).unwrap();
        fs::create_dir(&pages).unwrap();
        std::os::unix::fs::symlink(&elsewhere, pages.join("other")).unwrap();
        let error = with(&other);
        assert!(
            error.contains("other is a link, expected a folder or nothing"),
            "{error}"
        );
        assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 0);
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
fn recall_is_told_by_the_views_that_have_an_object_in_sight() {
    let (_dir, dataset, report) = balls();
    let in_sight = |more: &[&str]| {
        let rows = summary(&eval(&dataset, &report, more))["by_views_in_sight"].take();
        let row = |row: &Value| (row["views"].clone(), row["objects"].clone());
        rows.as_array().unwrap().iter().map(row).collect::<Vec<_>>()
    };
    // The data set does not say what is visible.
    assert_eq!(in_sight(&["--views", "4"]), []);
    fs::remove_dir_all(&report).unwrap();
    change(&dataset.join("test/000001/scene_gt_info.json"), |info| {
        for (view, visible) in [("0", 0.9), ("1", 0.5), ("2", 0.49), ("3", 0.0)] {
            info[view][0]["visib_fract"] = json!(visible);
        }
    });
    // Each image is the reference of a group of all four.
    assert_eq!(in_sight(&["--views", "4"]), [(json!(2), json!(4))]);
    let page = fs::read_to_string(report.join("report.html")).unwrap();
    assert!(page.contains("<td>2 views</td><td>4</td>"), "{page}");
    fs::remove_dir_all(&report).unwrap();
    let alone = [(json!(0), json!(2)), (json!(1), json!(2))];
    assert_eq!(in_sight(&["--views", "1"]), alone);
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
    let (_dir, dataset, report) = balls();
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
        error.contains("--map NAME=ID") && error.contains("docs/how-to/train.md"),
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
