//! What holds of every command's arguments.

use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use crate::{mvtop, root, stdout};

/// The command lines of a text, each in one line, without quotes and what a shell would make of the rest.
fn commands(text: &str) -> Vec<String> {
    let text = text.replace("\\\n", " ");
    let lines = text.lines().map(str::trim);
    lines
        .filter_map(|line| line.strip_prefix("mvtop-cli "))
        .map(|line| line.split(['#', '>']).next().unwrap().trim())
        .map(|line| line.replace('\'', ""))
        .collect()
}

/// The pages in a folder and those below.
fn markdown(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            markdown(&path, found);
        } else if path.extension().is_some_and(|name| name == "md") {
            found.push(path);
        }
    }
}

#[test]
fn commands_of_help_and_documents_are_understood() {
    let mut texts: Vec<String> = [
        &["infer"][..],
        &["eval", "samples"],
        &["eval", "bop"],
        &["audit", "leakage"],
    ]
    .iter()
    .map(|command| stdout(&mvtop(&[*command, &["--help"]].concat())))
    .collect();
    for text in &texts {
        assert!(
            text.lines().all(|line| line.chars().count() <= 100),
            "{text}"
        );
        assert!(commands(text).len() > 1, "no examples in:\n{text}");
    }
    let mut files = vec![root().join("README.md")];
    markdown(&root().join("docs"), &mut files);
    let pages = files
        .iter()
        .map(|file| std::fs::read_to_string(file).unwrap());
    let pages: Vec<String> = pages.filter(|text| !commands(text).is_empty()).collect();
    assert!(pages.len() > 5, "{files:?}");
    texts.extend(pages);
    let nothing = TempDir::new().unwrap();
    for command in texts.iter().flat_map(|text| commands(text)) {
        let output = Command::new(env!("CARGO_BIN_EXE_mvtop-cli"))
            .args(command.split_whitespace())
            .current_dir(nothing.path())
            .output()
            .unwrap();
        // Nothing of what they name is there, but there is nothing to say of how it is named.
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(
            stderr.lines().count() <= 1 && !stderr.contains("type:"),
            "{command}: {stderr}"
        );
    }
}

#[test]
fn wrong_arguments_end_with_code_2() {
    for args in [
        &[][..],
        &["guess"],
        &["infer"],
        &["infer", "--rig", "rig.json"],
        &[
            "infer",
            "--rig",
            "rig.json",
            "a.png",
            "--provider",
            "abacus",
        ],
        &[
            "infer",
            "--rig",
            "rig.json",
            "a.png",
            "--json",
            "--truth",
            "truth.json",
        ],
        &["eval", "samples", "x", "--views", "0"],
        &["eval", "bop", "--dataset", "x"],
        &[
            "eval",
            "bop",
            "--dataset",
            "x",
            "--out",
            "y",
            "--report",
            "y",
        ],
        &["audit", "leakage", "--a", "x", "--b", "y", "--force"],
    ] {
        let output = mvtop(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(
            output.stdout.is_empty() && !output.stderr.is_empty(),
            "{args:?}"
        );
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_version_that_cannot_be_written_is_a_failure() {
    for argument in ["--version", "--help"] {
        let full = std::fs::OpenOptions::new()
            .write(true)
            .open("/dev/full")
            .unwrap();
        let status = std::process::Command::new(env!("CARGO_BIN_EXE_mvtop-cli"))
            .arg(argument)
            .stdout(full)
            .status()
            .unwrap();
        assert_eq!(status.code(), Some(2), "{argument}");
    }
}

/// Rust's runtime opens `/dev/null` where stdout is closed.
#[cfg(target_os = "linux")]
#[test]
fn a_closed_stdout_is_a_failure() {
    let command = "exec \"$0\" --version >&-";
    let output = std::process::Command::new("sh")
        .args(["-c", command, env!("CARGO_BIN_EXE_mvtop-cli")])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(
        error.contains("stdout is closed, expected a stream"),
        "{error}"
    );
}
