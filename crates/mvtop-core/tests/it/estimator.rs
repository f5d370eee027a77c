//! From files to poses, against PyTorch, and what must not change a pose.

use crate::fixtures::{Fixture, fixture_path, rigid, sample_boxes, sample_image, sample_rig};
use image::RgbImage;
use mvtop_core::annotations::GivenBoxes;
use mvtop_core::estimator::{Estimator, Options, PredictOptions, Tracker};
use mvtop_core::prediction::{Hypothesis, ObjectPose};
use mvtop_core::{BBox, Camera, Intrinsics, Rig, ViewImage};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rstest::rstest;
use std::sync::Arc;

fn estimator(bundle: &str) -> Estimator {
    Estimator::load(&fixture_path(bundle), &Options::default()).unwrap()
}

/// With the network's first poses alone, as `training/mvtop_train/export/reference.py` has them.
fn without_proposers(bundle: &str) -> Estimator {
    let options =
        Options::default().with_inference(vec![("search.schedule".into(), serde_json::json!([]))]);
    Estimator::load(&fixture_path(bundle), &options).unwrap()
}

#[test]
fn graphs_that_do_not_fit_the_bundle_are_refused_when_loaded() {
    // Each graph in the place of another: the decoder where the detector belongs, and so on.
    for (place, graph, part) in [
        (
            "features",
            "decoder.onnx",
            "input `memory`: expected one of images",
        ),
        ("closeup", "features.onnx", "`images`: expected"),
        (
            "decoder",
            "closeup.onnx",
            "input `images`: expected one of memory",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let bundle = fixture_path("tiny");
        for entry in std::fs::read_dir(&bundle).unwrap() {
            let path = entry.unwrap().path();
            if path.is_file() {
                std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
            }
        }
        let about = folder.path().join("model.json");
        let text = std::fs::read_to_string(&about).unwrap();
        let mut model: serde_json::Value = serde_json::from_str(&text).unwrap();
        model["graphs"][place] = graph.into();
        std::fs::write(&about, model.to_string()).unwrap();
        let error = Estimator::load(folder.path(), &Options::default())
            .err()
            .unwrap();
        let error = error.to_string();
        let says = error.contains(part) && error.contains("export the bundle again");
        assert!(says && error.contains(graph), "{error}");
    }
}

#[test]
fn what_a_graph_is_called_does_not_say_how_it_is_read() {
    // ONNX Runtime takes `.ort` for a format of its own, which no check of ONNX covers.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("features.ort");
    std::fs::copy(fixture_path("tiny").join("features.onnx"), &path).unwrap();
    let runtime = mvtop_core::onnx::Runtime::locate(None).unwrap();
    let session = runtime.session(&path, &Default::default()).unwrap();
    assert!(session.inputs().iter().any(|name| name == "images"));
}

/// The images of the given cameras of a rig.
fn load(rig: &Rig, cameras: &[usize]) -> Vec<ViewImage> {
    let load = |&camera: &usize| ViewImage {
        camera,
        image: sample_image(&rig.cameras()[camera]),
    };
    cameras.iter().map(load).collect()
}

/// The true boxes of the sample's object in the given cameras.
fn boxes(rig: &Rig, cameras: &[usize]) -> PredictOptions {
    let all = sample_boxes();
    let of = |&i: &usize| {
        let id = rig.cameras()[i].id();
        (id.to_owned(), all[id])
    };
    let given = GivenBoxes {
        class: "mvball".into(),
        boxes: cameras.iter().map(of).collect(),
    };
    PredictOptions::default().with_boxes(vec![given])
}

fn pose(estimator: &Estimator, rig: &Rig, given: &[usize], boxed: &[usize]) -> Isometry3<f64> {
    let prediction = estimator
        .predict(rig, &load(rig, given), &boxes(rig, boxed))
        .unwrap();
    assert_eq!(prediction.objects.len(), 1);
    prediction.objects[0].ref_from_obj
}

/// Largest difference of two poses' matrices: rotation entries, and translation in metres.
fn gap(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.to_homogeneous() - b.to_homogeneous()).amax()
}

/// One of the hypotheses is PyTorch's `world_from_obj.KEY`, with its `sigma.KEY`. Of several, which
/// may be equally probable, images choose.
fn assert_is_reference(bundle: &str, key: &str, object: &ObjectPose) {
    let kind = bundle.split('/').next().unwrap();
    let fixture = Fixture::load(&format!("pipeline_{kind}.safetensors"));
    let expected = rigid(fixture.f64(&format!("world_from_obj.{key}")).view());
    let away = |one: &&Hypothesis| gap(&one.world_from_obj, &expected);
    let hypotheses = object.hypotheses.iter();
    let ours = hypotheses
        .min_by(|a, b| away(a).total_cmp(&away(b)))
        .unwrap();
    // Float32 in the network: 6e-4 degrees and 1e-5 metres.
    assert!(away(&ours) < 1e-5, "{bundle}, {key}: {:.1e}", away(&ours));
    let sigma = fixture.f64(&format!("sigma.{key}"));
    let ratios = [ours.sigma.rot_deg / sigma[[0]], ours.sigma.t_m / sigma[[1]]];
    let near = ratios.iter().all(|ratio| (ratio - 1.0).abs() < 1e-4);
    assert!(near, "{bundle}, {key}: {ratios:?}");
}

#[rstest]
fn poses_from_files_match_pytorch(
    #[values("tiny", "tiny/portable")] bundle: &str,
    #[values(1, 2, 3, 4, 5, 6)] views: usize,
) {
    let rig = sample_rig();
    let cameras: Vec<usize> = (0..views).collect();
    let prediction = without_proposers(bundle)
        .predict(&rig, &load(&rig, &cameras), &boxes(&rig, &cameras))
        .unwrap();
    assert_is_reference(bundle, &views.to_string(), &prediction.objects[0]);
}

/// The object that most views have detected.
fn detected() -> ObjectPose {
    let rig = sample_rig();
    let prediction = without_proposers("tiny")
        .predict(&rig, &load(&rig, &[0, 1, 2, 3, 4, 5]), &Default::default())
        .unwrap();
    let views = |object: &ObjectPose| object.cameras.iter().filter(|c| c.bbox.is_some()).count();
    prediction.objects.into_iter().max_by_key(views).unwrap()
}

#[test]
fn boxes_from_images_alone_match_pytorch() {
    let expected = Fixture::load("pipeline_tiny.safetensors").f64("detected");
    for (view, camera) in detected().cameras.iter().enumerate() {
        let bbox: BBox = camera.bbox.expect("an object that all views see");
        for (side, ours) in <[f64; 4]>::from(bbox).into_iter().enumerate() {
            assert!((ours - expected[[view, side]]).abs() < 1e-3); // px
        }
    }
}

#[test]
fn poses_from_images_alone_match_pytorch() {
    assert_is_reference("tiny", "detected", &detected());
}

#[test]
fn another_world_frame_changes_no_pose_in_the_reference_frame() {
    let rig = sample_rig();
    let new_from_old = Isometry3::from_parts(
        Translation3::new(12.0, -7.0, 3.0),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.7, -1.9, 0.4)),
    );
    let moved = rig
        .moved(|_, camera| new_from_old * camera.world_from_cam())
        .unwrap();
    let estimator = estimator("tiny");
    let all = [0, 1, 2, 3];
    let gap = gap(
        &pose(&estimator, &rig, &all, &all),
        &pose(&estimator, &moved, &all, &all),
    );
    assert!(gap < 1e-5, "{gap:.1e}");
}

#[test]
fn the_order_of_the_other_cameras_changes_nothing() {
    let rig = sample_rig();
    let cameras = [2, 3, 0, 1].map(|i| rig.cameras()[i].clone());
    let shuffled = Rig::new(cameras.to_vec(), 2).unwrap();
    let estimator = estimator("tiny");
    let all = [0, 1, 2, 3];
    let expected = pose(&estimator, &rig, &all, &all);
    let gap = gap(&pose(&estimator, &shuffled, &all, &all), &expected);
    assert!(gap < 1e-5, "{gap:.1e}");
    // So does the order in which the images are given.
    let other_order = pose(&estimator, &rig, &[3, 1, 0, 2], &all);
    assert!(self::gap(&other_order, &expected) < 1e-5);
}

#[test]
fn a_view_that_does_not_see_the_object_changes_nothing() {
    let rig = sample_rig();
    let estimator = estimator("tiny");
    let expected = pose(&estimator, &rig, &[0, 1], &[0, 1]);
    let masked = pose(&estimator, &rig, &[0, 1, 2, 3], &[0, 1]);
    assert!(gap(&masked, &expected) < 1e-5);
    // A view that sees it does.
    let seen = pose(&estimator, &rig, &[0, 1, 2, 3], &[0, 1, 2]);
    assert!(gap(&seen, &expected) > 1e-4);
}

#[test]
fn an_object_that_the_reference_misses_is_posed_by_another_camera() {
    let rig = sample_rig();
    let estimator = estimator("tiny");
    let all = [0, 1, 2, 3];
    let ours = pose(&estimator, &rig, &all, &[1, 2]);
    let other = Rig::new(rig.cameras().to_vec(), 1).unwrap();
    let anchored = pose(&estimator, &other, &all, &[1, 2]);
    let ref_from_anchor =
        rig.cameras()[0].world_from_cam().inverse() * rig.cameras()[1].world_from_cam();
    assert!(gap(&ours, &(ref_from_anchor * anchored)) < 1e-9);
}

#[test]
fn poses_in_all_frames_agree() {
    let rig = sample_rig();
    let all = [0, 1, 2, 3];
    let prediction = estimator("tiny")
        .predict(&rig, &load(&rig, &all), &boxes(&rig, &all))
        .unwrap();
    let object = &prediction.objects[0];
    let reference = &rig.cameras()[prediction.reference];
    let in_world = reference.world_from_cam() * object.ref_from_obj;
    assert!(gap(&in_world, &object.world_from_obj) < 1e-12);
    for view in &object.cameras {
        let camera = &rig.cameras()[view.camera];
        assert!(
            gap(
                &(camera.world_from_cam() * view.cam_from_obj),
                &object.world_from_obj
            ) < 1e-12
        );
    }
}

#[test]
fn cameras_may_differ_in_resolution() {
    // The same camera with twice as many pixels sees the same; only resampling differs.
    let rig = sample_rig();
    let mut cameras = rig.cameras().to_vec();
    let small = &cameras[1];
    let of = small.intrinsics();
    let [fx, fy] = [of.fx(), of.fy()].map(|f| f * 2.0);
    let [cx, cy] = [of.cx(), of.cy()].map(|c| c * 2.0 + 0.5);
    let large = Intrinsics::new(fx, fy, cx, cy, of.projection().clone()).unwrap();
    let size = [small.width() * 2, small.height() * 2];
    cameras[1] = Camera::new(small.id(), size, large, *small.world_from_cam()).unwrap();
    let mixed = Rig::new(cameras, rig.reference()).unwrap();
    let mut given = load(&rig, &[0, 1]);
    let small = &given[1].image;
    given[1].image = RgbImage::from_fn(small.width() * 2, small.height() * 2, |x, y| {
        *small.get_pixel(x / 2, y / 2)
    });
    let mut options = boxes(&rig, &[0, 1]);
    let given_boxes = &mut options.boxes.as_mut().unwrap()[0].boxes;
    let enlarged = <[f64; 4]>::from(given_boxes["cam1"]).map(|x| (x + 0.5) * 2.0 - 0.5);
    given_boxes.insert("cam1".into(), enlarged.into());
    let estimator = estimator("tiny");
    let expected = pose(&estimator, &rig, &[0, 1], &[0, 1]);
    let mixed = estimator.predict(&mixed, &given, &options).unwrap().objects[0].ref_from_obj;
    assert!(gap(&mixed, &expected) < 0.03, "{}", gap(&mixed, &expected));
}

#[test]
fn a_tracker_predicts_what_a_cold_run_does() {
    let rig = sample_rig();
    let estimator = Arc::new(estimator("tiny"));
    let mut tracker = Tracker::new(estimator.clone(), Arc::new(rig.clone()));
    let mut images = load(&rig, &[0, 1, 2, 3]);
    let mut flipped = images[2].clone();
    image::imageops::flip_horizontal_in_place(&mut flipped.image);
    let same = |tracker: &mut Tracker, images: &[ViewImage]| {
        let cameras: Vec<usize> = images.iter().map(|view| view.camera).collect();
        assert_eq!(tracker.cameras().collect::<Vec<_>>(), cameras);
        let options = boxes(&rig, &cameras);
        let warm = tracker.predict(&options).unwrap().objects;
        let cold = estimator.predict(&rig, images, &options).unwrap().objects;
        assert_eq!((warm.len(), cold.len()), (1, 1));
        assert!(gap(&warm[0].world_from_obj, &cold[0].world_from_obj) < 1e-6);
        assert!((warm[0].sigma.rot_deg / cold[0].sigma.rot_deg - 1.0).abs() < 1e-5);
        warm[0].world_from_obj
    };
    tracker
        .update(vec![images[1].clone(), images[0].clone()])
        .unwrap();
    same(&mut tracker, &images[..2]);
    tracker.update(images[2..].to_vec()).unwrap();
    let before = same(&mut tracker, &images);
    images[2] = flipped;
    tracker.update(vec![images[2].clone()]).unwrap();
    let after = same(&mut tracker, &images);
    assert!(gap(&before, &after) > 1e-4, "the new image changed nothing");
    tracker.remove(0);
    same(&mut tracker, &images[1..]);

    // What does not fit changes nothing.
    let small = ViewImage {
        camera: 0,
        image: RgbImage::new(8, 8),
    };
    let refused = tracker.update(vec![images[0].clone(), small]);
    assert!(refused.is_err());
    same(&mut tracker, &images[1..]);
}
