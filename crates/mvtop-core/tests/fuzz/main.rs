//! Readers answer any file with a value or a sentence, never with a panic: real files, changed at
//! random. `make fuzz` draws new ones for as long as one likes.

mod answers;
mod mutate;

use std::path::{Path, PathBuf};

use mutate::{changed, edits};
use mvtop_core::bundle::Bundle;
use mvtop_core::{Camera, Intrinsics, Projection, Rig, annotations, image};
use nalgebra::Isometry3;
use proptest::prelude::*;

fn repo(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(path)
}

fn good(path: &str) -> Vec<u8> {
    std::fs::read(repo(path)).unwrap()
}

/// A sentence, or a value.
fn answered<T>(answer: mvtop_core::Result<T>) -> Option<T> {
    match answer {
        Ok(value) => Some(value),
        Err(error) => {
            assert!(error.to_string().len() > 10, "{error}");
            None
        }
    }
}

/// As bundles have it.
const CONFIDENCE: &str = r#""confidence": {"within_deg": 5.0, "within_m": 0.005, "bias": 6.05,
 "weights": {"deviation": -1.17, "expected_rotation": -1.83, "views": 2.07, "overlap": 4.58},
 "one_view": {"bias": -1.5, "weights": {"supported": 2.0}, "squares": {"supported": -0.5},
 "limits": {"supported": [0.1, 0.95]}}}"#;

/// A copy of the fixture's bundle.
fn whole() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(repo("fixtures/whole")).unwrap() {
        let from = entry.unwrap().path();
        if from.is_file() && from.extension().is_some_and(|end| end != "pt") {
            std::fs::copy(&from, folder.path().join(from.file_name().unwrap())).unwrap();
        }
    }
    folder
}

#[test]
fn confidences_are_read_where_they_are_good() {
    let folder = whole();
    let manifest = String::from_utf8(good("fixtures/whole/model.json")).unwrap();
    let manifest = manifest.replacen('{', &format!("{{{CONFIDENCE}, "), 1);
    std::fs::write(folder.path().join("model.json"), manifest).unwrap();
    let bundle = Bundle::load(folder.path()).unwrap();
    let found = bundle.confidence.unwrap();
    assert_eq!(found.odds.weights.len(), 4);
    assert_eq!(found.one_view.unwrap().limits["supported"], [0.1, 0.95]);
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
        let folder = whole();
        let name = ["model.json", "mvball.points.json"][which];
        let bytes = changed(&good(&format!("fixtures/whole/{name}")), &edits);
        std::fs::write(folder.path().join(name), bytes).unwrap();
        if let Some(bundle) = answered(Bundle::load(folder.path())) {
            let classes = bundle.classes.iter();
            prop_assert!(classes.clone().all(|class| !class.points.is_empty()));
            prop_assert!(classes.clone().all(|class| class.diameter_m > 0.0));
        }
    }

    #[test]
    fn confidences(edits in edits()) {
        let folder = whole();
        let weights = String::from_utf8_lossy(&changed(CONFIDENCE.as_bytes(), &edits)).into_owned();
        let manifest = String::from_utf8(good("fixtures/whole/model.json")).unwrap();
        let manifest = manifest.replacen('{', &format!("{{{weights}, "), 1);
        std::fs::write(folder.path().join("model.json"), manifest).unwrap();
        if let Some(found) = answered(Bundle::load(folder.path())).and_then(|b| b.confidence) {
            // The odds of any evidence are a number.
            for odds in [Some(&found.odds), found.one_view.as_ref()].into_iter().flatten() {
                let weights = odds.weights.values().chain(odds.squares.values());
                prop_assert!(weights.chain([&odds.bias]).all(|weight| weight.abs() < 1e9));
                prop_assert!(odds.limits.values().all(|[least, most]| least <= most));
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
