//! Exposures that are kept, and shown to `infer` again.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::client::{Server, images, images_with_boxes, root, timeless};

/// By when it is ready again: a second, and what a debug build and busy cores make of it.
const READY: Duration = Duration::from_secs(10);

fn folders(dir: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(dir).unwrap();
    let mut all: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    all.sort();
    all
}

/// What an exposure's folder says about it.
fn about(folder: &Path) -> Value {
    let text = std::fs::read_to_string(folder.join("about.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// Does what an exposure's folder says.
fn replayed(folder: &Path) -> Output {
    let words = shlex::split(about(folder)["replay"].as_str().unwrap()).unwrap();
    assert_eq!(words[0], "mvtop-cli");
    let mut command = Command::new(env!("CARGO_BIN_EXE_mvtop-cli"));
    command.args(&words[1..]).current_dir(folder);
    command.output().unwrap()
}

#[test]
fn doubtful_exposure_is_kept_and_replayed_to_the_same_bits() {
    let dir = tempfile::tempdir().unwrap();
    let model = root().join("models/mvball").canonicalize().unwrap();
    let (kept, model) = (
        dir.path().display().to_string(),
        model.display().to_string(),
    );
    let server = Server::start(&["--model", &model, "--record", &kept]);
    let request = br#"{"min_confidence": 1.0, "frame": "cam1", "classes": ["mvball"]}"#.to_vec();
    let mut parts = images();
    parts.push(("request", "application/json", request));
    assert_eq!(server.post("?min_views=2", &[], &parts).status, 200);
    // One that is certain is not kept, one that failed is.
    assert_eq!(
        server.post("?min_confidence=0.01", &[], &images()).status,
        200
    );
    let broken = vec![("cam0", "image/png", b"no image".to_vec())];
    assert_eq!(server.post("", &[], &broken).status, 400);
    assert_eq!(server.stop(), Some(0));

    let all = folders(dir.path());
    assert_eq!(all.len(), 2, "{all:?}");
    let replayed = replayed(&all[0]);
    let stderr = String::from_utf8_lossy(&replayed.stderr);
    // 3, as the pose is not accepted.
    assert_eq!(replayed.status.code(), Some(3), "{stderr}");
    let before = std::fs::read_to_string(all[0].join("answer.json")).unwrap();
    let after = String::from_utf8(replayed.stdout).unwrap();
    assert_eq!(timeless(&before), timeless(&after));
    assert_eq!(timeless(&after)["frame"], "cam1");

    let failed = std::fs::read_to_string(all[1].join("about.json")).unwrap();
    assert!(
        failed.contains("none of PNG") && !all[1].join("answer.json").exists(),
        "{failed}"
    );
}

#[test]
fn killed_while_it_works_it_is_ready_again_and_its_records_are_whole() {
    let dir = tempfile::tempdir().unwrap();
    let model = root().join("models/mvball").canonicalize().unwrap();
    let (kept, model) = (
        dir.path().display().to_string(),
        model.display().to_string(),
    );
    let args = ["--model", &model, "--record", &kept];
    let mut server = Server::start(&args);
    let port = server.address.rsplit(':').next().unwrap().to_owned();
    let doubtful = "?min_confidence=1";
    assert_eq!(server.post(doubtful, &[], &images()).status, 200);
    let began = Instant::now();
    while folders(dir.path())
        .iter()
        .all(|path| !path.join("about.json").exists())
    {
        assert!(began.elapsed() < READY);
    }
    let mut waiting = server.connect();
    waiting
        .write_all(&server.posted("", &[], &images_with_boxes(100)))
        .unwrap();
    assert!(server.comes_to_queue(1, READY));
    server.child.kill().unwrap();
    server.child.wait().unwrap();
    // As it is where it was killed while it wrote.
    let partial = dir.path().join(".mvtop-partial-a");
    std::fs::create_dir(&partial).unwrap();
    std::fs::write(partial.join("cam0.png"), b"half").unwrap();

    let began = Instant::now();
    let again = Server::start_at(&port, &args);
    assert!(began.elapsed() < READY, "{:?}", began.elapsed());
    assert_eq!(again.get("/readyz", &[]).status, 200);
    assert_eq!(again.post(doubtful, &[], &images()).status, 200);
    assert_eq!(again.stop(), Some(0));
    let all = folders(dir.path());
    assert_eq!(all.len(), 2, "{all:?}");
    for folder in &all {
        assert_eq!(about(folder)["format"], "mvtop-record");
        assert_eq!(replayed(folder).status.code(), Some(3));
    }
}
