//! One error for the whole crate, each a sentence to read and a variant to match on.

use std::io;
use std::path::{Path, PathBuf};

use crate::transform::TransformError;

/// Result of this crate's functions.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Everything that can go wrong.
///
/// Each text is one complete sentence: the thing, what was expected, what came and, where there is
/// one, the fix. Causes are part of the sentence, so there is no chain to print: `source()` is for
/// programs that match on it.
///
/// ```
/// use mvtop_geometry::{Error, Rig};
///
/// let error = Rig::from_json("{").unwrap_err();
/// assert!(matches!(error, Error::Rig { .. }));
/// assert!(std::error::Error::source(&error).is_some_and(|cause| cause.is::<serde_json::Error>()));
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // of fields: the sentences say what they are
pub enum Error {
    /// A file could not be read.
    #[error("cannot read {}: {cause}", path.display())]
    Read {
        path: PathBuf,
        #[source]
        cause: io::Error,
    },

    /// A file of JSON that holds something else than it should.
    #[error("{}: expected {expected}, got: {cause}", path.display())]
    Json {
        path: PathBuf,
        expected: String,
        #[source]
        cause: serde_json::Error,
    },

    /// A rig that is refused.
    #[error("{origin}: {problem}")]
    Rig {
        /// Its file, or `rig` where it came as text or as cameras.
        origin: String,
        problem: String,
        /// Where it is no JSON.
        #[source]
        cause: Option<serde_json::Error>,
    },

    /// A camera, its intrinsics or its projection that is refused.
    #[error("{0}")]
    Camera(String),

    /// A camera that the rig does not have.
    #[error("{role}: no camera `{id}` in the rig, expected one of: {}", known.join(", "))]
    UnknownCamera {
        role: String,
        id: String,
        known: Vec<String>,
    },

    /// Numbers that are no rigid transform.
    #[error("{name}: {cause}")]
    Transform {
        name: String,
        #[source]
        cause: TransformError,
    },

    /// Six numbers that span no rotation.
    #[error(
        "6D rotation {0:?}: its two columns must be finite, non-zero and not parallel to each other"
    )]
    Rotation6d([f64; 6]),

    /// Arguments that do not fit each other.
    #[error("{0}")]
    Input(String),
}

impl Error {
    /// For `map_err`: a file or folder that could not be read.
    pub fn read(path: &Path) -> impl Fn(io::Error) -> Self {
        let path = path.to_owned();
        move |cause| Self::Read {
            path: path.clone(),
            cause,
        }
    }

    /// A rig that did not come from a file.
    pub(crate) fn rig(problem: String) -> Self {
        Self::Rig {
            origin: "rig".into(),
            problem,
            cause: None,
        }
    }
}
