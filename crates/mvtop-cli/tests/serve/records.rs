//! Exposures that are kept, and shown to `infer` again.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::client::{Server, images, root, timeless};

fn folders(dir: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(dir).unwrap();
    let mut all: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    all.sort();
    all
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
    let about = std::fs::read_to_string(all[0].join("about.json")).unwrap();
    let about: serde_json::Value = serde_json::from_str(&about).unwrap();
    let words = shlex::split(about["replay"].as_str().unwrap()).unwrap();
    assert_eq!(words[0], "mvtop-cli");
    let replayed = Command::new(env!("CARGO_BIN_EXE_mvtop-cli"))
        .args(&words[1..])
        .current_dir(&all[0])
        .output()
        .unwrap();
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
