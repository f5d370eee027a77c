//! Every stage against the fixture that the PyTorch side wrote
//! (`training/mvtop_train/export/fixtures/stages.py`).

use crate::fixtures::{Fixture, gap, rigid};
use image::RgbImage;
use mvtop_core::closeup::CloseUp;
use mvtop_core::image::Pyramid;
use mvtop_core::rays::{self, BoxRays, LosEncoding};
use mvtop_core::sampling::{Dims, Gradients, LevelShapes, Sampling, deformable_sampling};
use mvtop_core::{Camera, Intrinsics, Projection, pose};
use nalgebra::{Isometry3, Point2, UnitQuaternion};
use ndarray::{ArrayD, Axis, Ix2, Ix4, s};
use rstest::rstest;

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

#[rstest]
#[case("pinhole", "pinhole")]
#[case("brown_conrady", "pinhole")]
#[case("kannala_brandt", "fisheye")]
fn closeups_through_every_kind_of_lens(#[case] name: &str, #[case] family: &str) {
    let fixture = Fixture::load("closeup.safetensors");
    let of = |key: &str| fixture.f64(&format!("{name}.{key}"));
    let image = fixture.f64("image");
    let [height, width] = [0, 1].map(|axis| image.shape()[axis] as u32);
    let bytes = image.iter().map(|&x| x as u8).collect();
    let image = RgbImage::from_raw(width, height, bytes).unwrap();
    let (k, params) = (of("k"), of("params"));
    let distortion = (!params.is_empty()).then_some(name);
    let projection =
        Projection::from_params(family, distortion, params.as_slice().unwrap()).unwrap();
    let [fx, fy, cx, cy] = [(0, 0), (1, 1), (0, 2), (1, 2)].map(|(row, column)| k[[row, column]]);
    let intrinsics = Intrinsics::new(fx, fy, cx, cy, projection).unwrap();
    let real = Camera::new("real", [width, height], intrinsics, Isometry3::identity()).unwrap();

    let (boxes, pictures, on_image) = (of("boxes"), of("pictures"), of("on_image"));
    let size = pictures.shape()[1];
    for (i, bbox) in boxes.axis_iter(Axis(0)).enumerate() {
        let bbox = [0, 1, 2, 3].map(|side| bbox[side]);
        let closeup = CloseUp::new(&real, bbox.into(), size as u32).unwrap();
        assert!((closeup.camera.intrinsics().fx() - of("focals")[i]).abs() < 1e-9);
        for (side, ours) in <[f64; 4]>::from(closeup.bbox).into_iter().enumerate() {
            assert!((ours - of("close_boxes")[[i, side]]).abs() < 1e-9);
        }
        let close_from_cam = closeup.camera.world_from_cam().rotation.inverse();
        let rotation = close_from_cam.to_rotation_matrix();
        for (row, column) in (0..9).map(|n| (n / 3, n % 3)) {
            let theirs = of("close_from_cam")[[i, row, column]];
            assert!((rotation[(row, column)] - theirs).abs() < 1e-12);
        }
        let ours = closeup.picture(&real, &Pyramid::new(&image), [0.0; 3], [1.0; 3]);
        for ((channel, v, u), &ours) in ours.indexed_iter() {
            let theirs = pictures[[i, v, u, channel]] / 255.0 * on_image[[i, v, u]];
            assert!((f64::from(ours) - theirs).abs() < 1e-6, "{i}: {u} {v}"); // float32
        }
        assert!(ours.iter().any(|&x| x > 0.1));
    }
    assert!(
        on_image.iter().any(|&x| x == 0.0),
        "one reaches beyond the image"
    );
}
