//! Files that are missing, changed, elsewhere or too large.

use super::*;

#[test]
fn the_sha256_is_that_of_the_standard() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("abc"), "abc").unwrap();
    let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    let file = File::open(dir.path().join("abc")).unwrap();
    assert_eq!(digest(file).unwrap(), expected);
}

#[test]
fn a_folder_without_a_bundle_is_refused_by_name() {
    let error = Bundle::load(Path::new("/no/such/bundle"))
        .unwrap_err()
        .to_string();
    assert!(error.contains("/no/such/bundle/model.json"), "{error}");
}

#[test]
fn a_changed_a_cut_and_a_missing_file_are_refused_by_name() {
    for (contents, part) in [("Features", "sha256"), ("feat", "4 bytes, expected 8")] {
        let dir = bundle(|_| ());
        std::fs::write(dir.path().join("f.onnx"), contents).unwrap();
        let error = Bundle::load(dir.path()).unwrap_err().to_string();
        assert!(error.contains("f.onnx") && error.contains(part), "{error}");
    }
    let dir = bundle(|_| ());
    std::fs::remove_file(dir.path().join("d.onnx")).unwrap();
    let error = Bundle::load(dir.path()).unwrap_err().to_string();
    assert!(
        error.contains("d.onnx") && error.contains("cannot be read"),
        "{error}"
    );
}

#[test]
fn a_file_of_another_length_is_refused_before_it_is_hashed() {
    let dir = bundle(|_| ());
    // Of a terabyte that takes no space, hashing would not come to an end.
    let file = File::create(dir.path().join("f.onnx")).unwrap();
    file.set_len(1 << 40).unwrap();
    let error = Bundle::load(dir.path()).unwrap_err().to_string();
    assert!(error.contains("1099511627776 bytes, expected 8"), "{error}");
}

#[test]
fn graph_with_weights_in_other_files_is_refused() {
    // A graph with a tensor whose data_location is EXTERNAL; as long as `GRAPH`.
    let graph = [7 << 3 | 2, 6, 5 << 3 | 2, 4, 14 << 3, 1, 8, 1];
    let dir = bundle(|m| {
        m["files"]["f.onnx"]["sha256"] = format!("{:x}", Sha256::digest(graph)).into();
    });
    std::fs::write(dir.path().join("f.onnx"), graph).unwrap();
    let error = Bundle::load(dir.path()).unwrap_err().to_string();
    assert!(
        error.contains("f.onnx") && error.contains("weights in other files"),
        "{error}"
    );
}

#[cfg(unix)]
#[test]
fn links_and_devices_in_a_bundle_are_refused() {
    use std::os::unix::fs::symlink;
    let elsewhere = tempfile::tempdir().unwrap();
    std::fs::write(elsewhere.path().join("f.onnx"), GRAPH).unwrap();
    for target in [elsewhere.path().join("f.onnx"), "/dev/zero".into()] {
        let dir = bundle(|_| ());
        std::fs::remove_file(dir.path().join("f.onnx")).unwrap();
        symlink(&target, dir.path().join("f.onnx")).unwrap();
        let error = Bundle::load(dir.path()).unwrap_err().to_string();
        assert!(
            error.contains("f.onnx is a link") || error.contains("f.onnx: is a link"),
            "{error}"
        );
    }
    // The folder itself may be reached by a link.
    let dir = bundle(|_| ());
    let link = elsewhere.path().join("bundle");
    symlink(dir.path(), &link).unwrap();
    Bundle::load(&link).unwrap();
}

#[test]
fn a_file_that_no_checksum_covers_is_refused() {
    for name in ["f.onnx", "d.onnx", "p.json"] {
        let error = refusal(|m| {
            m["files"].as_object_mut().unwrap().remove(name);
        });
        assert!(
            error.contains(&format!("`{name}` is used but not listed")),
            "{error}"
        );
    }
}

#[test]
fn paths_that_leave_the_folder_are_refused() {
    for name in ["../secret", "/etc/passwd", "a/../../b", ""] {
        let error = refusal(|m| m["files"][name] = json!({ "bytes": 0, "sha256": "" }));
        assert!(error.contains("outside the bundle"), "{name}: {error}");
    }
}

#[test]
fn parts_larger_than_any_is_are_refused_before_they_are_read() {
    let with_file = |name: &str, key: &str, size: usize| {
        let dir = bundle(|m| m["classes"][0][key] = name.into());
        std::fs::write(dir.path().join(name), vec![b' '; size]).unwrap();
        let file = File::open(dir.path().join(name)).unwrap();
        let path = dir.path().join("model.json");
        let text = std::fs::read_to_string(&path).unwrap();
        let mut model: Value = serde_json::from_str(&text).unwrap();
        model["files"][name] = json!({"bytes": size, "sha256": digest(file).unwrap()});
        std::fs::write(&path, model.to_string()).unwrap();
        Bundle::load(dir.path()).unwrap_err().to_string()
    };
    for (name, key, size) in [("q.json", "points", 3 << 20), ("m.ply", "mesh", 9 << 20)] {
        let error = with_file(name, key, size);
        assert!(
            error.contains(name) && error.contains("larger than"),
            "{error}"
        );
    }
    let many = refusal(|m| {
        let class = |i: usize| json!({"id": i, "name": i.to_string(), "diameter_m": 0.1, "points": "p.json"});
        m["classes"] = (0..257).map(class).collect();
    });
    assert!(
        many.contains("classes are 257, expected 1 to 256"),
        "{many}"
    );
    let turns = refusal(|m| {
        let turn = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
        m["classes"][0]["symmetries_discrete"] = vec![turn; 1001].into();
    });
    assert!(turns.contains("symmetries_discrete are 1001"), "{turns}");
}
