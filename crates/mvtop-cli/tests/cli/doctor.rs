//! `doctor`.

use std::process::Command;

use crate::{mvtop, refusal, root, stdout};

#[test]
fn doctor_says_what_was_found_or_what_to_do() {
    let text = stdout(&mvtop(&["doctor"]));
    for found in [
        "ONNX Runtime",
        "providers   cpu",
        "mvball",
        "found in   $MVTOP_MODEL",
        "all well",
    ] {
        assert!(text.contains(found), "{found} is missing in:\n{text}");
    }
    let output = mvtop(&["doctor", "--ort-lib", "none.so"]);
    assert!(refusal(&output).contains("none.so"));
    assert!(String::from_utf8_lossy(&output.stdout).contains("checksums  match"));
    let output = mvtop(&["doctor", "--model", "none"]);
    assert!(refusal(&output).contains("none"));
    assert!(String::from_utf8_lossy(&output.stdout).contains("found in   --model"));
}

#[test]
fn library_of_the_current_folder_or_one_above_is_never_looked_at() {
    let folder = tempfile::tempdir().unwrap();
    let capi = ".venv/lib/python3.11/site-packages/onnxruntime/capi";
    let within = folder.path().join("data/set");
    for dir in [folder.path().join(capi), within.join(capi)] {
        std::fs::create_dir_all(&dir).unwrap();
        std::fs::write(dir.join("libonnxruntime.so.9.9.9"), "not to be loaded").unwrap();
    }
    let output = Command::new(env!("CARGO_BIN_EXE_mvtop-cli"))
        .arg("doctor")
        .current_dir(&within)
        .env("MVTOP_MODEL", root().join("fixtures/tiny"))
        .env("PATH", "")
        .env_remove("ORT_DYLIB_PATH")
        .env_remove("VIRTUAL_ENV")
        .env_remove("CONDA_PREFIX")
        .output()
        .unwrap();
    let all = [output.stdout, output.stderr].concat();
    let all = String::from_utf8_lossy(&all);
    assert!(!all.contains("9.9.9"), "{all}");
}
