//! What ends a command early.

use std::fmt;

use mvtop_core::error::printable;

pub type Result<T> = std::result::Result<T, Failure>;

/// One sentence for the user.
#[derive(Debug)]
pub struct Failure(pub String);

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // One line whatever the cause, for scripts that read the last one.
        f.write_str(&printable(&self.0))
    }
}

impl From<mvtop_core::Error> for Failure {
    fn from(error: mvtop_core::Error) -> Self {
        Self(error.to_string())
    }
}

impl From<mvtop_geometry::Error> for Failure {
    fn from(error: mvtop_geometry::Error) -> Self {
        Self(error.to_string())
    }
}
