//! Poses refined on the images: the example of `models/mvball`, from 5 degrees and 3 mm off.

use criterion::{Criterion, criterion_group, criterion_main};
use mvtop_benches::repository;
use mvtop_core::annotations::load_truth;
use mvtop_core::image::{self, Pyramid};
use mvtop_core::prediction::Sigma;
use mvtop_core::refine::{Refiner, View};
use mvtop_core::{Rig, mesh, pose};
use nalgebra::{Isometry3, Vector3};

fn refine(c: &mut Criterion) {
    let folder = repository("examples/mvball");
    let rig = Rig::load(&folder.join("rig.json")).expect("the example's rig");
    let truth = load_truth(&folder.join("truth.json")).expect("the example's truth");
    let truth = truth[0].world_from_obj;
    let mesh = mesh::load_ply(&repository("models/mvball/mvball.mesh.ply"), 1.0).expect("a mesh");
    let images: Vec<_> = rig
        .cameras()
        .iter()
        .map(|camera| {
            let file = folder.join(format!("{}.png", camera.id()));
            image::load(&file, camera).expect("an image of the example")
        })
        .collect();
    let images: Vec<_> = images.iter().map(Pyramid::new).collect();
    let views: Vec<View> = rig
        .cameras()
        .iter()
        .zip(&images)
        .map(|(camera, image)| View { camera, image })
        .collect();
    let turn = Vector3::new(0.6, -0.64, 0.48) * 5_f64.to_radians();
    let start = truth * Isometry3::new(Vector3::new(0.002, -0.001, 0.002), turn);
    let refiner = Refiner::new(&mesh, 0.131);
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.003,
    };
    let found = refiner.refine(&views, &start, sigma).expect("a view");
    println!(
        "off by {:.2} degrees and {:.2} mm, by {:.2} and {:.2} before",
        pose::rotation_error_deg(&found.world_from_obj.rotation, &truth.rotation),
        pose::translation_error(&found.world_from_obj, &truth) * 1e3,
        pose::rotation_error_deg(&start.rotation, &truth.rotation),
        pose::translation_error(&start, &truth) * 1e3,
    );
    let mut group = c.benchmark_group("refine");
    for count in [1, 2] {
        group.bench_function(format!("{count} views"), |b| {
            b.iter(|| {
                refiner
                    .refine(&views[..count], &start, sigma)
                    .expect("a view")
            })
        });
    }
}

criterion_group!(benches, refine);
criterion_main!(benches);
