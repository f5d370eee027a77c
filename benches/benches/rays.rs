//! Lines of sight of all cells of a 640 x 480 view, for each kind of lens.

use criterion::{Criterion, criterion_group, criterion_main};
use mvtop_core::camera::{BrownConrady, KannalaBrandt};
use mvtop_core::image::Letterbox;
use mvtop_core::rays::{LosEncoding, camera_rays, encode};
use mvtop_core::{Camera, Distortion, Lens};
use nalgebra::{Isometry3, Vector3};
use std::hint::black_box;

fn rays(c: &mut Criterion) {
    let brown_conrady = BrownConrady::new(&[0.0885, -0.226, -1.5e-4, 5.7e-4, 0.11]);
    let kannala_brandt = KannalaBrandt::new(&[-0.006, 0.016, -0.024, 0.0155]);
    let lenses = [
        ("pinhole", 600.0, Distortion::None),
        (
            "brown_conrady",
            600.0,
            Distortion::BrownConrady(brown_conrady.expect("a lens")),
        ),
        (
            "kannala_brandt",
            278.0,
            Distortion::KannalaBrandt(kannala_brandt.expect("a lens")),
        ),
    ];
    let letterbox = Letterbox::new(640, 480, 640, 480);
    let ref_from_cam = Isometry3::new(Vector3::new(0.5, 0.0, 0.1), Vector3::new(0.0, 0.4, 0.0));
    let mut group = c.benchmark_group("rays");
    for (name, focal, distortion) in lenses {
        let camera = Camera {
            id: name.into(),
            width: 640,
            height: 480,
            lens: Lens {
                fx: focal,
                fy: focal,
                cx: 319.5,
                cy: 239.5,
                distortion,
            },
            world_from_cam: Isometry3::identity(),
        };
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
