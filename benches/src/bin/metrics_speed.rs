//! Our side of `benches/metrics_speed.py`: reads a scene, prints a line of JSON
//! with the time and the value of each metric and pose.

use std::hint::black_box;
use std::time::Instant;

use mvtop_core::{Intrinsics, Projection};
use mvtop_eval::metrics::{
    BOP_MAX_STEP, ContinuousSymmetry, MatchingCost, Surface, Symmetries, VSD_TAUS, VsdOptions, vsd,
};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use ndarray::{Array2, Array3};
use safetensors::SafeTensors;

type Metric<'a> = &'a dyn Fn(usize) -> f64;

fn main() {
    let path = std::env::args().nth(1).expect("the scene's file");
    let bytes = std::fs::read(path).expect("a readable file");
    let file = SafeTensors::deserialize(&bytes).expect("a safetensors file");
    let numbers = |name: &str| -> Vec<f64> {
        let (data, _) = file.tensor(name).expect(name).data().as_chunks();
        data.iter()
            .map(|&bytes| f64::from_le_bytes(bytes))
            .collect()
    };
    let motions = |name: &str| -> Vec<Isometry3<f64>> {
        numbers(name).chunks_exact(16).map(motion).collect()
    };
    let images = |name: &str| -> Vec<Array2<f32>> {
        let tensor = file.tensor(name).expect(name);
        let &[n, height, width] = tensor.shape() else {
            panic!("{name}: three axes")
        };
        let (numbers, _) = tensor.data().as_chunks();
        let numbers = numbers.iter().map(|&bytes| f32::from_le_bytes(bytes));
        let images = Array3::from_shape_vec((n, height, width), numbers.collect()).expect(name);
        images.outer_iter().map(|image| image.to_owned()).collect()
    };
    let points = numbers("points");
    let points: Vec<Point3<f64>> = points.chunks_exact(3).map(Point3::from_slice).collect();
    let surface = Surface::new(&points).expect("points");
    let (truth, estimate) = (motions("truth"), motions("estimate"));
    let (depth_truth, depth_estimate) = (images("depth_truth"), images("depth_estimate"));
    let &[fx, fy, cx, cy] = &numbers("lens")[..] else {
        panic!("lens: four numbers")
    };
    let intrinsics = Intrinsics::new(fx, fy, cx, cy, Projection::Pinhole).expect("a camera");
    let turn = ContinuousSymmetry {
        axis: Vector3::z_axis(),
        offset: Point3::origin(),
    };
    let none = Symmetries::default();
    let turns = Symmetries::new(&[], &[turn], BOP_MAX_STEP).expect("a step");
    let options = VsdOptions {
        delta: 15.0,
        taus: VSD_TAUS.to_vec(),
        diameter: Some(180.0),
        cost: MatchingCost::Step,
    };
    let measured = Array2::from_elem(depth_truth[0].dim(), 1500.0);
    // The tree for ADD-S is made once per object; its time is not in that of the poses.
    let start = Instant::now();
    black_box(surface.add_s(&truth[0], &truth[0]));
    eprintln!("first ADD-S, tree included: {:?}", start.elapsed());
    let mssd = |i: usize, symmetries| surface.mssd(&truth[i], &estimate[i], symmetries);
    let mspd =
        |i: usize, symmetries| surface.mspd(&truth[i], &estimate[i], symmetries, &intrinsics);
    let metrics: [(&str, Metric); 7] = [
        ("add", &|i| surface.add(&truth[i], &estimate[i])),
        ("adi", &|i| surface.add_s(&truth[i], &estimate[i])),
        ("mssd", &|i| mssd(i, &none)),
        ("mssd_turns", &|i| mssd(i, &turns)),
        ("mspd", &|i| mspd(i, &none)),
        ("mspd_turns", &|i| mspd(i, &turns)),
        ("vsd", &|i| {
            let (estimate, truth) = (&depth_estimate[i], &depth_truth[i]);
            let errors = vsd(estimate, truth, &measured, &intrinsics, &options);
            let errors = errors.expect("images of one size");
            errors.iter().sum::<f64>() / errors.len() as f64
        }),
    ];
    for (name, metric) in metrics {
        for pose in 0..truth.len() {
            let start = Instant::now();
            let value = black_box(metric(black_box(pose)));
            let us = 1e6 * start.elapsed().as_secs_f64();
            println!("{{\"name\":\"{name}\",\"pose\":{pose},\"us\":{us},\"value\":{value}}}");
        }
    }
}

fn motion(rows: &[f64]) -> Isometry3<f64> {
    let rotation = Matrix3::from_fn(|i, j| rows[4 * i + j]);
    Isometry3::from_parts(
        Translation3::new(rows[3], rows[7], rows[11]),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)),
    )
}
