//! What an evaluation writes as it goes: killed, gone on with, and never mixed.

use super::*;

#[test]
fn what_was_cut_short_goes_on_and_nothing_is_doubled() {
    let (_dir, dataset, report) = balls();
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
    let (_dir, dataset, report) = balls();
    fs::create_dir(&report).unwrap();
    fs::write(report.join("groups.jsonl"), "").unwrap();
    summary(&eval(&dataset, &report, &["--views", "2"]));
}

#[test]
fn results_of_data_that_have_changed_are_not_gone_on_with() {
    let (_dir, dataset, report) = balls();
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
    let (_dir, dataset, report) = balls();
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
    let (_dir, dataset, report) = balls();
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
