use std::ffi::OsString;
use std::path::PathBuf;

use pyo3::prelude::*;

use crate::process::compute;

/// The command line `mvtop-cli`: `args` begin with the program's name. Returns the exit code.
///
/// Parameters
/// ----------
/// shipped
///     The folder with the package's model and example.
/// library
///     Of ONNX Runtime, used where none is named; searched for by default.
#[pyfunction]
#[pyo3(signature = (args, shipped, library = None))]
pub fn run_cli(
    py: Python,
    args: Vec<OsString>,
    shipped: PathBuf,
    library: Option<PathBuf>,
) -> PyResult<u8> {
    mvtop_cli::ship(shipped, library);
    compute(py, || mvtop_cli::run(args))
}
