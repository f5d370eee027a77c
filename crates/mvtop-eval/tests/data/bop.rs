//! Data sets in BOP's layout, written by the tests.

use mvtop_eval::bop::{FrameId, Scene, load_depth, load_models, scene_ids};
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const R: [i32; 9] = [0, -1, 0, 1, 0, 0, 0, 0, 1];

pub fn write(path: &Path, content: &Value) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, content.to_string()).unwrap();
}

/// Images 0 to `count` - 1 of a sensor, each camera `image` metres along the world's x axis.
pub fn write_sensor(scene: &Path, sensor: &str, kind: &str, count: i32) {
    let end = if sensor.is_empty() {
        String::new()
    } else {
        format!("_{sensor}")
    };
    let (mut camera, mut gt, mut info) = (json!({}), json!({}), json!({}));
    fs::create_dir_all(scene.join(format!("{kind}{end}"))).unwrap();
    for image in 0..count {
        let key = image.to_string();
        camera[&key] = json!({
            "cam_K": [600, 0, 320, 0, 610, 240, 0, 0, 1], "depth_scale": 0.1,
            "cam_R_w2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_w2c": [-1000 * image, 0, 0],
        });
        gt[&key] = json!([
            {"obj_id": 5, "cam_R_m2c": R, "cam_t_m2c": [10, 20, 900]},
            {"obj_id": 7, "cam_R_m2c": R, "cam_t_m2c": [0, 0, 800]},
        ]);
        info[&key] = json!([
            {"bbox_obj": [100, 110, 40, 50], "visib_fract": 0.5},
            {"bbox_obj": [-1, -1, -1, -1], "visib_fract": 0.0},
        ]);
        fs::write(scene.join(format!("{kind}{end}/{image:06}.png")), "").unwrap();
    }
    write(&scene.join(format!("scene_camera{end}.json")), &camera);
    write(&scene.join(format!("scene_gt{end}.json")), &gt);
    write(&scene.join(format!("scene_gt_info{end}.json")), &info);
}

pub fn id(sensor: &str, image: u32) -> FrameId {
    FrameId {
        sensor: sensor.into(),
        image,
    }
}

#[test]
fn scene_is_read_in_metres() {
    let dir = TempDir::new().unwrap();
    write_sensor(&dir.path().join("000012"), "", "rgb", 3);
    fs::create_dir(dir.path().join("notes")).unwrap();
    assert_eq!(scene_ids(dir.path()).unwrap(), [12]);
    let scene = Scene::load(dir.path(), 12).unwrap();
    assert_eq!(scene.frames.len(), 3);
    let view = &scene.frames[&id("", 2)];
    assert!(view.path.ends_with("rgb/000002.png"));
    assert_eq!((view.intrinsics.fx(), view.intrinsics.fy()), (600.0, 610.0));
    assert_eq!((view.intrinsics.cx(), view.intrinsics.cy()), (320.0, 240.0));
    assert_eq!(view.depth_scale, 0.1);
    let center = view.world_from_cam.unwrap() * Point3::origin();
    assert!((center - Point3::new(2.0, 0.0, 0.0)).norm() < 1e-9);
    let [first, second] = &view.objects[..] else {
        panic!()
    };
    assert_eq!(first.object, 5);
    assert_eq!(first.bbox, Some([100.0, 110.0, 140.0, 160.0].into()));
    assert_eq!(first.visible, Some(0.5));
    assert!((first.cam_from_obj.translation.vector - Vector3::new(0.01, 0.02, 0.9)).norm() < 1e-12);
    let x = first.cam_from_obj.rotation * Vector3::x();
    assert!((x - Vector3::y()).norm() < 1e-9);
    assert_eq!(second.bbox, None);
}

#[test]
fn depth_images_are_read_in_metres() {
    let dir = TempDir::new().unwrap();
    let scene = dir.path().join("000001");
    write_sensor(&scene, "", "rgb", 3);
    fs::create_dir(scene.join("depth")).unwrap();
    // 9000 units of 0.1 mm.
    let deep = image::ImageBuffer::from_fn(3, 2, |x, _| image::Luma([9000 * x as u16]));
    deep.save(scene.join("depth/000000.png")).unwrap();
    deep.save(scene.join("depth/000002.tif")).unwrap();
    let views = Scene::load(dir.path(), 1).unwrap().frames;
    for image in [0, 2] {
        let depth = load_depth(&views[&id("", image)]).unwrap().unwrap();
        assert_eq!(depth, ndarray::arr2(&[[0.0, 0.9, 1.8], [0.0, 0.9, 1.8]]));
    }
    assert_eq!(load_depth(&views[&id("", 1)]).unwrap(), None);
    let shallow = image::GrayImage::new(3, 2);
    shallow.save(scene.join("depth/000000.png")).unwrap();
    let error = load_depth(&views[&id("", 0)]).unwrap_err().to_string();
    assert!(
        error.contains("000000.png: expected PNG or TIFF with 16 bits of grey, got: L8"),
        "{error}"
    );
}

#[test]
fn scenes_that_are_not_bops_are_refused_in_one_sentence() {
    let refused = |key: &str, value: Value, hint: &str| {
        let dir = TempDir::new().unwrap();
        let folder = dir.path().join("000001");
        write_sensor(&folder, "", "rgb", 1);
        let file = folder.join("scene_camera.json");
        let mut camera: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
        camera["0"][key] = value;
        write(&file, &camera);
        let error = Scene::load(dir.path(), 1).unwrap_err().to_string();
        assert!(error.contains("scene_camera.json"), "{error}");
        assert!(error.contains(hint) && !error.contains('\n'), "{error}");
    };
    refused("cam_K", json!([600, 0, 320]), "cam_K");
    let transposed = json!([600, 0, 0, 0, 610, 0, 320, 240, 1]);
    refused("cam_K", transposed, "[fx, skew, cx");
    let askew = json!([600, 120, 320, 0, 610, 240, 0, 0, 1]);
    refused("cam_K", askew, "`skew`");
    refused("cam_K", Value::Null, "cam_model");
    refused("cam_model", json!({}), "cam_model");
    refused("cam_t_w2c", Value::Null, "both cam_R_w2c and cam_t_w2c");
    refused("cam_R_w2c", json!([2, 0, 0, 0, 2, 0, 0, 0, 2]), "cam_R_w2c");
    let dir = TempDir::new().unwrap();
    let error = scene_ids(dir.path()).unwrap_err().to_string();
    assert!(error.contains("--split"), "{error}");
    fs::create_dir(dir.path().join("000001")).unwrap();
    write(&dir.path().join("000001/scene_camera.json"), &json!({}));
    let error = Scene::load(dir.path(), 1).unwrap_err().to_string();
    assert!(error.contains("rgb/ or gray/"), "{error}");
}

#[test]
fn poses_of_few_digits_are_read_and_others_named() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("000001");
    write_sensor(&folder, "", "rgb", 1);
    let load = |rotation: [f64; 9]| {
        let pose = json!({"obj_id": 5, "cam_R_m2c": rotation, "cam_t_m2c": [10, 20, 900]});
        write(&folder.join("scene_gt.json"), &json!({"0": [pose]}));
        Scene::load(dir.path(), 1)
    };
    let scene = load([0.002, -0.997, 0., 1., 0., 0., 0., 0., 1.]).unwrap();
    let pose = scene.frames[&id("", 0)].objects[0].cam_from_obj;
    assert!((pose.rotation * Vector3::x() - Vector3::y()).norm() < 5e-3);
    let error = load([0., -1.2, 0., 1., 0., 0., 0., 0., 1.]).unwrap_err();
    let named = "scene_gt.json: image 0, row 0: cam_R_m2c: expected a rotation";
    assert!(error.to_string().contains(named), "{error}");
}

#[test]
fn rotations_that_are_off_are_made_exact_and_told_of() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("000001");
    write_sensor(&folder, "", "rgb", 1);
    let poses = |scales: &[f64]| {
        let pose = |scale: &f64| {
            let rotation = R.map(|entry| f64::from(entry) * scale);
            json!({"obj_id": 5, "cam_R_m2c": rotation, "cam_t_m2c": [10, 20, 900]})
        };
        let poses: Vec<Value> = scales.iter().map(pose).collect();
        write(&folder.join("scene_gt.json"), &json!({"0": poses}));
        Scene::load(dir.path(), 1)
    };
    // Scaled by s, each entry of RᵀR - 1 on the diagonal is s² - 1.
    let scene = poses(&[1.0, 1.0004, 1.009, 0.995]).unwrap();
    for object in &scene.frames[&id("", 0)].objects {
        let x = object.cam_from_obj.rotation * Vector3::x();
        assert!((x - Vector3::y()).norm() < 1e-14, "{x}");
    }
    let inexact = &scene.doubts.inexact;
    assert_eq!((inexact.of, inexact.count), (4, 2));
    assert!((inexact.greatest - (1.009f64.powi(2) - 1.0)).abs() < 1e-12);
    let [sentence] = &scene.doubts.sentences()[..] else {
        panic!()
    };
    assert!(
        sentence.starts_with("2 of 4 rotations of the ground truth"),
        "{sentence}"
    );
    assert!(sentence.contains("1.8e-2") && sentence.contains("scene_gt.json: image 0, row 2"));
    let error = poses(&[1.0, 1.011]).unwrap_err().to_string();
    assert!(
        error.contains("scene_gt.json: image 0, row 1: cam_R_m2c"),
        "{error}"
    );
    assert_eq!(poses(&[1.0, 1.0004]).unwrap().doubts.sentences(), [""; 0]);
}

/// Changes each entry of scene_camera.json.
fn change_cameras(scene: &Path, change: impl Fn(&mut Value)) {
    let file = scene.join("scene_camera.json");
    let mut cameras: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    cameras
        .as_object_mut()
        .unwrap()
        .values_mut()
        .for_each(change);
    write(&file, &cameras);
}

#[test]
fn camera_poses_may_have_the_shorter_names() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("000001");
    write_sensor(&folder, "", "rgb", 3);
    let expected = Scene::load(dir.path(), 1).unwrap();
    change_cameras(&folder, |camera| {
        let camera = camera.as_object_mut().unwrap();
        for (short, long) in [("R_w2c", "cam_R_w2c"), ("t_w2c", "cam_t_w2c")] {
            let value = camera.remove(long).unwrap();
            camera.insert(short.into(), value);
        }
    });
    let scene = Scene::load(dir.path(), 1).unwrap();
    for (a, b) in scene.frames.values().zip(expected.frames.values()) {
        assert!(a.world_from_cam.is_some());
        assert_eq!(a.world_from_cam, b.world_from_cam);
    }
}

#[test]
fn cameras_in_metres_and_missing_images_are_told_of() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("000001");
    write_sensor(&folder, "", "rgb", 3);
    assert_eq!(
        Scene::load(dir.path(), 1).unwrap().doubts.sentences(),
        [""; 0]
    );
    change_cameras(&folder, |camera| {
        let x = camera["cam_t_w2c"][0].as_f64().unwrap();
        camera["cam_t_w2c"][0] = json!(x * 1e-3);
    });
    fs::remove_file(folder.join("rgb/000001.png")).unwrap();
    let doubts = Scene::load(dir.path(), 1).unwrap().doubts;
    let [missing, metres] = &doubts.sentences()[..] else {
        panic!("{doubts:?}")
    };
    assert!(
        missing.starts_with("1 images") && missing.contains("rgb/000001"),
        "{missing}"
    );
    assert!(metres.contains("looks like metres in 1 scenes"), "{metres}");
    // A camera that is the world stands nowhere else.
    change_cameras(&folder, |camera| camera["cam_t_w2c"] = json!([0, 0, 0]));
    assert!(
        Scene::load(dir.path(), 1)
            .unwrap()
            .doubts
            .in_metres
            .is_empty()
    );
}

#[test]
fn models_come_with_their_symmetries() {
    let dir = TempDir::new().unwrap();
    let info = json!({
        "1": {"diameter": 100.0, "name": "box", "symmetries_discrete":
            [[-1, 0, 0, 20, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]]},
        "2": {"diameter": 50.0, "symmetries_continuous":
            [{"axis": [0, 0, 2], "offset": [0, 0, 0]}]},
        "3": {"diameter": 70.0},
    });
    write(&dir.path().join("models/models_info.json"), &info);
    for object in [1, 2] {
        let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                   property float z\nelement face 1\nproperty list uchar int vertex_indices\n\
                   end_header\n0 0 0\n100 0 0\n0 50 0\n3 0 1 2\n";
        fs::write(dir.path().join(format!("models/obj_{object:06}.ply")), ply).unwrap();
    }
    let models = load_models(dir.path(), |object| object < 3).unwrap();
    assert_eq!(models[&1].name.as_deref(), Some("box"));
    assert_eq!(models[&1].diameter_m, 0.1);
    assert_eq!(models[&1].mesh.vertices()[1], Point3::new(0.1, 0.0, 0.0));
    let [_, half_turn] = models[&1].symmetries.motions() else {
        panic!()
    };
    assert!((half_turn * Point3::origin() - Point3::new(0.02, 0.0, 0.0)).norm() < 1e-9);
    assert_eq!(models[&1].symmetry.discrete, [*half_turn]);
    assert_eq!(models[&2].symmetries.motions().len(), 315);
    let axis = models[&2].symmetry.axis.unwrap();
    assert_eq!((axis.direction.z, axis.point), (1.0, Point3::origin()));
    let error = load_models(dir.path(), |_| true).unwrap_err().to_string();
    assert!(error.contains("obj_000003.ply"), "{error}");
    let obj = "v 0 0 0\nv 70 0 0\nv 0 40 0\nf 1 2 3\n";
    fs::write(dir.path().join("models/obj_000003.obj"), obj).unwrap();
    let models = load_models(dir.path(), |_| true).unwrap();
    assert!(models[&3].path.ends_with("models/obj_000003.obj"));
    assert_eq!(models[&3].mesh.vertices()[1], Point3::new(0.07, 0.0, 0.0));
    let error = load_models(Path::new("nowhere"), |_| true)
        .unwrap_err()
        .to_string();
    assert!(error.contains("models_eval/ or models/"), "{error}");
}
