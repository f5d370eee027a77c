//! Every stage against the fixture that the PyTorch side wrote
//! (`training/mvtop_train/export/fixtures/stages.py`).

use crate::fixtures::{Fixture, fixture_path, rigid, sample_rig};
use mvtop_core::bundle::{Bundle, PoseInput};
use mvtop_core::image::{self, Letterbox};
use mvtop_core::onnx::{Runtime, Session, SessionOptions, Tensor};
use mvtop_core::rays::{self, BoxRays, LosEncoding};
use mvtop_core::sampling::{Dims, Gradients, LevelShapes, Sampling, deformable_sampling};
use mvtop_core::{Intrinsics, Projection, pose};
use nalgebra::{Point2, UnitQuaternion};
use ndarray::{Array1, Array2, Array3, Array4, ArrayD, Axis, Ix2, Ix3, Ix4, s};
use rstest::rstest;

/// Largest absolute difference of two arrays of one shape.
fn gap(a: ArrayD<f64>, b: ArrayD<f64>) -> f64 {
    assert_eq!(a.shape(), b.shape());
    (a - b).iter().fold(0.0, |m, x| m.max(x.abs()))
}

#[test]
fn sampling_and_its_gradients() {
    let fixture = Fixture::load("sampling.safetensors");
    let value = fixture.f32("value").into_dimensionality::<Ix4>().unwrap();
    let locations = fixture.f32("locations");
    let weights = fixture.f32("weights");
    let shapes: Vec<_> = fixture
        .f64("level_shapes")
        .axis_iter(Axis(0))
        .map(|row| (row[0] as usize, row[1] as usize))
        .collect();
    let out = deformable_sampling(
        value.view(),
        locations.view().into_dimensionality().unwrap(),
        weights.view().into_dimensionality().unwrap(),
        &shapes,
    )
    .unwrap();
    // The kernel adds float32 numbers of order 1; the fixture is in float64.
    let close = |ours: ArrayD<f32>, name: &str, tolerance: f64| {
        let gap = gap(ours.mapv(f64::from), fixture.f64(name));
        assert!(gap < tolerance, "{name}: {gap:.1e}");
    };
    close(out.into_dyn(), "out", 1e-5);

    let levels = LevelShapes::new(&shapes).unwrap();
    let (batch, _, heads, head_dim) = value.dim();
    let dims = Dims {
        batch,
        heads,
        head_dim,
        queries: locations.shape()[1],
        points: 4,
    };
    let sampling = Sampling::new(
        &levels,
        dims,
        value.as_slice().unwrap(),
        locations.as_slice().unwrap(),
        weights.as_slice().unwrap(),
    )
    .unwrap();
    let mut grads = [&value.clone().into_dyn(), &locations, &weights].map(|x| x.clone());
    let [grad_value, grad_locations, grad_weights] = &mut grads;
    let gradients = Gradients {
        value: grad_value.as_slice_mut().unwrap(),
        locations: grad_locations.as_slice_mut().unwrap(),
        weights: grad_weights.as_slice_mut().unwrap(),
    };
    let grad_out = fixture.f32("grad_out");
    sampling
        .backward(grad_out.as_slice().unwrap(), gradients)
        .unwrap();
    let [grad_value, grad_locations, grad_weights] = grads;
    close(grad_value, "grad_value", 1e-5);
    close(grad_locations, "grad_locations", 1e-4); // slopes times the level's size in cells
    close(grad_weights, "grad_weights", 1e-5);
}

#[test]
fn rays_in_all_encodings_and_of_boxes() {
    let fixture = Fixture::load("rays.safetensors");
    let (k, pixels, boxes) = (
        fixture.f64("k"),
        fixture.f64("pixels"),
        fixture.f64("boxes"),
    );
    for view in 0..3 {
        let k = k.index_axis(Axis(0), view);
        let intrinsics = Intrinsics::new(
            k[[0, 0]],
            k[[1, 1]],
            k[[0, 2]],
            k[[1, 2]],
            Projection::Pinhole,
        )
        .unwrap();
        let camera_rays = fixture.f64("camera_rays").index_axis_move(Axis(0), view);
        for (ray, pixel) in camera_rays
            .axis_iter(Axis(0))
            .zip(pixels.axis_iter(Axis(0)))
        {
            if ray.iter().any(|&x| x != 0.0) {
                let ours = intrinsics
                    .unproject(&Point2::new(pixel[0], pixel[1]))
                    .unwrap();
                assert!((0..3).all(|i| (ours[i] - ray[i]).abs() < 1e-12));
            }
        }
        let pose = fixture.f64("ref_from_cam").index_axis_move(Axis(0), view);
        let ref_from_cam = rigid(pose.view());
        let narrow = camera_rays
            .mapv(|x| x as f32)
            .into_dimensionality::<Ix2>()
            .unwrap();
        for (encoding, name) in [
            (LosEncoding::Direction, "direction"),
            (LosEncoding::OriginDirection, "origin_direction"),
            (LosEncoding::Plucker, "plucker"),
            (LosEncoding::PluckerOrigin, "plucker_origin"),
        ] {
            let ours = rays::encode(narrow.view(), &ref_from_cam, encoding);
            let theirs = fixture.f64(name).index_axis_move(Axis(0), view);
            let gap = gap(ours.mapv(f64::from).into_dyn(), theirs);
            assert!(gap < 1e-6, "{name}: {gap:.1e}"); // float32 at the output
        }
        let camera = mvtop_core::Camera::new("camera", [64, 48], intrinsics, ref_from_cam).unwrap();
        for query in 0..2 {
            let bbox: [f64; 4] = std::array::from_fn(|i| boxes[[view, query, i]]);
            let ours = BoxRays::new(&camera, bbox.into())
                .unwrap()
                .encode(&ref_from_cam);
            let theirs = fixture.f64("box_rays");
            let theirs = theirs.slice(s![view, query, ..]);
            assert!((0..12).all(|i| (f64::from(ours[i]) - theirs[i]).abs() < 1e-6));
        }
    }
}

#[test]
fn poses_and_their_errors() {
    let fixture = Fixture::load("pose.safetensors");
    let (six, rotation) = (fixture.f64("six"), fixture.f64("rotation"));
    let translation = fixture.f64("translation");
    let count = six.shape()[0];
    let isometry = |i: usize| {
        let r = pose::rotation_from_6d(std::array::from_fn(|j| six[[i, j]])).unwrap();
        let t = nalgebra::Translation3::new(
            translation[[i, 0]],
            translation[[i, 1]],
            translation[[i, 2]],
        );
        (
            r,
            nalgebra::Isometry3::from_parts(t, UnitQuaternion::from_rotation_matrix(&r)),
        )
    };
    for i in 0..count {
        let (r, a) = isometry(i);
        let (_, b) = isometry((i + count - 1) % count);
        for (row, column) in (0..9).map(|n| (n / 3, n % 3)) {
            assert!((r[(row, column)] - rotation[[i, row, column]]).abs() < 1e-12);
        }
        let angle = pose::rotation_error_deg(&a.rotation, &b.rotation);
        // The fixture's arccos loses half of its digits near 0 and 180 degrees.
        assert!((angle - fixture.f64("angle_deg")[[i]]).abs() < 1e-5);
    }
}

fn session(bundle: &str, graph: &str) -> Session {
    let path = fixture_path(bundle).join(graph);
    Runtime::locate(None)
        .unwrap()
        .session(&path, &SessionOptions::default())
        .unwrap()
}

#[rstest]
#[case(1)]
#[case(2)]
#[case(3)]
#[case(4)]
fn images_and_lines_of_sight_of_a_sample(#[case] views: usize) {
    let fixture = Fixture::load("network.safetensors");
    let bundle = Bundle::load(&fixture_path("tiny")).unwrap();
    let PoseInput::WholeImages { strides } = &bundle.poses else {
        panic!("{:?}", bundle.poses)
    };
    let rig = sample_rig();
    let theirs = |name: &str| fixture.f64(&format!("{name}.{views}"));
    let (images, rays_) = (theirs("images"), theirs("camera_rays"));
    let (lines, box_rays) = (theirs("rays"), theirs("box_rays"));
    let ref_from_world = rig.cameras()[0].world_from_cam().inverse();
    for (view, camera) in rig.cameras()[..views].iter().enumerate() {
        let path = fixture_path("tiny/sample").join(format!("{}.png", camera.id()));
        let pixels = image::load(&path, camera).unwrap();
        let input = &bundle.input;
        let letterbox = Letterbox::new(camera.width(), camera.height(), input.width, input.height);
        let ours = image::to_tensor(&pixels, &letterbox, input.mean, input.std).unwrap();
        let image_gap = gap(
            ours.mapv(f64::from).into_dyn(),
            images.index_axis(Axis(0), view).to_owned(),
        );
        assert!(image_gap < 1e-6, "image of view {view}: {image_gap:.1e}");

        let camera_rays = rays::camera_rays(camera, &letterbox, strides);
        let expected = rays_.index_axis(Axis(0), view).to_owned();
        assert!(gap(camera_rays.mapv(f64::from).into_dyn(), expected) < 1e-6);
        let ref_from_cam = ref_from_world * camera.world_from_cam();
        let ours = rays::encode(camera_rays.view(), &ref_from_cam, bundle.los_encoding);
        let expected = lines.index_axis(Axis(0), view).to_owned();
        assert!(gap(ours.mapv(f64::from).into_dyn(), expected) < 1e-6);

        let bbox = crate::fixtures::sample_boxes()[camera.id()];
        let ours = BoxRays::new(camera, bbox).unwrap().encode(&ref_from_cam);
        for (i, &x) in ours.iter().enumerate() {
            assert!((f64::from(x) - box_rays[[view, 0, i]]).abs() < 1e-6);
        }
    }
}

#[rstest]
fn graphs_give_what_pytorch_gives(
    #[values("tiny", "tiny/portable")] bundle: &str,
    #[values(1, 2, 3, 4)] views: usize,
) {
    let fixture = Fixture::load("network.safetensors");
    let input = |name: &str| fixture.f32(&format!("{name}.{views}"));
    let close = |ours: ArrayD<f32>, name: &str, tolerance: f64| {
        let gap = gap(
            ours.mapv(f64::from),
            fixture.f64(&format!("{name}.{views}")),
        );
        assert!(
            gap < tolerance,
            "{bundle}, {views} views, {name}: {gap:.1e}"
        );
    };
    let (images, camera_rays) = (input("images"), input("camera_rays"));
    let mut out = session(bundle, "features.onnx")
        .run(&[
            ("images", images.view().into()),
            ("camera_rays", camera_rays.view().into()),
        ])
        .unwrap();
    // Sums of some hundred float32 products in another order.
    close(
        out.take::<Ix3>("memory").unwrap().into_dyn(),
        "memory",
        1e-4,
    );
    let scores: Array4<f32> = out.take("det_scores").unwrap();
    close(scores.into_dyn(), "det_scores", 1e-4);
    let boxes: Array4<f32> = out.take("det_boxes").unwrap();
    close(boxes.into_dyn(), "det_boxes", 1e-3); // pixels

    let names = [
        "memory",
        "rays",
        "centers",
        "half_sizes",
        "box_rays",
        "valid",
    ];
    let arrays = names.map(input);
    let class_index = Array1::<i64>::zeros(1);
    let mut inputs: Vec<(&str, Tensor)> = names
        .iter()
        .zip(&arrays)
        .map(|(&name, x)| (name, x.view().into()))
        .collect();
    inputs.push(("class_index", class_index.view().into()));
    let mut out = session(bundle, "decoder.onnx").run(&inputs).unwrap();
    let rotation: Array2<f32> = out.take("rotation_6d").unwrap();
    close(rotation.into_dyn(), "rotation_6d", 1e-4);
    let translation: Array2<f32> = out.take("translation").unwrap();
    close(translation.into_dyn(), "translation", 1e-4);
    let sigma: Array2<f32> = out.take("sigma").unwrap();
    close(sigma.into_dyn(), "sigma", 1e-2); // degrees
}

#[test]
fn fixtures_hold_numbers_that_differ_between_views() {
    // A parity test on constant outputs would pass for any network.
    let fixture = Fixture::load("network.safetensors");
    let one: Array3<f64> = fixture.f64("rotation.1").into_dimensionality().unwrap();
    let four: Array3<f64> = fixture.f64("rotation.4").into_dimensionality().unwrap();
    assert!(gap(one.into_dyn(), four.into_dyn()) > 1e-3);
}
