use std::fmt;
use std::io;
use std::path::PathBuf;

/// Result of this crate's functions.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Everything that can go wrong.
///
/// Each text is one complete sentence: the thing, what was expected, what came and, where there is
/// one, the fix. Causes are part of the sentence, so there is no chain to print.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read.
    #[error("cannot read {}: {cause}", path.display())]
    Read { path: PathBuf, cause: io::Error },

    /// A rig that is refused; `origin` is its file, or `rig` where it came as text.
    #[error("{origin}: {problem}")]
    Rig { origin: String, problem: String },

    /// Coefficients that fit no lens.
    #[error("{0}")]
    Distortion(String),

    /// An image file that cannot be used.
    #[error("image {} of camera `{camera}`: {problem}", path.display())]
    Image {
        camera: String,
        path: PathBuf,
        problem: String,
    },

    /// An array of the wrong shape.
    #[error("{name}: expected {expected}, got {got:?}")]
    Shape {
        name: &'static str,
        expected: String,
        got: Vec<usize>,
    },

    /// No ONNX Runtime library could be loaded.
    #[error(
        "no usable ONNX Runtime library ({}), install one with `pip install onnxruntime` or name \
         its file in ORT_DYLIB_PATH",
        list(attempts)
    )]
    RuntimeMissing { attempts: Vec<Attempt> },

    /// An ONNX Runtime library that was asked for cannot be used.
    #[error("ONNX Runtime library {}: {problem}", path.display())]
    Runtime { path: PathBuf, problem: String },

    /// An execution provider that the loaded library does not offer.
    #[error("execution provider `{provider}`: {problem}")]
    Provider { provider: String, problem: String },

    /// A network that could not be loaded or run.
    #[error("network {}: {problem}", path.display())]
    Network { path: PathBuf, problem: String },

    /// A model bundle that is refused; `path` is the file at fault.
    #[error("model bundle {}: {problem}", path.display())]
    Bundle { path: PathBuf, problem: String },

    /// Arguments that do not fit each other: images and rig, boxes and model.
    #[error("{0}")]
    Input(String),

    /// A pose that the network gives but that is none.
    #[error("{0}; the model bundle is broken, restore it or export it again")]
    Pose(String),

    /// Six numbers that span no rotation.
    #[error(
        "6D rotation {0:?}: its two columns must be finite, non-zero and not parallel to each other"
    )]
    Rotation6d([f64; 6]),

    /// A file of boxes or of the truth that is refused.
    #[error("{}: {problem}", path.display())]
    Annotations {
        /// The file.
        path: PathBuf,
        /// What was expected and what came.
        problem: String,
    },

    /// A camera that the rig does not have.
    #[error("{role}: no camera `{id}` in the rig, expected one of: {}", known.join(", "))]
    UnknownCamera {
        /// What the camera was named for.
        role: String,
        /// Its id.
        id: String,
        /// Ids of the rig's cameras.
        known: Vec<String>,
    },

    /// A class that the model does not know.
    #[error("{role}: no class `{class}` in the model, expected one of: {}", known.join(", "))]
    UnknownClass {
        /// What the class was named for.
        role: String,
        /// Its name.
        class: String,
        /// Names of the model's classes.
        known: Vec<String>,
    },

    /// An image of another size than its camera's.
    #[error(
        "camera `{camera}`: expected an image of {}x{} px as in the rig, got {}x{}",
        expected[0], expected[1], got[0], got[1]
    )]
    ImageSize {
        /// Id of the camera.
        camera: String,
        /// Width and height in the rig, px.
        expected: [u32; 2],
        /// Width and height of the image, px.
        got: [u32; 2],
    },

    /// Fewer images than are asked for.
    #[error("images: expected at least {expected}, got {got}")]
    TooFewImages {
        /// One, or the fewest views of an object that are asked for.
        expected: usize,
        /// The number of images.
        got: usize,
    },
}

/// An ONNX Runtime library that was found but could not be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attempt {
    /// The library's file.
    pub path: PathBuf,
    /// The place of the search that it came from.
    pub found_in: String,
    /// Why it could not be used.
    pub problem: String,
}

impl fmt::Display for Attempt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (path, found_in) = (self.path.display(), &self.found_in);
        write!(f, "{path} (from {found_in}) {}", self.problem)
    }
}

fn list(attempts: &[Attempt]) -> String {
    if attempts.is_empty() {
        return "none found in the usual places".into();
    }
    let attempts: Vec<_> = attempts.iter().map(Attempt::to_string).collect();
    attempts.join("; ")
}
