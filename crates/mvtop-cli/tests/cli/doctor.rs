//! `doctor`.

use std::ffi::OsStr;
use std::path::Path;
use std::process::{Command, Output};

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
    assert!(
        text.contains("self-test  answers as when it was exported"),
        "{text}"
    );
    for shipped in ["models/mvball", "models/ycbv4", "models/parts"] {
        let text = stdout(&mvtop(&["doctor", "--model", shipped]));
        assert!(
            text.contains("self-test  answers as when it was exported"),
            "{text}"
        );
    }
    let output = mvtop(&["doctor", "--ort-lib", "none.so"]);
    assert!(refusal(&output).contains("none.so"));
    assert!(String::from_utf8_lossy(&output.stdout).contains("checksums  match"));
    let output = mvtop(&["doctor", "--model", "none"]);
    assert!(refusal(&output).contains("none"));
    assert!(String::from_utf8_lossy(&output.stdout).contains("found in   --model"));
}

/// The tiny bundle with another description.
fn changed(change: impl FnOnce(&mut serde_json::Value)) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(root().join("fixtures/tiny")).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
        }
    }
    let about = folder.path().join("model.json");
    let mut model = serde_json::from_slice(&std::fs::read(&about).unwrap()).unwrap();
    change(&mut model);
    std::fs::write(&about, model.to_string()).unwrap();
    folder
}

#[test]
fn network_that_answers_otherwise_is_refused() {
    let folder = changed(|model| {
        let sigma = &mut model["self_test"]["outputs"]["sigma"][0];
        *sigma = (1.2 * sigma.as_f64().unwrap()).into();
    });
    let error = refusal(&mvtop(&[
        "doctor",
        "--model",
        folder.path().to_str().unwrap(),
    ]));
    assert!(
        error.contains("answers the self-test with sigma"),
        "{error}"
    );
    // It is not run at each load, and bundles of earlier exports have none.
    let old = changed(|model| {
        model.as_object_mut().unwrap().remove("self_test");
    });
    let text = stdout(&mvtop(&["doctor", "--model", old.path().to_str().unwrap()]));
    assert!(text.contains("self-test  none in this bundle"), "{text}");
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

/// `doctor` with nothing named but what `variables` say.
fn doctor_in(folder: &Path, variables: &[(&str, &OsStr)]) -> Output {
    let mut doctor = Command::new(env!("CARGO_BIN_EXE_mvtop-cli"));
    for variable in [
        "MVTOP_MODEL",
        "ORT_DYLIB_PATH",
        "VIRTUAL_ENV",
        "CONDA_PREFIX",
    ] {
        doctor.env_remove(variable);
    }
    doctor.env_remove("ORT_DISABLE_TELEMETRY");
    doctor.env_remove("XDG_CACHE_HOME");
    doctor.arg("doctor").current_dir(folder);
    doctor.envs(variables.iter().copied()).output().unwrap()
}

#[test]
fn nothing_of_the_current_folder_is_run() {
    let folder = tempfile::tempdir().unwrap();
    let mark = "open('ran', 'w').close()";
    let package = folder.path().join("onnxruntime");
    let within = "lib/python3.11/site-packages/onnxruntime/capi";
    for capi in [
        package.join("capi"),
        folder.path().join("venv").join(within),
    ] {
        std::fs::create_dir_all(&capi).unwrap();
        std::fs::write(capi.join("libonnxruntime.so.9.9.9"), "not to be loaded").unwrap();
    }
    std::fs::write(package.join("__init__.py"), mark).unwrap();
    for module in ["functools.py", "site.py", "sitecustomize.py"] {
        std::fs::write(folder.path().join(module), mark).unwrap();
    }
    for (variable, value) in [
        ("PYTHONPATH", ":/x"),
        ("PYTHONPATH", "."),
        ("VIRTUAL_ENV", "venv"),
    ] {
        let output = doctor_in(folder.path(), &[(variable, value.as_ref())]);
        let all = [output.stdout, output.stderr].concat();
        let all = String::from_utf8_lossy(&all);
        assert!(
            !folder.path().join("ran").exists(),
            "{variable}={value}: {all}"
        );
        let passed_over = all.contains("depends on the current folder");
        assert_eq!(
            passed_over,
            all.contains("9.9.9"),
            "{variable}={value}: {all}"
        );
    }
}

#[test]
fn model_of_the_current_folder_is_not_used_unless_it_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let theirs = folder.path().join("models/mvball");
    std::fs::create_dir_all(&theirs).unwrap();
    std::fs::write(theirs.join("model.json"), "{}").unwrap();
    let output = doctor_in(folder.path(), &[]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        text.contains("found in   a folder above the executable"),
        "{text}"
    );
    let output = doctor_in(folder.path(), &[("MVTOP_MODEL", theirs.as_os_str())]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("found in   $MVTOP_MODEL"), "{text}");
}

#[test]
fn library_keeps_nothing_of_its_user() {
    let home = tempfile::tempdir().unwrap();
    let library =
        std::env::var_os("ORT_DYLIB_PATH").expect("ORT_DYLIB_PATH, as `make test` has it");
    let model = root().join("fixtures/tiny").canonicalize().unwrap();
    let output = doctor_in(
        &root(),
        &[
            ("HOME", home.path().as_os_str()),
            ("ORT_DYLIB_PATH", &library),
            ("MVTOP_MODEL", model.as_os_str()),
        ],
    );
    assert!(stdout(&output).contains("all well"));
    let left: Vec<_> = std::fs::read_dir(home.path()).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
}
