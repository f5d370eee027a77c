use std::path::Path;

use serde::de::DeserializeOwned;

use crate::{Error, Result};

/// Reads a file of JSON.
///
/// - `expected`: what the file should hold, for the error
///
/// # Errors
/// [`Error::Read`] where it cannot be read, [`Error::Json`] where it holds something else.
pub fn read<T: DeserializeOwned>(path: &Path, expected: &str) -> Result<T> {
    let text = std::fs::read_to_string(path).map_err(Error::read(path))?;
    serde_json::from_str(&text).map_err(|cause| Error::Json {
        path: path.to_owned(),
        expected: expected.to_owned(),
        cause,
    })
}
