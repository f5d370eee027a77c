//! Evaluations that begin in one folder at once and are killed at any moment.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use serde_json::Value;
use tempfile::TempDir;

use crate::eval_bop::write_dataset;

/// Every round begins with a new folder.
const ROUNDS: usize = 25;

/// Scores results without a network, so that many fit into a test.
fn begin(dataset: &Path, predictions: &Path, out: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_mvtop-cli"))
        .args(["eval", "bop", "--json"])
        .args([Path::new("--dataset"), dataset, Path::new("--out"), out])
        .args([Path::new("--predictions"), predictions])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// What an evaluation says that is let be.
fn said(child: Child) -> Result<Value, String> {
    let output = child.wait_with_output().unwrap();
    match output.status.success() {
        true => Ok(serde_json::from_slice(&output.stdout).unwrap()),
        false => Err(String::from_utf8(output.stderr).unwrap()),
    }
}

#[test]
fn evaluations_that_begin_at_once_and_are_killed_never_mix() {
    let dir = TempDir::new().unwrap();
    let dataset = dir.path().join("balls");
    write_dataset(&dataset, false);
    // Two files of results, whose scores differ.
    let header = "scene_id,im_id,obj_id,score,R,t,time\n";
    let runs: Vec<(_, Value, String)> = [("near", 700), ("far", 900)]
        .map(|(name, z)| {
            let row = |image| format!("1,{image},1,1,1 0 0 0 1 0 0 0 1,0 0 {z},-1\n");
            let path = dir.path().join(name).with_extension("csv");
            fs::write(
                &path,
                header.to_owned() + &(0..4).map(row).collect::<String>(),
            )
            .unwrap();
            let out = dir.path().join(name);
            let scores = said(begin(&dataset, &path, &out)).unwrap();
            let lines = fs::read_to_string(out.join("groups.jsonl")).unwrap();
            (path, scores, lines)
        })
        .into();
    assert_ne!(runs[0].1, runs[1].1);
    let start = Instant::now();
    said(begin(&dataset, &runs[0].0, &dir.path().join("timed"))).unwrap();
    let took = start.elapsed().as_secs_f64();

    let mut draw = ChaCha8Rng::seed_from_u64(1);
    let mut killed = 0;
    for round in 0..ROUNDS {
        let out = dir.path().join(format!("round{round}"));
        let begun: Vec<(usize, Child)> = (0..4)
            .map(|i| (i % 2, begin(&dataset, &runs[i % 2].0, &out)))
            .collect();
        for (run, mut child) in begun {
            std::thread::sleep(Duration::from_secs_f64(draw.random_range(0.0..took / 2.0)));
            if draw.random_bool(0.7) {
                killed += usize::from(child.try_wait().unwrap().is_none());
                child.kill().unwrap();
                child.wait().unwrap();
                continue;
            }
            match said(child) {
                Ok(scores) => assert_eq!(scores, runs[run].1),
                Err(error) => assert!(
                    error.contains("another evaluation is writing")
                        || error.contains("is of another evaluation (predictions_sha256"),
                    "{error}"
                ),
            }
        }
        // The one whose folder it is, or that finds it without one, goes on to the same end.
        let finished = runs.iter().filter_map(|(path, scores, lines)| {
            let got = said(begin(&dataset, path, &out));
            let got = got.map_err(|error| assert!(error.contains("of another"), "{error}"));
            let journal = fs::read_to_string(out.join("groups.jsonl")).unwrap();
            let got = got.ok()?;
            assert_eq!(&got, scores);
            assert_eq!(&journal, lines);
            Some(())
        });
        assert_eq!(finished.count(), 1);
    }
    assert!(killed > 0, "none was killed before its end");
}
