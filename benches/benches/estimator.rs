//! The whole way from images to poses, with `models/mvball`: of all views, of one new one, and for
//! several callers at once.

use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mvtop_benches::repository;
use mvtop_core::estimator::{Estimator, Options, PredictOptions, Tracker};
use mvtop_core::{Camera, Rig, ViewImage, image};

fn estimator(c: &mut Criterion) {
    let model = repository("models/mvball");
    let estimator = match Estimator::load(&model, &Options::default()) {
        Ok(estimator) => Arc::new(estimator),
        Err(error) => return eprintln!("no benchmark of the estimator: {error}"),
    };
    let folder = repository("examples/mvball");
    let example = Rig::load(&folder.join("rig.json")).expect("the example's rig");
    let mut group = c.benchmark_group("estimator");
    for views in [1, 2, 4, 8] {
        // The example has two views; more repeat them under other names.
        let (mut cameras, mut images) = (Vec::new(), Vec::new());
        for (view, camera) in example.cameras().iter().cycle().take(views).enumerate() {
            let file = folder.join(format!("{}.png", camera.id()));
            images.push(ViewImage {
                camera: view,
                image: image::load(&file, camera).expect("an image of the example"),
            });
            let (id, size) = (format!("view{view}"), [camera.width(), camera.height()]);
            let (intrinsics, pose) = (camera.intrinsics().clone(), *camera.world_from_cam());
            cameras.push(Camera::new(id, size, intrinsics, pose).expect("the example's camera"));
        }
        let rig = Rig::new(cameras, 0).expect("a rig");
        group.bench_function(format!("{views} views"), |b| {
            b.iter(|| {
                estimator
                    .predict(&rig, &images, &PredictOptions::default())
                    .expect("a prediction")
            })
        });
        let mut tracker = Tracker::new(estimator.clone(), Arc::new(rig));
        // Two images that differ in every pixel and hardly to the eye, in turn.
        let mut other = images[0].clone();
        other.image.iter_mut().for_each(|x| *x ^= 1);
        let mut turns = [images[0].clone(), other].into_iter().cycle();
        tracker.update(images).expect("images of the rig");
        group.bench_function(format!("one of {views} views is new"), |b| {
            b.iter(|| {
                let new = turns.next().into_iter().collect();
                tracker.update(new).expect("an image of the rig");
                tracker
                    .predict(&PredictOptions::default())
                    .expect("a prediction")
            })
        });
    }
}

/// Several threads ask one estimator at once for poses of the example.
fn callers(c: &mut Criterion) {
    let model = repository("models/mvball");
    let estimator = match Estimator::load(&model, &Options::default()) {
        Ok(estimator) => estimator,
        Err(error) => return eprintln!("no benchmark of callers: {error}"),
    };
    let folder = repository("examples/mvball");
    let rig = Rig::load(&folder.join("rig.json")).expect("the example's rig");
    let cameras = rig.cameras().iter().enumerate();
    let images: Vec<ViewImage> = cameras
        .map(|(view, camera)| ViewImage {
            camera: view,
            image: image::load(&folder.join(format!("{}.png", camera.id())), camera)
                .expect("an image of the example"),
        })
        .collect();
    let predict = || {
        let found = estimator.predict(&rig, &images, &PredictOptions::default());
        found.expect("a prediction").objects[0].world_from_obj
    };
    let expected = predict();
    let mut group = c.benchmark_group("predictions of callers at once");
    for callers in [1, 2, 4] {
        group.throughput(Throughput::Elements(callers));
        group.bench_function(callers.to_string(), |b| {
            b.iter(|| {
                std::thread::scope(|scope| {
                    let each = (0..callers).map(|_| scope.spawn(predict));
                    for caller in each.collect::<Vec<_>>() {
                        assert_eq!(caller.join().expect("a caller"), expected);
                    }
                });
            })
        });
    }
}

criterion_group!(benches, estimator, callers);
criterion_main!(benches);
