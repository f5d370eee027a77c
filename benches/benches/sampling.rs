//! Deformable sampling: the kernel, and the same sampling as a graph in ONNX Runtime, by mvtop's
//! operator and by the standard GridSample.

use criterion::{Criterion, criterion_group, criterion_main};
use mvtop_benches::{noise, repository};
use mvtop_core::onnx::{Runtime, SessionOptions};
use mvtop_core::sampling::{Gradients, LevelShapes, Sampling};
use ndarray::{Array4, Array5, Array6};
use std::hint::black_box;

/// Of the fixture graphs; the queries of an encoder layer are the cells themselves.
const LEVELS: [(usize, usize); 3] = [(20, 20), (10, 10), (5, 5)];
const QUERIES: usize = 525;

fn sampling(c: &mut Criterion) {
    let (batch, heads, head_dim, points) = (2, 8, 16, 4);
    let levels = LevelShapes::new(&LEVELS).expect("valid levels");
    let value: Array4<f32> = noise((batch, levels.cells(), heads, head_dim), -1.0, 1.0);
    let locations: Array6<f32> = noise((batch, QUERIES, heads, levels.len(), points, 2), 0.0, 1.0);
    let weights: Array5<f32> = noise((batch, QUERIES, heads, levels.len(), points), 0.0, 0.1);
    let problem = Sampling::of_arrays(&levels, value.view(), locations.view(), weights.view());
    let problem = problem.expect("matching shapes");
    let mut out = vec![0.0; problem.output_len()];
    let grad_out = out.clone();
    let mut grads = [value.len(), locations.len(), weights.len()].map(|len| vec![0.0; len]);

    let mut group = c.benchmark_group("sampling");
    group.bench_function("kernel/forward", |b| {
        b.iter(|| problem.forward(black_box(&mut out)))
    });
    group.bench_function("kernel/backward", |b| {
        b.iter(|| {
            let [value, locations, weights] = &mut grads;
            let gradients = Gradients {
                value,
                locations,
                weights,
            };
            problem.backward(black_box(&grad_out), gradients)
        })
    });
    let runtime = match Runtime::locate(None) {
        Ok(runtime) => runtime,
        Err(error) => return eprintln!("no benchmark of the graphs: {error}"),
    };
    for (name, file) in [
        ("operator", "fixtures/deformable_sampling.onnx"),
        ("grid_sample", "fixtures/deformable_sampling_portable.onnx"),
    ] {
        let network = runtime
            .session(&repository(file), &SessionOptions::default())
            .expect("a graph of the repository");
        group.bench_function(name, |b| {
            b.iter(|| {
                network.run(&[
                    ("value", value.view().into()),
                    ("locations", locations.view().into()),
                    ("weights", weights.view().into()),
                ])
            })
        });
    }
}

criterion_group!(benches, sampling);
criterion_main!(benches);
