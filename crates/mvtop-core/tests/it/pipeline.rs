//! Every step of the pipeline against what PyTorch makes of the same images
//! (`training/mvtop_train/export/fixtures/pipeline.py`); the poses: `estimator.rs`.

use crate::fixtures::{Fixture, fixture_path, gap, sample_boxes, sample_image, sample_rig};
use mvtop_core::closeup::CloseUp;
use mvtop_core::image::{Letterbox, Pyramid, to_tensor};
use mvtop_core::onnx::{Runtime, Session, SessionOptions, Tensor};
use mvtop_core::rays::{BoxRays, LosEncoding, encode};
use mvtop_core::{BBox, Camera, Rig};
use ndarray::{Array1, Array2, Array3, Array4, ArrayD, Axis, Ix3, stack};
use rstest::rstest;

/// Of `fixtures/tiny`.
const INPUT: [u32; 2] = [160, 128];
const MEAN: [f32; 3] = [0.5; 3];
const STD: [f32; 3] = [0.25; 3];
const ENCODING: LosEncoding = LosEncoding::PluckerOrigin;

fn fixture() -> Fixture {
    Fixture::load("pipeline_tiny.safetensors")
}

fn session(bundle: &str, graph: &str) -> Session {
    let path = fixture_path(bundle).join(graph);
    Runtime::locate(None)
        .unwrap()
        .session(&path, &SessionOptions::default())
        .unwrap()
}

fn letterbox(camera: &Camera) -> Letterbox {
    Letterbox::new(camera.width(), camera.height(), INPUT[0], INPUT[1])
}

/// The images of all cameras as the network takes them.
fn images(rig: &Rig) -> Array4<f32> {
    let tensor = |camera| to_tensor(&sample_image(camera), &letterbox(camera), MEAN, STD).unwrap();
    let tensors: Vec<Array3<f32>> = rig.cameras().iter().map(tensor).collect();
    let views: Vec<_> = tensors.iter().map(|tensor| tensor.view()).collect();
    stack(Axis(0), &views).unwrap()
}

/// What poses are decoded from, of one camera.
struct Shown {
    camera: Camera,
    bbox: BBox,
    camera_rays: Array2<f32>,
    picture: Array3<f32>,
}

impl Shown {
    fn of(real: &Camera) -> Self {
        let bbox = sample_boxes()[real.id()];
        let closeup = CloseUp::new(real, bbox, 64).unwrap();
        Self {
            bbox: closeup.bbox,
            camera_rays: closeup.camera_rays(real, &[16, 32]),
            picture: closeup.picture(real, &Pyramid::new(&sample_image(real)), MEAN, STD),
            camera: closeup.camera,
        }
    }
}

#[test]
fn pictures_and_lines_of_sight() {
    let fixture = fixture();
    let rig = sample_rig();
    let first = images(&rig).mapv(f64::from).index_axis_move(Axis(0), 0);
    let theirs = fixture.f64("images").index_axis_move(Axis(0), 0);
    assert!(gap(first.into_dyn(), theirs) < 1e-6);
    let shown: Vec<Shown> = rig.cameras().iter().map(Shown::of).collect();
    for (view, ours) in shown.iter().enumerate() {
        let close = |ours: ArrayD<f32>, name: &str| {
            let theirs = fixture.f64(name).index_axis_move(Axis(0), view);
            let gap = gap(ours.mapv(f64::from), theirs);
            assert!(gap < 2e-6, "view {view}, {name}: {gap:.1e}"); // float32
        };
        close(ours.picture.clone().into_dyn(), "pictures");
        close(ours.camera_rays.clone().into_dyn(), "camera_rays");
        for (a, anchor) in shown.iter().enumerate() {
            let anchor_from_world = anchor.camera.world_from_cam().inverse();
            let anchor_from_cam = anchor_from_world * ours.camera.world_from_cam();
            let lines = encode(ours.camera_rays.view(), &anchor_from_cam, ENCODING);
            close(lines.into_dyn(), &format!("rays.{a}"));
            let box_rays = BoxRays::new(&ours.camera, ours.bbox).unwrap();
            let numbers = box_rays.encode(&anchor_from_cam);
            let numbers = Array2::from_shape_vec((1, 12), numbers.to_vec()).unwrap();
            close(numbers.into_dyn(), &format!("box_rays.{a}"));
        }
    }
}

#[rstest]
fn features_are_pytorch_s(#[values("tiny", "tiny/portable")] bundle: &str) {
    let fixture = fixture();
    let close = |ours: ArrayD<f32>, name: &str, tolerance: f64| {
        let gap = gap(ours.mapv(f64::from), fixture.f64(name));
        assert!(gap < tolerance, "{bundle}, {name}: {gap:.1e}");
    };
    let (images, camera_rays) = (images(&sample_rig()), fixture.f32("camera_rays"));
    let detector = session(bundle, "features.onnx");
    let mut out = detector.run(&[("images", images.view().into())]).unwrap();
    // Sums of some hundred float32 products in another order.
    let scores: Array4<f32> = out.take("det_scores").unwrap();
    close(scores.into_dyn(), "det_scores", 1e-5);
    let boxes: Array4<f32> = out.take("det_boxes").unwrap();
    close(boxes.into_dyn(), "det_boxes", 1e-3); // pixels
    let pictures = fixture.f32("pictures");
    let mut out = session(bundle, "closeup.onnx")
        .run(&[
            ("images", pictures.view().into()),
            ("camera_rays", camera_rays.view().into()),
        ])
        .unwrap();
    let memory = out.take::<Ix3>("memory").unwrap();
    close(memory.into_dyn(), "memory", 2e-5);
}

#[rstest]
fn every_view_decodes_what_it_does_in_pytorch(#[values("tiny", "tiny/portable")] bundle: &str) {
    let fixture = fixture();
    let session = session(bundle, "decoder.onnx");
    let class_index = Array1::<i64>::zeros(1);
    let anchors = |views: usize| {
        let anchors = fixture.f64(&format!("anchors.{views}"));
        anchors.mapv(|anchor| (views, anchor as usize))
    };
    for (views, anchor) in (1..=6).flat_map(anchors) {
        let mut order: Vec<usize> = (0..views).collect();
        order.sort_by_key(|&view| view != anchor);
        let in_order = |name: &str| fixture.f32(name).select(Axis(0), &order);
        let names = ["memory", "rays", "centers", "half_sizes", "box_rays"];
        let arrays = names.map(|name| match name {
            "rays" | "box_rays" => in_order(&format!("{name}.{anchor}")),
            _ => in_order(name),
        });
        let valid = Array2::<f32>::ones((views, 1));
        let mut inputs: Vec<(&str, Tensor)> = names
            .iter()
            .zip(&arrays)
            .map(|(&name, x)| (name, x.view().into()))
            .collect();
        inputs.push(("valid", valid.view().into()));
        inputs.push(("class_index", class_index.view().into()));
        let mut out = session.run(&inputs).unwrap();
        let tolerances = [
            ("rotation_6d", 1e-4),
            ("translation", 1e-5),
            ("sigma", 1e-3), // degrees
        ];
        for (name, tolerance) in tolerances {
            let ours: Array2<f32> = out.take(name).unwrap();
            let theirs = fixture.f64(&format!("{name}.{views}.{anchor}"));
            let gap = gap(ours.mapv(f64::from).into_dyn(), theirs);
            assert!(
                gap < tolerance,
                "{views} views, anchor {anchor}, {name}: {gap:.1e}"
            );
        }
    }
}

#[test]
fn fixtures_hold_numbers_that_differ() {
    // A parity test on constant outputs would pass for any network.
    let fixture = fixture();
    let world_from_obj = |views: usize| fixture.f64(&format!("world_from_obj.{views}"));
    assert!(gap(world_from_obj(1), world_from_obj(4)) > 1e-2);
    assert!(gap(world_from_obj(4), world_from_obj(6)) > 1e-3);
    let rotation = |anchor: f64| fixture.f64(&format!("rotation_6d.6.{anchor}"));
    let anchors = fixture.f64("anchors.6");
    assert!(gap(rotation(anchors[[0]]), rotation(anchors[[1]])) > 1e-2);
}
