//! Readers answer any file with a value or a sentence, never with a panic: real files, changed at
//! random. `make fuzz` draws new ones for as long as one likes.

mod answers;
mod mutate;

use std::fmt::Display;
use std::path::{Path, PathBuf};

use mutate::{changed, edits};
use mvtop_core::bundle::Bundle;
use mvtop_core::{Camera, Estimator, Intrinsics, Options, Projection, Rig, annotations, image};
use nalgebra::Isometry3;
use proptest::prelude::*;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

fn repo(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(path)
}

fn good(path: &str) -> Vec<u8> {
    std::fs::read(repo(path)).unwrap()
}

/// A sentence, or a value.
fn answered<T, E: Display>(answer: Result<T, E>) -> Option<T> {
    match answer {
        Ok(value) => Some(value),
        Err(error) => {
            assert!(error.to_string().len() > 10, "{error}");
            None
        }
    }
}

/// As bundles have it.
const SCORER: &str = r#""pipeline_version": 2, "scorer": {"within_deg": 5.0, "within_m": 0.005,
 "refined": {"bias": 1.05, "view_bias": -2.5, "view": {"contour": 4.58, "detector": 1.5},
 "pose": {"expected_rotation": -1.83, "rig_deviation": -0.7}, "bound": 6.0, "correlation": 0.4},
 "unrefined": {"bias": -1.5, "view_bias": 0.0, "view": {}, "pose": {"prior": 1.0}, "bound": 4.0,
 "correlation": 0.0}}"#;

/// A copy of the fixture's bundle.
fn copy() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(repo("fixtures/tiny")).unwrap() {
        let from = entry.unwrap().path();
        if from.is_file() && from.extension().is_some_and(|end| end != "pt") {
            std::fs::copy(&from, folder.path().join(from.file_name().unwrap())).unwrap();
        }
    }
    folder
}

/// The fixture's bundle with a calibration.
fn calibrated(scorer: &str) -> tempfile::TempDir {
    let folder = copy();
    let manifest = String::from_utf8(good("fixtures/tiny/model.json")).unwrap();
    let manifest = manifest.replacen('{', &format!("{{{scorer}, "), 1);
    std::fs::write(folder.path().join("model.json"), manifest).unwrap();
    folder
}

/// Changes a graph of a bundle, whose manifest then has its checksum.
fn with_graph(folder: &Path, name: &str, edits: &[mutate::Edit]) {
    let bytes = changed(&good(&format!("fixtures/tiny/{name}")), edits);
    let path = folder.join("model.json");
    let mut manifest: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let sum = Sha256::digest(&bytes);
    let hex: String = sum.iter().map(|byte| format!("{byte:02x}")).collect();
    manifest["files"][name] = json!({"sha256": hex, "bytes": bytes.len()});
    std::fs::write(&path, manifest.to_string()).unwrap();
    std::fs::write(folder.join(name), bytes).unwrap();
}

#[test]
fn scorers_are_read_where_they_are_good() {
    let found = Bundle::load(calibrated(SCORER).path())
        .unwrap()
        .scorer
        .unwrap();
    assert_eq!(found.refined.view["contour"], 4.58);
    assert_eq!(found.unrefined.pose["prior"], 1.0);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: ProptestConfig::default().cases.div_ceil(8), ..ProptestConfig::default() })]

    /// What passes the check of the graph is loaded and run: ONNX Runtime answers or refuses it.
    #[test]
    fn graphs_that_are_run(edits in edits(), which in 0..2usize) {
        let folder = copy();
        with_graph(folder.path(), ["features.onnx", "decoder.onnx"][which], &edits);
        if let Some(estimator) = answered(Estimator::load(folder.path(), &Options::default())) {
            answered(estimator.self_test());
        }
    }
}

proptest! {
    #[test]
    fn rigs(edits in edits(), which in 0..2usize) {
        let file = ["examples/mvball/rig.json", "fixtures/six/rig.json"][which];
        let text = changed(&good(file), &edits);
        if let Some(rig) = answered(Rig::from_json(&String::from_utf8_lossy(&text))) {
            // What is read is written so that it is read again.
            prop_assert_eq!(Rig::from_json(&rig.to_json()).unwrap(), rig);
        }
    }

    #[test]
    fn boxes_and_true_poses(edits in edits()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.json");
        std::fs::write(&path, changed(&good("fixtures/six/truth.json"), &edits)).unwrap();
        answered(annotations::load_boxes(&path));
        for known in answered(annotations::load_truth(&path)).unwrap_or_default() {
            let rotation = known.world_from_obj.rotation;
            prop_assert!((rotation.norm() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn manifests_and_points(edits in edits(), which in 0..2usize) {
        let folder = copy();
        let name = ["model.json", "mvball.points.json"][which];
        let bytes = changed(&good(&format!("fixtures/tiny/{name}")), &edits);
        std::fs::write(folder.path().join(name), bytes).unwrap();
        if let Some(bundle) = answered(Bundle::load(folder.path())) {
            let classes = bundle.classes.iter();
            prop_assert!(classes.clone().all(|class| !class.points.is_empty()));
            prop_assert!(classes.clone().all(|class| class.diameter_m > 0.0));
        }
    }

    #[test]
    fn graphs(edits in edits(), which in 0..2usize) {
        let folder = copy();
        with_graph(folder.path(), ["features.onnx", "decoder.onnx"][which], &edits);
        answered(Bundle::load(folder.path()));
    }

    #[test]
    fn scorers(edits in edits()) {
        let scorer = String::from_utf8_lossy(&changed(SCORER.as_bytes(), &edits)).into_owned();
        let bundle = answered(Bundle::load(calibrated(&scorer).path()));
        if let Some(found) = bundle.and_then(|bundle| bundle.scorer) {
            // The odds of any evidence are a number.
            for weights in [&found.refined, &found.unrefined] {
                let all = weights.view.values().chain(weights.pose.values());
                let mut all = all.chain([&weights.bias, &weights.view_bias]);
                prop_assert!(all.all(|weight| weight.abs() < 1e9));
                prop_assert!(weights.bound > 0.0 && (0.0..=1.0).contains(&weights.correlation));
            }
            prop_assert!(found.within_deg > 0.0 && found.within_m > 0.0);
        }
    }

    #[test]
    fn images(edits in edits()) {
        let intrinsics = Intrinsics::new(90., 90., 79.5, 59.5, Projection::Pinhole).unwrap();
        let camera = Camera::new("cam0", [160, 120], intrinsics, Isometry3::identity()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cam0.png");
        std::fs::write(&path, changed(&good("fixtures/tiny/sample/cam0.png"), &edits)).unwrap();
        if let Some(image) = answered(image::load(&path, &camera)) {
            prop_assert_eq!(image.dimensions(), (160, 120));
        }
    }
}
