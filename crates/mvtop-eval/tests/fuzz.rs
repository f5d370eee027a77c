//! Readers of data sets answer any file with a value or a sentence, never with a panic: good files,
//! changed at random. `make fuzz` draws new ones for as long as one likes.

#[path = "../../mvtop-core/tests/fuzz/mutate.rs"]
mod mutate;

use mutate::{changed, edits};
use mvtop_eval::Result;
use mvtop_eval::bop::{load_frames, load_models, load_results, load_targets};
use proptest::prelude::*;

const TARGETS: &str = r#"[{"scene_id": 1, "im_id": 3, "obj_id": 5, "inst_count": 2},
 {"scene_id": 2, "im_id": 4, "obj_id": 6, "inst_count": 1}]"#;
const RESULTS: &str = "scene_id,im_id,obj_id,score,R,t,time
1,3,5,0.9,0 -1 0 1 0 0 0 0 1,10 20 900,0.25
2,4,cup,1,1 0 0 0 1 0 0 0 1,-10 0.5 1e3,-1
";
const CAMERAS: &str = r#"{"0": {"cam_K": [600, 0, 320, 0, 610, 240, 0, 0, 1], "depth_scale": 0.1,
 "cam_R_w2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_w2c": [-1000, 0, 0]}}"#;
const POSES: &str = r#"{"0": [{"obj_id": 5, "cam_R_m2c": [0, -1, 0, 1, 0, 0, 0, 0, 1],
 "cam_t_m2c": [10, 20, 900]}]}"#;
const INFO: &str = r#"{"0": [{"bbox_obj": [300, 200, 40, 50], "bbox_visib": [300, 200, 40, 50],
 "visib_fract": 0.9, "px_count_visib": 800}]}"#;
const INFOS: &str = r#"{"5": {"diameter": 14.2, "min_x": -5, "min_y": -5, "min_z": 0, "size_x": 10,
 "size_y": 10, "size_z": 1, "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}],
 "symmetries_discrete": [[-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]]}}"#;
const PLY: &str = "ply
format ascii 1.0
comment a square
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 2
property list uchar int vertex_indices
end_header
-5 -5 0 255 0 0
5 -5 0 0 255 0
5 5 1 0 0 255
-5 5 0 9 9 9
3 0 1 2
3 0 2 3
";

/// A sentence, or a value.
fn answered<T>(answer: Result<T>) -> Option<T> {
    match answer {
        Ok(value) => Some(value),
        Err(error) => {
            assert!(error.to_string().len() > 10, "{error}");
            None
        }
    }
}

/// A folder of files, the one at `which` changed.
fn folder(files: &[(&str, &str)], which: usize, edits: &[mutate::Edit]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (index, (name, text)) in files.iter().enumerate() {
        let bytes = match index == which {
            true => changed(text.as_bytes(), edits),
            false => text.as_bytes().to_vec(),
        };
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    folder
}

const SCENE: [(&str, &str); 3] = [
    ("scene_camera.json", CAMERAS),
    ("scene_gt.json", POSES),
    ("scene_gt_info.json", INFO),
];
const MODELS: [(&str, &str); 2] = [("models_info.json", INFOS), ("obj_000005.ply", PLY)];

/// A scene with its one image.
fn scene(which: usize, edits: &[mutate::Edit]) -> tempfile::TempDir {
    let scene = folder(&SCENE, which, edits);
    let image = scene.path().join("rgb/000000.png");
    std::fs::create_dir(scene.path().join("rgb")).unwrap();
    image::RgbImage::new(640, 480).save(image).unwrap();
    scene
}

#[test]
fn unchanged_files_are_read() {
    let read = |files: &[(&str, &str)]| folder(files, files.len(), &[]);
    let scene = scene(SCENE.len(), &[]);
    assert_eq!(load_frames(scene.path(), true).unwrap().0.len(), 1);
    assert_eq!(
        load_models(read(&MODELS).path(), |_| true).unwrap().len(),
        1
    );
    let results = read(&[("r.csv", RESULTS)]);
    let names = [("cup".to_owned(), 6)].into();
    let rows = load_results(&results.path().join("r.csv"), &names)
        .unwrap()
        .0;
    assert_eq!(rows.len(), 2);
    let targets = read(&[("t.json", TARGETS)]);
    assert_eq!(
        load_targets(&targets.path().join("t.json")).unwrap().len(),
        2
    );
}

proptest! {
    #[test]
    fn targets(edits in edits()) {
        let folder = folder(&[("t.json", TARGETS)], 0, &edits);
        answered(load_targets(&folder.path().join("t.json")));
    }

    #[test]
    fn results(edits in edits()) {
        let folder = folder(&[("r.csv", RESULTS)], 0, &edits);
        let names = [("cup".to_owned(), 6)].into();
        let read = answered(load_results(&folder.path().join("r.csv"), &names));
        for row in read.unwrap_or_default().0 {
            let r = nalgebra::Matrix3::from_row_slice(&row.estimate.r);
            prop_assert!((r * r.transpose() - nalgebra::Matrix3::identity()).norm() < 1e-9);
            prop_assert!(row.estimate.score.is_finite() && row.time_s.is_none_or(f64::is_finite));
        }
    }

    #[test]
    fn scenes(edits in edits(), which in 0..3usize) {
        answered(load_frames(scene(which, &edits).path(), true));
    }

    #[test]
    fn models(edits in edits(), which in 0..2usize) {
        let folder = folder(&MODELS, which, &edits);
        for model in answered(load_models(folder.path(), |_| true)).unwrap_or_default().values() {
            prop_assert!(model.diameter_m > 0.0);
        }
    }
}
