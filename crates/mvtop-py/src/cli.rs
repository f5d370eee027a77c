use std::ffi::OsString;

use pyo3::prelude::*;

/// The command line `mvtop-cli`: `args` begin with the program's name. Returns the exit code.
#[pyfunction]
pub fn run_cli(py: Python, args: Vec<OsString>) -> u8 {
    py.detach(|| mvtop_cli::run(args))
}
