//! The core's errors as Python's exceptions, with the core's sentences.

use std::ffi::CString;
use std::io;

use mvtop_core::error::printable;
use mvtop_core::{Error, ErrorKind};
use mvtop_geometry::Error as Geometry;
use pyo3::exceptions::{PyException, PyFileNotFoundError, PyValueError};
use pyo3::prelude::*;

mod imported {
    pyo3::import_exception!(mvtop._error, Error);
    pyo3::import_exception!(mvtop._error, MvtopWarning);
}

/// `ValueError` for values and shapes, `OSError` for files that cannot be read, `mvtop.Error` for
/// the rest: what is wrong with ONNX Runtime or a model bundle.
pub fn python(error: impl Into<Error>) -> PyErr {
    let error = error.into();
    let sentence = printable(&error.to_string());
    match error {
        // Of the cause's kind, so that a missing file is a `FileNotFoundError`.
        Error::Geometry(Geometry::Read { cause, .. }) => {
            io::Error::new(cause.kind(), sentence).into()
        }
        Error::Bundle { path, .. } if !path.exists() => PyFileNotFoundError::new_err(sentence),
        Error::Geometry(Geometry::Rotation6d(_)) => value(sentence),
        error => match error.kind() {
            ErrorKind::Runtime
            | ErrorKind::Provider
            | ErrorKind::Network
            | ErrorKind::Bundle
            | ErrorKind::Pose => imported::Error::new_err(sentence),
            _ => value(sentence),
        },
    }
}

/// Python's warnings, `mvtop.MvtopWarning`, which point at the caller's line.
pub fn warn(py: Python, sentences: &[String]) -> PyResult<()> {
    for sentence in sentences {
        // What is printable has no zero byte.
        let sentence = CString::new(printable(sentence)).unwrap_or_default();
        PyErr::warn(py, &py.get_type::<imported::MvtopWarning>(), &sentence, 1)?;
    }
    Ok(())
}

/// What a conversion failed by: an interrupt as it is, what an object is not as a `ValueError`.
pub fn unless_interrupted(py: Python, cause: PyErr, sentence: String) -> PyErr {
    match cause.is_instance_of::<PyException>(py) {
        true => value(sentence),
        false => cause,
    }
}

pub fn value(sentence: String) -> PyErr {
    PyValueError::new_err(printable(&sentence))
}
