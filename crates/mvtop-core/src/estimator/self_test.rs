//! The network's answers to one fixed input, against those in the bundle.
//!
//! Whole files with the right checksums may still be run wrongly: by another provider, another
//! version of ONNX Runtime, or a broken library. `training/mvtop_train/export/self_test.py` computes
//! the same in PyTorch.

use std::collections::BTreeMap;

use ndarray::{
    Array, Array1, Array2, Array3, Array4, ArrayView2, Axis, Dimension, ShapeBuilder, s,
};

use crate::bundle::Bundle;
use crate::network::{Network, Queries};
use crate::{Error, Result};

const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Whether there was something to compare with.
pub fn run(bundle: &Bundle, network: &dyn Network) -> Result<bool> {
    let Some(expected) = &bundle.self_test else {
        return Ok(false);
    };
    let got = answers(bundle, network)?;
    for (name, expected_numbers) in &expected.outputs {
        let refuse = |got: &[f64]| Error::Bundle {
            path: bundle.dir.clone(),
            problem: format!(
                "its network answers the self-test with {name} {got:?}, expected \
                 {expected_numbers:?}; try `--provider cpu` and another version of onnxruntime, or \
                 export the bundle again"
            ),
        };
        let numbers = got.get(name.as_str()).map_or(&[][..], Vec::as_slice);
        let largest = expected_numbers
            .iter()
            .fold(0.0, |m: f64, x| m.max(x.abs()));
        let near = |(a, b): (&f64, &f64)| (a - b).abs() <= expected.tolerance * largest;
        if numbers.len() != expected_numbers.len()
            || !numbers.iter().zip(expected_numbers).all(near)
        {
            return Err(refuse(numbers));
        }
    }
    Ok(true)
}

/// The golden ratio's multiples, less whole numbers, in [-1, 1).
fn numbers<D: Dimension>(shape: impl ShapeBuilder<Dim = D>) -> Array<f32, D> {
    let mut step = -1.0;
    Array::from_shape_simple_fn(shape, || {
        step += 1.0;
        let multiple: f64 = step * GOLDEN;
        (2.0 * (multiple - multiple.floor()) - 1.0) as f32
    })
}

/// `[1, N, 3]`, unit vectors around the axis.
fn rays(cells: usize) -> Array3<f32> {
    let beside: Array2<f32> = numbers((cells, 2));
    let mut rays = Array3::ones((1, cells, 3));
    rays.slice_mut(s![0, .., ..2]).assign(&(0.5 * &beside));
    for mut ray in rays.rows_mut() {
        let length = ray.dot(&ray).sqrt();
        ray /= length;
    }
    rays
}

fn answers(bundle: &Bundle, network: &dyn Network) -> Result<BTreeMap<&'static str, Vec<f64>>> {
    let (width, height) = (bundle.input.width as usize, bundle.input.height as usize);
    let images: Array4<f32> = numbers((1, 3, height, width));
    let mut answers = BTreeMap::new();
    let side = bundle.closeups.size as usize;
    let pictures: Array4<f32> = numbers((1, 3, side, side));
    let memory = match bundle.has_coordinates() {
        true => {
            let coordinates = network.coordinates(pictures.view())?;
            let mean = |channel| mean(&mut coordinates.index_axis(Axis(1), channel).iter());
            answers.insert("coordinates", (0..4).map(mean).collect());
            None
        }
        false => {
            let level = |stride: &usize| side.div_ceil(*stride).pow(2);
            let rays = rays(bundle.closeups.strides.iter().map(level).sum());
            Some(network.encode(pictures.view(), rays.view())?)
        }
    };
    let maps = network.detect(images.view())?;
    maps.check(1, bundle.classes.len(), f32::INFINITY)?;
    let most = maps.scores.iter().fold(0.0, |most: f32, &x| most.max(x));
    let side = |side| mean(&mut maps.boxes.index_axis(Axis(1), side).iter());
    answers.insert(
        "det_scores",
        vec![mean(&mut maps.scores.iter()), most.into()],
    );
    answers.insert("det_boxes", (0..4).map(side).collect());
    if let Some(memory) = memory {
        answers.insert(
            "memory",
            vec![
                mean(&mut memory.iter()),
                mean(&mut memory.mapv(f32::abs).iter()),
            ],
        );
        answers.extend(decoded(bundle, network, memory.dim())?);
    }
    Ok(answers)
}

fn mean(numbers: &mut dyn Iterator<Item = &f32>) -> f64 {
    let (sum, count) = numbers.fold((0.0, 0.0), |(sum, count), x| {
        (sum + f64::from(*x), count + 1.0)
    });
    sum / count
}

/// The pose that the decoder makes of given numbers: of what the encoder makes of the picture, steps
/// of 8 bits would be magnified.
///
/// - `memory`: its size
fn decoded(
    bundle: &Bundle,
    network: &dyn Network,
    memory: (usize, usize, usize),
) -> Result<[(&'static str, Vec<f64>); 3]> {
    let queries = Queries {
        rays: numbers((1, memory.1, bundle.los_encoding.width())),
        centers: Array3::from_elem((1, 1, 2), 0.5),
        half_sizes: Array3::from_elem((1, 1, 2), 0.3),
        box_rays: numbers((1, 1, 12)),
        valid: Array2::ones((1, 1)),
        class_index: Array1::zeros(1),
    };
    let decoded = network.decode(numbers(memory).view(), &queries)?;
    decoded.check(1)?;
    let first = |rows: ArrayView2<f32>| rows.row(0).iter().map(|&x| f64::from(x)).collect();
    Ok([
        ("rotation_6d", first(decoded.rotation_6d.view())),
        ("translation", first(decoded.translation.view())),
        ("sigma", first(decoded.sigma.view())),
    ])
}
