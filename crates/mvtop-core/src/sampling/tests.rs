use super::*;

const LEVELS: [(usize, usize); 2] = [(6, 4), (3, 2)];

/// Numbers from -1 to 1 that are the same in every run.
fn noise(len: usize, mut seed: u64) -> Vec<f32> {
    let step = |s: &mut u64| {
        *s = s
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (*s >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    };
    (0..len).map(|_| step(&mut seed)).collect()
}

struct Case {
    levels: LevelShapes,
    dims: Dims,
    value: Vec<f32>,
    locations: Vec<f32>,
    weights: Vec<f32>,
}

impl Case {
    /// Locations reach from -0.2 to 1.2, so some taps are partly or fully outside.
    fn random(head_dim: usize) -> Self {
        let levels = LevelShapes::new(&LEVELS).unwrap();
        let dims = Dims {
            batch: 2,
            heads: 3,
            head_dim,
            queries: 5,
            points: 2,
        };
        let taps = dims.batch * dims.queries * dims.heads * levels.len() * dims.points;
        let values = dims.batch * levels.cells() * dims.heads * head_dim;
        Self {
            value: noise(values, 1),
            locations: noise(2 * taps, 2).iter().map(|x| 0.5 + 0.7 * x).collect(),
            weights: noise(taps, 3),
            levels,
            dims,
        }
    }

    /// One head, channel, query, level and point.
    fn single(shape: (usize, usize), value: Vec<f32>, location: [f32; 2]) -> Self {
        Self {
            levels: LevelShapes::new(&[shape]).unwrap(),
            dims: Dims {
                batch: 1,
                heads: 1,
                head_dim: 1,
                queries: 1,
                points: 1,
            },
            value,
            locations: location.to_vec(),
            weights: vec![1.0],
        }
    }

    fn sampling(&self) -> Sampling<'_> {
        let Self {
            levels,
            dims,
            value,
            locations,
            weights,
        } = self;
        Sampling::new(levels, *dims, value, locations, weights).unwrap()
    }

    fn forward(&self) -> Vec<f32> {
        let mut out = vec![f32::NAN; self.sampling().output_len()];
        self.sampling().forward(&mut out).unwrap();
        out
    }

    /// Gradients of value, locations and weights; the buffers start dirty on purpose.
    fn backward(&self, grad_out: &[f32]) -> [Vec<f32>; 3] {
        let dirty = |len| vec![7.0f32; len];
        let mut grads = [
            dirty(self.value.len()),
            dirty(self.locations.len()),
            dirty(self.weights.len()),
        ];
        let [value, locations, weights] = &mut grads;
        self.sampling()
            .backward(
                grad_out,
                Gradients {
                    value,
                    locations,
                    weights,
                },
            )
            .unwrap();
        grads
    }

    fn input(&mut self, which: usize) -> &mut Vec<f32> {
        [&mut self.value, &mut self.locations, &mut self.weights]
            .into_iter()
            .nth(which)
            .unwrap()
    }
}

#[test]
fn six_locations_worked_by_hand() {
    // A 2 x 3 map holding 10 * row + column + 1.
    let map = vec![1.0, 2.0, 3.0, 11.0, 12.0, 13.0];
    let cases = [
        ([0.5, 0.5], 7.0),
        ([0.0, 0.0], 0.25),
        ([1.0, 1.0], 3.25),
        ([0.25, 0.75], 11.25),
        ([-0.1, 0.5], 1.2),
        ([-0.2, 0.5], 0.0),
    ];
    for (location, expected) in cases {
        let out = Case::single((2, 3), map.clone(), location).forward()[0];
        assert!(
            (out - expected).abs() < 1e-5,
            "{location:?}: {out}, expected {expected}"
        );
    }
}

#[test]
fn gradients_worked_by_hand() {
    // Between the centers of cells 1 and 2 of a row [1, 2, 4]: the slope is 3 per unit of x.
    let case = Case::single((1, 3), vec![1.0, 2.0, 4.0], [2.0 / 3.0, 0.5]);
    let [value, locations, weights] = case.backward(&[10.0]);
    for (got, expected) in value.iter().zip([0.0, 5.0, 5.0]) {
        assert!((got - expected).abs() < 1e-4, "{value:?}");
    }
    assert!(
        (locations[0] - 10.0 * 2.0 * 3.0).abs() < 1e-3,
        "{locations:?}"
    );
    assert!((weights[0] - 30.0).abs() < 1e-4, "{weights:?}");
}

/// The sum over taps written as plainly as possible, in f64.
fn reference(case: &Case) -> Vec<f64> {
    let Dims {
        batch,
        heads,
        head_dim,
        queries,
        points,
    } = case.dims;
    let mut out = Vec::new();
    for b in 0..batch {
        for q in 0..queries {
            for h in 0..heads {
                for d in 0..head_dim {
                    let mut sum = 0.0f64;
                    for (l, level) in case.levels.levels.iter().enumerate() {
                        for k in 0..points {
                            let tap = (((b * queries + q) * heads + h) * case.levels.len() + l)
                                * points
                                + k;
                            let x = case.locations[2 * tap] as f64 * level.width as f64 - 0.5;
                            let y = case.locations[2 * tap + 1] as f64 * level.height as f64 - 0.5;
                            for row in 0..level.height {
                                for column in 0..level.width {
                                    let share = (1.0 - (x - column as f64).abs()).max(0.0)
                                        * (1.0 - (y - row as f64).abs()).max(0.0);
                                    let cell = b * case.levels.cells()
                                        + level.first_cell
                                        + row * level.width
                                        + column;
                                    let value = case.value[(cell * heads + h) * head_dim + d];
                                    sum += case.weights[tap] as f64 * share * value as f64;
                                }
                            }
                        }
                    }
                    out.push(sum);
                }
            }
        }
    }
    out
}

#[test]
fn every_head_dim_matches_the_plain_sum() {
    for head_dim in [1, 3, 8, 13, 16, 24, 32, 57] {
        let case = Case::random(head_dim);
        for (i, (got, expected)) in case.forward().iter().zip(reference(&case)).enumerate() {
            // Rounding of x·W − ½ in f32 moves a read by about 1e-6 cells.
            assert!(
                (*got as f64 - expected).abs() < 1e-5,
                "D {head_dim}, {i}: {got}, {expected}"
            );
        }
    }
}

#[test]
fn gradients_match_finite_differences_for_every_head_dim() {
    for head_dim in [1, 8, 13, 32] {
        let mut case = Case::random(head_dim);
        let grad_out = noise(case.sampling().output_len(), 4);
        let grads = case.backward(&grad_out);
        let loss = |case: &Case| -> f64 {
            reference(case)
                .iter()
                .zip(&grad_out)
                .map(|(a, b)| a * *b as f64)
                .sum()
        };
        for (which, grad) in grads.iter().enumerate() {
            for i in (0..grad.len()).step_by(1 + grad.len() / 12) {
                let x = case.input(which)[i];
                let step = 1.0 / 4096.0;
                case.input(which)[i] = x + step;
                let up = (loss(&case), case.input(which)[i]);
                case.input(which)[i] = x - step;
                let down = (loss(&case), case.input(which)[i]);
                case.input(which)[i] = x;
                // The loss is piecewise linear in each input, so this is exact up to rounding
                // unless a cell border lies between; the seed keeps the taps off the borders.
                let expected = (up.0 - down.0) / (up.1 as f64 - down.1 as f64);
                let error = (grad[i] as f64 - expected).abs();
                assert!(
                    error < 1e-3 * (1.0 + expected.abs()),
                    "D {head_dim}, input {which}, element {i}: {}, expected {expected}",
                    grad[i]
                );
            }
        }
    }
}

#[test]
fn locations_that_are_not_finite_contribute_nothing() {
    let finite = Case::random(16);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -1e38] {
        for axis in 0..2 {
            let (mut with_bad, mut without) = (Case::random(16), Case::random(16));
            let tap = 4;
            with_bad.locations[2 * tap + axis] = bad;
            without.weights[tap] = 0.0;
            assert_eq!(
                with_bad.forward(),
                without.forward(),
                "{bad} on axis {axis}"
            );
            let grad_out = noise(finite.sampling().output_len(), 5);
            let [value, locations, weights] = with_bad.backward(&grad_out);
            assert_eq!(value, without.backward(&grad_out)[0]);
            assert_eq!(&locations[2 * tap..2 * tap + 2], [0.0, 0.0]);
            assert_eq!(weights[tap], 0.0);
        }
    }
}

#[test]
fn a_tap_of_weight_zero_does_not_read() {
    let mut case = Case::single((1, 1), vec![f32::NAN], [0.5, 0.5]);
    case.weights[0] = 0.0;
    assert_eq!(case.forward(), [0.0]);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let case = Case::random(16);
    let grad_out = noise(case.sampling().output_len(), 6);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| (case.forward(), case.backward(&grad_out)))
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn arrays_that_do_not_belong_together_are_refused() {
    let case = Case::random(8);
    let mut long = case.locations.clone();
    long.push(0.0);
    let error = Sampling::new(&case.levels, case.dims, &case.value, &long, &case.weights);
    assert!(error.unwrap_err().to_string().contains("locations"));
    let huge = Dims {
        batch: usize::MAX,
        heads: 0,
        ..case.dims
    };
    assert!(Sampling::new(&case.levels, huge, &[], &[], &[]).is_err());
    assert!(case.sampling().forward(&mut [0.0]).is_err());
    assert!(LevelShapes::new(&[(0, 3)]).is_err());
    assert!(LevelShapes::new(&[(usize::MAX, 2)]).is_err());
}

#[test]
fn a_hair_left_of_the_first_cell_only_that_cell_is_read() {
    // Next to 0 numbers are so dense that a cell further on the difference would be rounded away.
    let case = Case::single((1, 2), vec![1.0, 5.0], [0.25f32.next_down(), 0.5]);
    let [_, locations, _] = case.backward(&[1.0]);
    assert_eq!(locations[0], 2.0);
}

#[test]
fn places_that_do_not_fit_into_32_bits_are_refused() {
    let levels = LevelShapes::new(&[(1 << 12, 1 << 12)]).unwrap();
    let of_heads = |heads| {
        let dims = Dims {
            batch: 0,
            heads,
            head_dim: 16,
            queries: 1,
            points: 1,
        };
        Sampling::new(&levels, dims, &[], &[], &[])
    };
    assert!(of_heads(15).is_ok());
    let refused = of_heads(16).unwrap_err().to_string();
    assert!(refused.contains("value"), "{refused}");
}

#[test]
fn empty_axes_give_empty_or_zero_results() {
    let levels = LevelShapes::new(&[(2, 2)]).unwrap();
    let none = Dims {
        batch: 1,
        heads: 1,
        head_dim: 4,
        queries: 0,
        points: 1,
    };
    let value = [1.0; 16];
    let sampling = Sampling::new(&levels, none, &value, &[], &[]).unwrap();
    sampling.forward(&mut []).unwrap();
    let mut grad = [7.0; 16];
    let gradients = Gradients {
        value: &mut grad,
        locations: &mut [],
        weights: &mut [],
    };
    sampling.backward(&[], gradients).unwrap();
    assert_eq!(grad, [0.0; 16]);

    let no_points = Dims {
        queries: 2,
        points: 0,
        ..none
    };
    let mut out = [7.0; 8];
    Sampling::new(&levels, no_points, &value, &[], &[])
        .unwrap()
        .forward(&mut out)
        .unwrap();
    assert_eq!(out, [0.0; 8]);
}

#[test]
fn strided_arrays_are_sampled_like_contiguous_ones() {
    let case = Case::random(8);
    let Dims {
        batch,
        heads,
        head_dim,
        queries,
        points,
    } = case.dims;
    let (n, l) = (case.levels.cells(), case.levels.len());
    let value = ndarray::Array4::from_shape_vec((batch, n, heads, head_dim), case.value.clone());
    let locations = ndarray::Array6::from_shape_vec(
        (batch, queries, heads, l, points, 2),
        case.locations.clone(),
    );
    let weights =
        ndarray::Array5::from_shape_vec((batch, queries, heads, l, points), case.weights.clone());
    let (value, locations, weights) = (value.unwrap(), locations.unwrap(), weights.unwrap());
    let mut transposed = ndarray::Array4::zeros((head_dim, heads, n, batch));
    transposed.assign(&value.t());
    let out = deformable_sampling(transposed.t(), locations.view(), weights.view(), &LEVELS);
    assert_eq!(out.unwrap().into_raw_vec_and_offset().0, case.forward());

    let wrong = deformable_sampling(value.view(), locations.view(), weights.view(), &[(6, 4)]);
    assert!(wrong.unwrap_err().to_string().contains("value"));
}
