//! What a file states and no reader has read: nothing of it may be left out unseen, as it may be a part of a
//! lens, a place or a size.

use serde_json::Value;

use crate::lens::Lens;
use crate::node::{Node, count_of_numbers};
use crate::{Checked, Options};

/// Words in keys of what is about no lens, place or size of a camera.
const HARMLESS: &[&str] = &[
    // How well it was calibrated.
    "error",
    "rmse",
    "std",
    "deviation",
    "residual",
    "covar",
    "varian",
    "uncertain",
    "quality",
    "score",
    "converge",
    // On what.
    "board",
    "square",
    "pattern",
    "marker",
    "charuco",
    "aruco",
    "april",
    "chess",
    "checker",
    "grid",
    "corner",
    "target",
    // When and by whom.
    "date",
    "time",
    "stamp",
    "version",
    "comment",
    "note",
    "descr",
    "author",
    "software",
    "creat",
    "serial",
    "vendor",
    "manufact",
    "firmware",
    "calibrated",
    // How images are taken.
    "exposure",
    "gain",
    "fps",
    "framerate",
    "temperature",
    "shutter",
    "bright",
    "trigger",
    "depthscale",
    "depthunit",
    // Of what only rectified images have.
    "rectif",
    "undistorted",
    "newcamera",
    "optimalcamera",
    "optimalnew",
    "validpix",
    "roi",
    "baseline",
    // Of each view of the board.
    "rvecs",
    "tvecs",
    "perview",
    "objectpoints",
    "imagepoints",
    "objpoints",
    "imgpoints",
    "extrinsicparameters",
    "framecount",
    "viewcount",
    "imagecount",
    // Of a camera's sensor and optics, in millimetres.
    "pixelsize",
    "pixelpitch",
    "sensorsize",
    "sensorwidth",
    "sensorheight",
    "focallength",
    "aperture",
    "aspectratio",
    "distance",
    "overlap",
    "flag",
    "iteration",
];
/// The same, as whole keys, of anything but an object.
const HARMLESS_KEYS: &[&str] = &[
    "rms",
    "id",
    "ids",
    "index",
    "idx",
    "number",
    "no",
    "num",
    "name",
    "names",
    "label",
    "cam",
    "camera",
    "cameraid",
    "camid",
    "cameraname",
    "camname",
    "port",
    "channel",
    "group",
    "camgroup",
    "cameragroup",
    "key",
    "count",
    "views",
    "nviews",
    "nimages",
    "nframes",
    "numimages",
    "numviews",
    "numframes",
    "numcameras",
    "numcams",
    "ncams",
    "ncameras",
    "nbcamera",
    "nrofframes",
    "imagenames",
    "images",
    "files",
    "hfov",
    "vfov",
    "fovx",
    "fovy",
    "ignore",
    "enabled",
    "valid",
    "ok",
    "success",
    "tag",
    "tags",
    "device",
    "deviceid",
    "source",
    "sensor",
    "typeid",
    "bits",
    "depth",
    "format",
    "panel",
    "node",
    "ret",
    "retval",
    "mse",
];
/// Matrices of rectified images and of pairs, and how many numbers they have; a camera's name may follow.
const RECTIFIED: &[(&str, usize)] = &[
    ("r", 9),
    ("rect", 9),
    ("rrect", 9),
    ("rectr", 9),
    ("p", 12),
    ("prect", 12),
    ("rectp", 12),
    ("proj", 12),
    ("projectionmatrix", 12),
    ("q", 16),
    ("e", 9),
    ("f", 9),
    ("essentialmatrix", 9),
    ("fundamentalmatrix", 9),
];
/// What a flag that is on says of an image or a lens.
const TURNING: &[&str] = &[
    "lens", "dist", "fisheye", "omni", "wide", "mirror", "flip", "rotat", "invert", "inverse",
    "transpos", "opengl",
];
/// Axes of other programs, in which nothing is read unless the format has them.
const AXES: &[&str] = &[
    "opengl", "blender", "unity", "unreal", "maya", "arkit", "yup", "directx",
];
/// Words in keys about cameras, in files with many keys of other kinds.
const SUSPICIOUS: &[&str] = &[
    "dist",
    "coef",
    "lens",
    "fisheye",
    "radial",
    "tangential",
    "mirror",
    "prism",
    "extrinsic",
    "bodyt",
    "worldcam",
];

/// Refuses an object with something that was not read.
///
/// - `known`: keys that were read
pub fn refuse(node: &Node, known: &[&str], options: &Options) -> Checked<()> {
    let entries = node.entries();
    let rest = entries.iter().filter(|(key, _)| !known.contains(key));
    let unread = rest.filter(|(key, inner)| matters(key, inner.value));
    refuse_all(unread.map(|(key, _)| (*key).to_owned()), options)
        .map_err(|problem| format!("{}: {problem}", node.place))
}

/// Refuses these keys, each with the name of its camera before it where it has one.
pub fn refuse_all(unread: impl Iterator<Item = String>, options: &Options) -> Checked<()> {
    match unread
        .filter(|path| !options.ignores(path))
        .collect::<Vec<_>>()
    {
        unread if unread.is_empty() => Ok(()),
        unread => Err(sentence(&unread)),
    }
}

/// The same of a file with many keys of other kinds: refuses those alone whose words are of cameras.
pub fn refuse_suspicious(node: &Node, known: &[&str], options: &Options) -> Checked<()> {
    let entries = node.entries();
    let others = entries.iter().map(|(key, _)| *key);
    let others = others.filter(|key| !is_suspicious(key));
    let known: Vec<&str> = known.iter().copied().chain(others).collect();
    refuse(node, &known, options)
}

/// Whether a key has words of lenses and places.
pub fn is_suspicious(key: &str) -> bool {
    let plain = plain(key);
    ["xi", "skew", "alpha", "beta"].contains(&plain.as_str())
        || is_coefficient(&plain)
        || SUSPICIOUS.iter().any(|word| plain.contains(word))
}

fn sentence(paths: &[String]) -> String {
    let named: Vec<_> = paths
        .iter()
        .take(4)
        .map(|path| format!("`{path}`"))
        .collect();
    let first = paths.first().and_then(|path| path.rsplit(": ").next());
    let (keys, are, it) = match paths.len() {
        1 => ("the key", "is", "it"),
        _ => ("the keys", "are", "them"),
    };
    format!(
        "{keys} {}{} {are} not known and may state a lens, a place or a size; give {it} by a name that \
         docs/how-to/import-a-calibration.md lists, or, if there is none of these in {it}, `ignore` (--ignore {})",
        named.join(", "),
        if paths.len() > named.len() {
            ", ..."
        } else {
            ""
        },
        first.unwrap_or("KEY")
    )
}

/// Whether a key is not harmless and its value states something.
pub fn matters(key: &str, value: &Value) -> bool {
    if is_harmless(key, value) {
        return false;
    }
    match value {
        Value::Object(map) if !map.contains_key("data") => {
            map.iter().any(|(inner, value)| matters(inner, value))
        }
        Value::Array(list) if list.iter().any(Value::is_object) => {
            list.iter().any(|value| matters(key, value))
        }
        value => states(key, value),
    }
}

/// Whether a key is about something else than a camera's lens, place and size.
pub fn is_harmless(key: &str, value: &Value) -> bool {
    let plain = plain(key);
    let word = HARMLESS.iter().any(|word| plain.contains(word)) && !plain.contains("undistortion");
    word || (!value.is_object() && HARMLESS_KEYS.contains(&plain.as_str()))
        || is_of_rectified(&plain, value)
}

/// Whether it is a matrix of rectified images or of a pair.
fn is_of_rectified(plain: &str, value: &Value) -> bool {
    let count = count_of_numbers(value);
    let known = |name: &str| {
        let mut known = RECTIFIED.iter();
        known.any(|(known, numbers)| *known == name && count == Some(*numbers))
    };
    cuts(plain).any(|(name, _)| known(name))
}

/// A plain key as a name and the camera after it: "" where it is a name as a whole, "1" of `m1`, "left" of
/// `kleft` and `kl`.
pub fn cuts(plain: &str) -> impl Iterator<Item = (&str, &str)> {
    const SIDES: [(&str, &str); 4] = [
        ("left", "left"),
        ("right", "right"),
        ("l", "left"),
        ("r", "right"),
    ];
    let digits = plain.trim_end_matches(|c: char| c.is_ascii_digit());
    let sides = SIDES
        .iter()
        .filter_map(|(end, side)| Some((plain.strip_suffix(end)?, *side)));
    [(plain, ""), (digits, &plain[digits.len()..])]
        .into_iter()
        .chain(sides)
}

/// Whether a value states anything: numbers that are not 0, also as text; the name of a lens or of axes; a
/// flag that turns images or lenses.
fn states(key: &str, value: &Value) -> bool {
    match value {
        Value::Null => false,
        Value::Bool(on) => *on && TURNING.iter().any(|word| plain(key).contains(word)),
        Value::Number(number) => number.as_f64() != Some(0.0),
        Value::String(text) => {
            is_numbers(text) || names_a_lens(text) || AXES.iter().any(|axes| plain(text) == *axes)
        }
        Value::Array(list) => list.iter().any(|value| states(key, value)),
        Value::Object(map) => map.get("data").is_some_and(|data| states(key, data)),
    }
}

/// Whether text is numbers, one of them not 0.
fn is_numbers(text: &str) -> bool {
    let words = text.split(|c: char| c.is_whitespace() || ",;[]()".contains(c));
    let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
    let number = |word: &&str| word.trim_start_matches('.').parse::<f64>();
    !words.is_empty()
        && words.iter().all(|word| number(word).is_ok())
        && words.iter().any(|word| number(word) != Ok(0.0))
}

/// Whether text is a lens by name, other than a pinhole with or without OpenCV's distortion.
pub fn names_a_lens(text: &str) -> bool {
    let plain = plain(text);
    !plain.is_empty()
        && (Lens::named(text, &[0.0; 4]).is_ok_and(|lens| lens.is_fisheye())
            || [
                "fisheye",
                "equidist",
                "kannala",
                "omni",
                "doublesphere",
                "scaramuzza",
                "thinprism",
                "unified",
            ]
            .iter()
            .any(|name| plain.contains(name))
            || [
                "mei", "eucm", "ds", "kb", "kb4", "kb8", "ucm", "fov", "ftheta",
            ]
            .contains(&plain.as_str()))
}

/// Whether a key is a coefficient by its letter and number.
fn is_coefficient(plain: &str) -> bool {
    let base = plain.trim_end_matches(|c: char| c.is_ascii_digit());
    base.len() < plain.len() && ["k", "p", "s", "l"].contains(&base)
}

/// A key without case and signs.
pub fn plain(key: &str) -> String {
    let letters = key.chars().filter(|c| c.is_alphanumeric());
    letters.flat_map(char::to_lowercase).collect()
}
