//! Networks in ONNX Runtime. These tests need the library: they fail without one.

use mvtop_core::Error;
use mvtop_core::onnx::{Provider, Runtime, Session, SessionOptions};
use mvtop_core::sampling::deformable_sampling;
use ndarray::{Array, Array3, Array4, Array5, Array6, Dimension, Ix3, ShapeBuilder};
use std::path::{Path, PathBuf};

const LEVELS: [(usize, usize); 3] = [(20, 20), (10, 10), (5, 5)];

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fixtures")
        .join(name)
}

fn session(name: &str) -> Session {
    let options = SessionOptions::default().with_threads(2);
    Runtime::locate(None)
        .unwrap()
        .session(&fixture(name), &options)
        .unwrap()
}

/// Numbers from `low` to `high` that are the same in every run.
fn noise<D: Dimension>(
    shape: impl ShapeBuilder<Dim = D>,
    low: f32,
    high: f32,
    mut seed: u64,
) -> Array<f32, D> {
    Array::from_shape_simple_fn(shape, || {
        seed = seed
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        low + (high - low) * (seed >> 40) as f32 / (1u64 << 24) as f32
    })
}

/// Inputs of the fixture graphs; some locations lie outside.
fn inputs(queries: usize) -> (Array4<f32>, Array6<f32>, Array5<f32>) {
    (
        noise((2, 525, 8, 16), -1.0, 1.0, 1),
        noise((2, queries, 8, 3, 4, 2), -0.1, 1.1, 2),
        noise((2, queries, 8, 3, 4), 0.0, 0.1, 3),
    )
}

fn run(
    session: &Session,
    (value, locations, weights): &(Array4<f32>, Array6<f32>, Array5<f32>),
) -> mvtop_core::Result<Array3<f32>> {
    session
        .run(&[
            ("value", value.view().into()),
            ("locations", locations.view().into()),
            ("weights", weights.view().into()),
        ])?
        .take::<Ix3>("out")
}

#[test]
fn the_operator_is_the_kernel_whatever_the_number_of_queries() {
    let session = session("deformable_sampling.onnx");
    for queries in [0, 1, 64, 150] {
        let inputs = inputs(queries);
        let (value, locations, weights) = &inputs;
        let kernel =
            deformable_sampling(value.view(), locations.view(), weights.view(), &LEVELS).unwrap();
        assert_eq!(run(&session, &inputs).unwrap(), kernel);
    }
}

#[test]
fn the_operator_agrees_with_the_same_graph_of_standard_operators() {
    let inputs = inputs(70);
    let ours = run(&session("deformable_sampling.onnx"), &inputs).unwrap();
    let standard = run(&session("deformable_sampling_portable.onnx"), &inputs).unwrap();
    // Coordinates are rounded in f32 in both, in a different order.
    let largest = (&ours - &standard)
        .iter()
        .fold(0.0f32, |most, x| most.max(x.abs()));
    assert!(largest < 2e-5, "{largest}");
    assert!(ours.iter().any(|x| x.abs() > 0.05));
}

#[test]
fn a_network_run_from_many_rayon_tasks_at_once_ends() {
    let session = session("deformable_sampling.onnx");
    let inputs = inputs(100);
    let expected = run(&session, &inputs).unwrap();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(8)
        .build()
        .unwrap();
    pool.scope(|scope| {
        for _ in 0..40 {
            scope.spawn(|_| assert_eq!(run(&session, &inputs).unwrap(), expected));
        }
    });
}

#[test]
fn networks_can_be_loaded_at_the_same_time() {
    // ONNX Runtime 1.20 fails in some of these if left alone.
    std::thread::scope(|scope| {
        let load = || scope.spawn(|| session("deformable_sampling.onnx"));
        let loading: Vec<_> = (0..16).map(|_| load()).collect();
        for thread in loading {
            assert_eq!(thread.join().unwrap().outputs(), ["out"]);
        }
    });
}

#[test]
fn inputs_that_are_not_contiguous_are_copied() {
    let session = session("deformable_sampling.onnx");
    let mut inputs = inputs(5);
    let expected = run(&session, &inputs).unwrap();
    let mut fortran = Array4::zeros(inputs.0.raw_dim().f());
    fortran.assign(&inputs.0);
    inputs.0 = fortran;
    assert_eq!(run(&session, &inputs).unwrap(), expected);
}

#[test]
fn a_wrong_shape_a_missing_input_and_a_missing_output_are_errors_that_name_them() {
    let session = session("deformable_sampling.onnx");
    let mut wrong = inputs(3);
    wrong.1 = noise((2, 4, 8, 3, 4, 2), 0.0, 1.0, 1);
    let error = run(&session, &wrong).unwrap_err();
    assert!(error.to_string().contains("locations has shape"), "{error}");

    let right = inputs(3);
    let error = session
        .run(&[("value", right.0.view().into())])
        .unwrap_err();
    assert!(
        error.to_string().contains("`locations` was not given"),
        "{error}"
    );

    let mut outputs = session
        .run(&[
            ("value", right.0.view().into()),
            ("locations", right.1.view().into()),
            ("weights", right.2.view().into()),
            ("of no concern to this graph", right.2.view().into()),
        ])
        .unwrap();
    let error = outputs.clone().take::<Ix3>("pose").unwrap_err();
    assert!(error.to_string().contains("`pose`"), "{error}");
    let error = outputs.take::<ndarray::Ix2>("out").unwrap_err();
    assert!(error.to_string().contains("expected 2 axes"), "{error}");
}

#[test]
fn a_file_that_is_missing_or_no_graph_is_a_network_error() {
    let runtime = Runtime::locate(None).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let garbage = dir.path().join("garbage.onnx");
    std::fs::write(&garbage, "not a graph").unwrap();
    for path in [dir.path().join("none.onnx"), garbage] {
        let error = runtime
            .session(&path, &SessionOptions::default())
            .unwrap_err();
        assert!(matches!(error, Error::Network { .. }), "{error}");
        assert!(
            error.to_string().contains(path.to_str().unwrap()),
            "{error}"
        );
    }
}

#[test]
fn level_shapes_that_make_no_sense_are_refused_when_the_network_is_loaded() {
    let runtime = Runtime::locate(None).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bad.onnx");
    // Protobuf writes each number of the attribute behind the tag 64; the last height becomes 0.
    let mut bytes = std::fs::read(fixture("deformable_sampling.onnx")).unwrap();
    let level_shapes = [64, 20, 64, 20, 64, 10, 64, 10, 64, 5, 64, 5];
    let at = bytes
        .windows(level_shapes.len())
        .position(|window| window == level_shapes);
    bytes[at.unwrap() + 9] = 0;
    std::fs::write(&path, bytes).unwrap();
    let error = runtime
        .session(&path, &SessionOptions::default())
        .unwrap_err();
    assert!(error.to_string().contains("level"), "{error}");
}

#[test]
fn a_provider_that_the_library_lacks_is_refused_and_not_replaced() {
    let runtime = Runtime::locate(None).unwrap();
    let built_in = runtime.providers();
    assert!(built_in.contains(&Provider::Cpu));
    let lacking: Vec<_> = Provider::ALL
        .into_iter()
        .filter(|p| !built_in.contains(p))
        .collect();
    assert!(
        !lacking.is_empty(),
        "no library has the providers of every maker"
    );
    for provider in lacking {
        let options = SessionOptions::default().with_provider(provider);
        let error = runtime
            .session(&fixture("deformable_sampling.onnx"), &options)
            .unwrap_err();
        assert!(matches!(error, Error::Provider { .. }), "{error}");
    }
}

#[test]
fn the_loaded_library_says_what_it_is() {
    let runtime = Runtime::locate(None).unwrap();
    assert!(runtime.library().is_file());
    assert!(!runtime.found_in().is_empty());
    let version = runtime.version().unwrap();
    let name = runtime.library().display().to_string();
    assert!(version.starts_with("1."), "{version}");
    assert!(
        !name.contains(".so.") || name.contains(&version),
        "{name} is {version}"
    );
    assert!(!runtime.build().is_empty());
}

#[test]
fn a_second_library_is_refused() {
    Runtime::locate(None).unwrap();
    let error = Runtime::locate(Some(Path::new("/other/libonnxruntime.so"))).unwrap_err();
    assert!(error.to_string().contains("already loaded"), "{error}");
}
