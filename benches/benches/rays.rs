//! Lines of sight of all cells of a 640 x 480 view, for each kind of lens.

use criterion::{Criterion, criterion_group, criterion_main};
use mvtop_core::image::Letterbox;
use mvtop_core::rays::{LosEncoding, camera_rays, encode};
use mvtop_core::{Camera, Intrinsics, Projection};
use nalgebra::{Isometry3, Vector3};
use std::hint::black_box;

fn rays(c: &mut Criterion) {
    let brown_conrady = [0.0885, -0.226, -1.5e-4, 5.7e-4, 0.11];
    let lenses = [
        ("pinhole", 600.0, "pinhole", &[][..]),
        ("brown_conrady", 600.0, "pinhole", &brown_conrady[..]),
        (
            "kannala_brandt",
            278.0,
            "fisheye",
            &[-0.006, 0.016, -0.024, 0.0155],
        ),
    ];
    let letterbox = Letterbox::new(640, 480, 640, 480);
    let ref_from_cam = Isometry3::new(Vector3::new(0.5, 0.0, 0.1), Vector3::new(0.0, 0.4, 0.0));
    let mut group = c.benchmark_group("rays");
    for (name, focal, family, params) in lenses {
        let projection = Projection::from_params(family, None, params).expect("a lens");
        let intrinsics = Intrinsics::new(focal, focal, 319.5, 239.5, projection).expect("a lens");
        let camera = Camera::new(name, [640, 480], intrinsics, Isometry3::identity());
        let camera = camera.expect("a camera");
        group.bench_function(name, |b| {
            b.iter(|| {
                let rays = camera_rays(black_box(&camera), &letterbox, &[8, 16, 32]);
                encode(rays.view(), &ref_from_cam, LosEncoding::PluckerOrigin)
            })
        });
    }
}

criterion_group!(benches, rays);
criterion_main!(benches);
