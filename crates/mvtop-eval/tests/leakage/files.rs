//! Annotations and models as they are read from files.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use mvtop_eval::bop::load_models;
use mvtop_eval::leakage::{Files, PoseRecord, Settings, Shape, leakage};
use nalgebra::{Matrix3, Vector3};
use tempfile::TempDir;

use super::{WITHIN_MM, pose, split};

fn write(path: &Path, bytes: impl AsRef<[u8]>) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

const QUARTER_TURN: &str = r#"{"3": [{"cam_R_m2c": [0,-1,0, 1,0,0, 0,0,1],
    "cam_t_m2c": [1.5, 2, 3], "obj_id": 4, "visib": {"of": [null]}}], "10": []}"#;

#[test]
fn split_scene_and_scene_of_sensors_are_read() {
    let folder = TempDir::new().unwrap();
    write(&folder.path().join("000002/scene_gt.json"), QUARTER_TURN);
    write(&folder.path().join("000002/scene_gt_info.json"), "not read");
    write(
        &folder.path().join("000007/scene_gt_cam1.json"),
        QUARTER_TURN,
    );
    write(
        &folder.path().join("000007/scene_gt_info_cam1.json"),
        "not read",
    );
    write(&folder.path().join("000009/scene_camera.json"), "not read");
    let files = Files::find(folder.path()).unwrap();
    assert_eq!(files.bytes, 2 * QUARTER_TURN.len() as u64);
    let split = files.read(|_| ()).unwrap();
    assert_eq!(split.scenes, ["000002", "000007/cam1"]);
    let expected = PoseRecord {
        scene: 0,
        image: 3,
        annotation: 0,
        rotation: Matrix3::new(0., -1., 0., 1., 0., 0., 0., 0., 1.),
        translation_mm: Vector3::new(1.5, 2., 3.),
    };
    let second = PoseRecord {
        scene: 1,
        ..expected
    };
    assert_eq!(split.objects, BTreeMap::from([(4, vec![expected, second])]));

    let scene = Files::find(&folder.path().join("000002")).unwrap();
    assert_eq!(scene.read(|_| ()).unwrap().objects[&4], [expected]);
    assert!(
        files
            .shared_with(&scene)
            .unwrap()
            .ends_with("000002/scene_gt.json")
    );
    let other = Files::find(&folder.path().join("000007")).unwrap();
    assert_eq!(scene.shared_with(&other), None);
}

#[test]
fn rotations_of_few_digits_are_made_exact() {
    let rounded = QUARTER_TURN.replace("0,-1,0, 1,0,0", "0.003,-0.998,0, 1.002,0.004,0.001");
    let folder = TempDir::new().unwrap();
    write(&folder.path().join("000000/scene_gt.json"), rounded);
    let files = Files::find(folder.path()).unwrap();
    let rotation = files.read(|_| ()).unwrap().objects[&4][0].rotation;
    let off = (rotation.transpose() * rotation - Matrix3::identity()).amax();
    assert!(off < 1e-13, "{off:e}");
    let exact = Matrix3::new(0., -1., 0., 1., 0., 0., 0., 0., 1.);
    assert!((rotation - exact).amax() < 5e-3, "{rotation}");
    // No other rotation is nearer: what was taken off is symmetric.
    let read = Matrix3::new(0.003, -0.998, 0., 1.002, 0.004, 0.001, 0., 0., 1.);
    let stretch = rotation.transpose() * read;
    assert!((stretch - stretch.transpose()).amax() < 1e-12, "{stretch}");
}

#[test]
fn what_is_no_annotation_is_refused_in_one_sentence() {
    let turned_in = QUARTER_TURN.replace("0,0,1]", "0,0,-1]");
    let cases = [
        ("{", "expected {IMAGE: ["),
        ("[]", "expected {IMAGE: ["),
        (r#"{"0": [{"obj_id": 1}]}"#, "cam_R_m2c"),
        (
            &QUARTER_TURN.replace("0,0,1]", "0,0]"),
            "expected {IMAGE: [",
        ),
        (
            &QUARTER_TURN.replace("0,-1,0,", "0,-2,0,"),
            "expected a rotation",
        ),
        (&turned_in, "image 3, row 0"),
        (&QUARTER_TURN.replace("1.5", "1e99"), "millimetres"),
    ];
    for (text, expected) in cases {
        let folder = TempDir::new().unwrap();
        write(&folder.path().join("000000/scene_gt.json"), text);
        let files = Files::find(folder.path()).unwrap();
        let error = files.read(|_| ()).unwrap_err().to_string();
        let named = error.contains("000000/scene_gt.json");
        assert!(
            named && error.contains(expected) && !error.contains('\n'),
            "{error}"
        );
    }
    let empty = TempDir::new().unwrap();
    let error = Files::find(empty.path()).unwrap_err().to_string();
    assert!(error.contains("expected a split"), "{error}");
    let error = Files::find(&empty.path().join("none"))
        .unwrap_err()
        .to_string();
    assert!(error.contains("cannot read"), "{error}");
}

const HEADER: &str = "element vertex 2\nproperty uchar red\nproperty float x\nproperty float y\n\
                      property double z\nelement face 1\nproperty list uchar int vertex_indices\n\
                      end_header\n";

#[test]
fn models_are_read_from_text_and_binary_meshes_alike() {
    let folder = TempDir::new().unwrap();
    let info = r#"{"1": {"diameter": 100, "size_x": 1}, "2": {"diameter": 100}}"#;
    write(&folder.path().join("models_info.json"), info);
    let text = format!("ply\nformat ascii 1.0\n{HEADER}255 0 0 0\n255 100 0 0\n3 0 1 1\n");
    write(&folder.path().join("obj_000001.ply"), text);
    let mut binary = format!("ply\nformat binary_little_endian 1.0\n{HEADER}").into_bytes();
    for x in [0f32, 100.] {
        binary.push(255);
        binary.extend(x.to_le_bytes());
        binary.extend(0f32.to_le_bytes());
        binary.extend(0f64.to_le_bytes());
    }
    binary.push(3);
    for vertex in [0i32, 1, 1] {
        binary.extend(vertex.to_le_bytes());
    }
    write(&folder.path().join("obj_000002.ply"), &binary);
    let models = load_models(folder.path(), |_| true).unwrap();
    let turned = pose([0.; 3], [0., 0., 90.]);
    for model in models.values() {
        let model = Shape::new(model).unwrap();
        assert_eq!(model.diameter_mm(), 100.);
        let add = model.add_mm(&pose([0.; 3], [0.; 3]), &turned, 1e3).unwrap();
        assert!((add - 50. * 2f64.sqrt()).abs() < 1e-9, "{add}");
    }

    binary.truncate(binary.len() - 1);
    let broken: [(&[u8], &str); 2] = [
        (&binary, "the end of the file"),
        (b"solid stl", "expected a PLY file"),
    ];
    for (bytes, expected) in broken {
        write(&folder.path().join("obj_000002.ply"), bytes);
        let error = load_models(folder.path(), |id| id == 2)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("obj_000002.ply") && error.contains(expected),
            "{error}"
        );
    }
    // What is not listed is not there, which the comparison says.
    let models = load_models(folder.path(), |id| id == 3).unwrap();
    let of = || split([(3, vec![pose([0.; 3], [0.; 3])])]);
    let settings = Settings {
        within_mm: WITHIN_MM,
        limit: 1.0,
        models: Some(&models),
    };
    let error = leakage(&of(), &of(), &settings).unwrap_err().to_string();
    assert!(error.contains("object 3"), "{error}");
}
