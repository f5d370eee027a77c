//! A close-up of 320 px of a box of 96 px in a 640 x 480 image, for each kind of lens.

use criterion::{Criterion, criterion_group, criterion_main};
use image::{Rgb, RgbImage};
use mvtop_core::closeup::CloseUp;
use mvtop_core::image::Pyramid;
use mvtop_core::{Camera, Intrinsics, Projection};
use nalgebra::Isometry3;
use std::hint::black_box;

fn closeup(c: &mut Criterion) {
    let image = RgbImage::from_fn(640, 480, |u, v| {
        Rgb([u * 77 + v * 131, u * 13 + v * 7, u ^ v].map(|x| (x % 256) as u8))
    });
    let lenses = [
        ("pinhole", "pinhole", &[][..]),
        (
            "brown_conrady",
            "pinhole",
            &[-0.1, 0.01, 0.001, -0.001, 0.0],
        ),
        (
            "kannala_brandt",
            "fisheye",
            &[-0.006, 0.016, -0.024, 0.0155],
        ),
    ];
    let image = Pyramid::new(&image);
    let mut group = c.benchmark_group("closeup");
    for (name, family, params) in lenses {
        let projection = Projection::from_params(family, None, params).expect("a lens");
        let intrinsics = Intrinsics::new(600.0, 600.0, 320.0, 240.0, projection).expect("a lens");
        let camera = Camera::new(name, [640, 480], intrinsics, Isometry3::identity());
        let camera = camera.expect("a camera");
        let bbox = [200.0, 150.0, 296.0, 246.0].into();
        let closeup = CloseUp::new(&camera, bbox, 320).expect("before the camera");
        group.bench_function(name, |b| {
            b.iter(|| closeup.pixels(black_box(&camera), &image))
        });
    }
}

criterion_group!(benches, closeup);
criterion_main!(benches);
