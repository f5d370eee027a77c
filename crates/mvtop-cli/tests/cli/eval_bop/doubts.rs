//! Data sets that cannot be meant, or may not be.

use super::*;

#[test]
fn image_too_large_for_any_camera_is_refused_before_it_is_decoded() {
    let (_dir, dataset, report) = balls();
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
        let (_dir, dataset, report) = balls();
        change(&dataset.join(file), mistake);
        let error = refusal(&eval(&dataset, &report, &["--views", "2"]));
        assert!(error.contains(part), "{file}: {error}");
    }
}

#[test]
fn origin_beside_its_object_may_be_near_a_camera() {
    let (_dir, dataset, report) = balls();
    change(&dataset.join("test/000001/scene_gt.json"), |gt| {
        gt["0"][0]["cam_t_m2c"] = json!([0.0, 0.0, 20.0]);
    });
    summary(&eval(&dataset, &report, &["--views", "2"]));
}

#[test]
fn data_sets_that_do_not_fit_are_refused() {
    let (_dir, dataset, report) = balls();
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
        lines[1].contains("1 of 3 groups have fewer than the 3 views asked for"),
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
fn scene_with_fewer_images_than_asked_for_is_evaluated_with_all_it_has() {
    let dir = TempDir::new().unwrap();
    let dataset = dir.path().join("balls");
    write_dataset(&dataset, false);
    let [whole, part] = ["000001", "000002"].map(|name| dataset.join("test").join(name));
    fs::create_dir_all(part.join("rgb")).unwrap();
    for number in 0..3 {
        let image = format!("rgb/{number:06}.png");
        fs::copy(whole.join(&image), part.join(&image)).unwrap();
    }
    for file in ["scene_camera.json", "scene_gt.json", "scene_gt_info.json"] {
        fs::copy(whole.join(file), part.join(file)).unwrap();
        change(&part.join(file), |images| {
            images.as_object_mut().unwrap().remove("3");
        });
    }
    let report = dir.path().join("report");
    let output = eval(&dataset, &report, &["--views", "4"]);
    let text = String::from_utf8(output.stderr).unwrap();
    let told = "3 of 7 groups have fewer than the 4 views asked for, the first is 000002/000000";
    assert!(text.contains(told), "{text}");
    let journal = fs::read_to_string(report.join("groups.jsonl")).unwrap();
    assert!(
        journal.contains("\"000002/000001+000002+000000\""),
        "{journal}"
    );
}
