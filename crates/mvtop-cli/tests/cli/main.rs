//! The binary as a user runs it. Tests of real inference need ONNX Runtime: they fail without it.

mod arguments;
mod audit;
mod doctor;
mod eval_bop;
mod eval_samples;
mod infer;
#[cfg(unix)]
mod journal;
mod rig;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

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

fn matrix(value: &Value) -> Vec<f64> {
    let rows = value.as_array().unwrap().iter();
    rows.flat_map(|row| row.as_array().unwrap())
        .map(|x| x.as_f64().unwrap())
        .collect()
}

/// By how many degrees and metres the `T_world_obj` of two objects differ.
fn off(a: &Value, b: &Value) -> (f64, f64) {
    let (a, b) = (matrix(&a["T_world_obj"]), matrix(&b["T_world_obj"]));
    let rotation = [0, 1, 2, 4, 5, 6, 8, 9, 10];
    let trace: f64 = rotation.iter().map(|&i| a[i] * b[i]).sum();
    let cos = ((trace - 1.0) / 2.0).clamp(-1.0, 1.0);
    let squares = [3, 7, 11].map(|i| (a[i] - b[i]).powi(2));
    (cos.acos().to_degrees(), squares.iter().sum::<f64>().sqrt())
}
