//! One error for the whole crate: a sentence to read, a kind and a cause to match on.

use std::io;
use std::path::{Path, PathBuf};

use mvtop_geometry::Error as Geometry;

/// Result of this crate's functions.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Everything that can go wrong.
///
/// Each text is one complete sentence: the thing, what was expected, what came and, where there is
/// one, the fix. Causes are part of the sentence, so there is no chain to print: `source()` is for
/// programs that match on it, as [`Error::kind`] is.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // of fields: the sentences say what they are
pub enum Error {
    /// Of a camera, a rig, a transform, or a file that could not be read.
    #[error(transparent)]
    Geometry(#[from] Geometry),

    /// A file or folder that could not be written.
    #[error("cannot {action} {}: {cause}", path.display())]
    Write {
        /// What could not be done with it: `write`.
        action: &'static str,
        path: PathBuf,
        #[source]
        cause: io::Error,
    },

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
    RuntimeMissing {
        /// Libraries that were found, where, and why they could not be used.
        attempts: Vec<String>,
    },

    /// An ONNX Runtime library that was asked for cannot be used.
    #[error("ONNX Runtime library {}: {problem}", path.display())]
    Runtime { path: PathBuf, problem: String },

    /// An execution provider that the loaded library does not offer.
    #[error("execution provider `{provider}`: {problem}")]
    Provider { provider: String, problem: String },

    /// A network that could not be loaded or run.
    #[error("network {}: {problem}", path.display())]
    Network { path: PathBuf, problem: String },

    /// A model bundle that is refused.
    #[error("model bundle {}: {problem}", path.display())]
    Bundle { path: PathBuf, problem: String },

    /// Arguments that do not fit each other: images and rig, boxes and model.
    #[error("{0}")]
    Input(String),

    /// A pose that the network gives but that is none.
    #[error("{0}; the model bundle is broken, restore it or export it again")]
    Pose(String),

    /// A data set's file or folder that holds something else than it should.
    #[error("{0}")]
    Data(String),

    /// A file of true poses that is refused.
    #[error("{}: {problem}", path.display())]
    Annotations {
        path: PathBuf,
        /// Which object, what was expected and what came.
        problem: String,
    },

    /// A class that the model does not know.
    #[error("{role}: no class `{class}` in the model, expected one of: {}", known.join(", "))]
    UnknownClass {
        role: String,
        class: String,
        known: Vec<String>,
    },

    /// An image of another size than its camera's.
    #[error(
        "camera `{camera}`: expected an image of {}x{} px as in the rig, got {}x{}",
        expected[0], expected[1], got[0], got[1]
    )]
    ImageSize {
        camera: String,
        expected: [u32; 2],
        got: [u32; 2],
    },

    /// A computation that was asked to end, see [`crate::cancel`].
    #[error("interrupted before it was done, as was asked")]
    Interrupted,

    /// Fewer images than are asked for.
    #[error("{}", too_few_images(*expected, *got))]
    TooFewImages {
        /// One, or the fewest views of an object that are asked for.
        expected: usize,
        got: usize,
    },
}

/// What an [`Error`] is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// A file could not be read or written.
    Io,
    /// A camera, its intrinsics or its projection.
    Camera,
    /// A rig of cameras.
    Rig,
    /// A rigid transform that was given.
    Transform,
    /// An image file.
    Image,
    /// An array's shape.
    Shape,
    /// ONNX Runtime: not found, too old, or another one.
    Runtime,
    /// An execution provider of ONNX Runtime.
    Provider,
    /// A network that cannot be loaded or run.
    Network,
    /// A model bundle.
    Bundle,
    /// Arguments that do not fit each other.
    Input,
    /// A data file that holds something else than it should.
    Data,
    /// A pose or rotation that is none.
    Pose,
    /// It was asked to end.
    Interrupted,
}

impl Error {
    /// What it is about, to match on.
    ///
    /// ```
    /// use mvtop_core::{Error, ErrorKind, Rig};
    ///
    /// let error = Error::from(Rig::from_json("{").unwrap_err());
    /// assert_eq!(error.kind(), ErrorKind::Rig);
    /// assert!(std::error::Error::source(&error).is_some_and(|cause| cause.is::<serde_json::Error>()));
    /// ```
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Geometry(cause) => match cause {
                Geometry::Read { .. } => ErrorKind::Io,
                Geometry::Json { .. } => ErrorKind::Data,
                Geometry::Rig { .. } => ErrorKind::Rig,
                Geometry::Camera(_) => ErrorKind::Camera,
                Geometry::Transform { .. } => ErrorKind::Transform,
                Geometry::Rotation6d(_) => ErrorKind::Pose,
                _ => ErrorKind::Input,
            },
            Self::Write { .. } => ErrorKind::Io,
            Self::Image { .. } => ErrorKind::Image,
            Self::Shape { .. } => ErrorKind::Shape,
            Self::RuntimeMissing { .. } | Self::Runtime { .. } => ErrorKind::Runtime,
            Self::Provider { .. } => ErrorKind::Provider,
            Self::Network { .. } => ErrorKind::Network,
            Self::Bundle { .. } => ErrorKind::Bundle,
            Self::Input(_)
            | Self::UnknownClass { .. }
            | Self::ImageSize { .. }
            | Self::TooFewImages { .. } => ErrorKind::Input,
            Self::Data(_) | Self::Annotations { .. } => ErrorKind::Data,
            Self::Pose(_) => ErrorKind::Pose,
            Self::Interrupted => ErrorKind::Interrupted,
        }
    }

    /// For `map_err`: a file or folder that could not be read.
    pub fn read(path: &Path) -> impl Fn(io::Error) -> Self {
        let read = Geometry::read(path);
        move |cause| read(cause).into()
    }

    /// For `map_err`: a file or folder that could not be written.
    ///
    /// - `action`: what could not be done with it, `write`
    pub fn write(action: &'static str, path: &Path) -> impl Fn(io::Error) -> Self {
        let path = path.to_owned();
        move |cause| Self::Write {
            action,
            path: path.clone(),
            cause,
        }
    }
}

/// A sentence that is safe to print: one line, whatever the names of files and objects in it hold.
///
/// What else could mislead is written as in [`harmless`].
///
/// ```
/// let name = "a\u{1b}[31m\u{7}.json";
/// assert_eq!(mvtop_core::error::printable(&format!("{name}:\n  none")), r"a\u001b[31m\u0007.json: none");
/// ```
pub fn printable(sentence: &str) -> String {
    let words: Vec<&str> = sentence.split_whitespace().collect();
    harmless(&words.join(" "))
}

/// Lines that are safe to print: control characters, by which a terminal can be made to show something
/// else, and those that are not seen are written as JSON escapes them, so that JSON stays the same.
///
/// ```
/// assert_eq!(mvtop_core::error::harmless("\"\u{9b}31m\"\n"), "\"\\u009b31m\"\n");
/// assert_eq!(mvtop_core::error::harmless("a\u{e0061}"), r"a\udb40\udc61");
/// ```
pub fn harmless(text: &str) -> String {
    let mut lines = String::with_capacity(text.len());
    for c in text.chars() {
        match c != '\n' && misleads(c) {
            true => {
                for unit in c.encode_utf16(&mut [0; 2]) {
                    lines.push_str(&format!("\\u{unit:04x}"));
                }
            }
            false => lines.push(c),
        }
    }
    lines
}

/// Whether a character moves a terminal's cursor, turns the direction of writing or is not seen, which
/// no name should: Unicode's categories Cc, Cf, Zl and Zp.
///
/// Source: <https://www.unicode.org/Public/17.0.0/ucd/extracted/DerivedGeneralCategory.txt>.
pub(crate) fn misleads(c: char) -> bool {
    c.is_control()
        || matches!(
            c,
            '\u{ad}'
                | '\u{600}'..='\u{605}'
                | '\u{61c}'
                | '\u{6dd}'
                | '\u{70f}'
                | '\u{890}'..='\u{891}'
                | '\u{8e2}'
                | '\u{180e}'
                | '\u{200b}'..='\u{200f}'
                | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}'
                | '\u{feff}'
                | '\u{fff9}'..='\u{fffb}'
                | '\u{110bd}'
                | '\u{110cd}'
                | '\u{13430}'..='\u{1343f}'
                | '\u{1bca0}'..='\u{1bca3}'
                | '\u{1d173}'..='\u{1d17a}'
                | '\u{e0001}'
                | '\u{e0020}'..='\u{e007f}'
        )
}

fn too_few_images(expected: usize, got: usize) -> String {
    match got {
        0 => "no image given: expected at least one".into(),
        _ => format!(
            "fewest views of an object: expected at most {got}, as there are images, got {expected}"
        ),
    }
}

fn list(attempts: &[String]) -> String {
    if attempts.is_empty() {
        return "none found in the usual places".into();
    }
    attempts.join("; ")
}
