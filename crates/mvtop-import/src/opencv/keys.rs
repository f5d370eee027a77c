//! What keys are called, which camera they are of, and which of two comes first.

use serde_json::Value;

use crate::node::count_of_numbers;

/// What programs call the same thing, without case and underscores.
const NAMES: &[(&str, &[&str])] = &[
    (
        "K",
        &[
            "k",
            "m",
            "cameramatrix",
            "mtx",
            "intrinsicmatrix",
            "intrinsics",
            "intrinsic",
            "cammatrix",
        ],
    ),
    (
        "D",
        &[
            "d",
            "dist",
            "distcoeffs",
            "distcoeff",
            "distortion",
            "distortioncoefficients",
            "distortioncoeffs",
            "distortions",
            "distortionvector",
            "distortionparameters",
            "distcoef",
            "distcoefs",
            "coeffs",
            "coefficients",
            // Bouguet's toolbox, which OpenCV's order is from.
            "kc",
        ],
    ),
    ("R", &["r", "rmat", "rotation", "rotationmatrix"]),
    ("T", &["t", "translation", "translationvector", "tvec"]),
    ("rvec", &["rvec", "rotationvector", "om"]),
    (
        "size",
        &[
            "size",
            "imagesize",
            "resolution",
            "imgsize",
            "imgshape",
            "imageshape",
            "shape",
        ],
    ),
    ("width", &["width", "imagewidth"]),
    ("height", &["height", "imageheight"]),
    (
        "model",
        &["model", "cameramodel", "distortionmodel", "lensmodel"],
    ),
    ("fisheye", &["fisheyemodel", "fisheye", "isfisheye"]),
    (
        "world_from_cam",
        &[
            "worldfromcam",
            "tworldcam",
            "camtoworld",
            "cam2world",
            "c2w",
        ],
    ),
    (
        "cam_from_world",
        &[
            "camfromworld",
            "tcamworld",
            "worldtocam",
            "world2cam",
            "w2c",
        ],
    ),
    ("pose", &["pose", "extrinsic", "extrinsics", "transform"]),
];

/// Coefficients and focal lengths that have a key each; the first name is the field's.
const NUMBERS: &[(&str, &[&str])] = &[
    ("fx", &["fx"]),
    ("fy", &["fy"]),
    ("cx", &["cx", "ppx", "u0"]),
    ("cy", &["cy", "ppy", "v0"]),
    ("xi", &["xi"]),
    ("k1", &["k1"]),
    ("k2", &["k2"]),
    ("k3", &["k3"]),
    ("k4", &["k4"]),
    ("k5", &["k5"]),
    ("k6", &["k6"]),
    ("p1", &["p1"]),
    ("p2", &["p2"]),
];
/// Objects that are about the camera around them, by how their keys begin.
const SECTIONS: &[&str] = &["intrinsic", "extrinsic", "distortion", "calib", "param"];
/// The same, by their whole keys.
const WHOLE_SECTIONS: &[&str] = &[
    "cameras",
    "pose",
    "transform",
    "size",
    "imagesize",
    "resolution",
];

/// What a key is about that is none of the names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum About {
    Lens,
    Place,
    Size,
}

/// A key without case and signs.
fn plain(key: &str) -> String {
    let letters = key.chars().filter(|c| c.is_alphanumeric());
    letters.flat_map(char::to_lowercase).collect()
}

/// Which of the names a key is, and what it says of which camera: "1" of `M1`, "left" of `K_left`.
///
/// A value tells as well: a camera matrix is 3x3, and `k1` is a coefficient where it is a number.
pub fn split(key: &str, value: &Value) -> Option<(&'static str, String)> {
    let plain = plain(key);
    if value.is_number() {
        let known = NUMBERS
            .iter()
            .find(|(_, names)| names.contains(&plain.as_str()));
        if let Some((name, _)) = known {
            return Some((name, String::new()));
        }
    }
    let endings = ["left", "right", "l", "r"];
    let digits = plain.trim_end_matches(|c: char| c.is_ascii_digit());
    let mut cuts = vec![plain.as_str()];
    cuts.push(digits);
    cuts.extend(endings.iter().filter_map(|end| plain.strip_suffix(end)));
    cuts.into_iter().find_map(|base| {
        let known = NAMES.iter().find(|(_, names)| names.contains(&base));
        let (name, _) = known.filter(|(name, _)| fits(name, value))?;
        Some((*name, plain[base.len()..].to_owned()))
    })
}

/// Whether a value may be what its key is called.
fn fits(name: &str, value: &Value) -> bool {
    match name {
        "K" => count_of_numbers(value) == Some(9),
        "width" | "height" => value.is_number(),
        "model" => value.is_string(),
        "fisheye" => value.is_boolean() || value.is_number(),
        _ => value.is_array() || value.get("data").is_some(),
    }
}

/// Whether an object is about the camera around it, or a list of cameras.
pub fn is_section(key: &str, value: &Value) -> bool {
    let nested = match value {
        Value::Object(map) => !map.contains_key("data"),
        Value::Array(list) => list.iter().all(Value::is_object),
        _ => false,
    };
    let plain = plain(key);
    nested
        && (WHOLE_SECTIONS.contains(&plain.as_str())
            || SECTIONS.iter().any(|section| plain.starts_with(section)))
}

/// What a key that is none of the names states, if anything: what is left out must not change a camera.
pub fn about(key: &str, value: &Value) -> Option<About> {
    let plain = plain(key);
    let has = |words: &[&str]| words.iter().any(|word| plain.contains(word));
    let base = plain.trim_end_matches(|c: char| c.is_ascii_digit());
    let numbered = base.len() < plain.len();
    let names_lens = match value {
        // A name of a lens, but not of who made it.
        Value::String(_) => has(&["model", "type"]) && has(&["lens", "dist", "projection"]),
        _ => {
            (base.contains("dist") && !base.contains("distance"))
                || has(&["coef", "lens", "fisheye", "radial", "tangential", "mirror"])
                || [
                    "kc", "xi", "alpha", "alphac", "beta", "skew", "tau", "taux", "tauy",
                ]
                .contains(&base)
                || (numbered && value.is_number() && ["k", "p", "s", "l"].contains(&base))
        }
    };
    let measured = has(&["undistort", "std", "deviation", "error"]);
    if measured || !states(value) {
        None
    } else if names_lens {
        Some(About::Lens)
    } else if value.is_string()
        || has(&[
            "board", "square", "grid", "pattern", "marker", "tag", "sensor", "pixel", "vecs",
        ])
    {
        None
    } else if has(&["width", "height", "size", "shape", "resolution"]) {
        Some(About::Size)
    } else if has(&[
        "rot",
        "trans",
        "pose",
        "extrinsic",
        "quat",
        "position",
        "orientation",
        "rvec",
        "tvec",
        "euler",
    ]) {
        Some(About::Place)
    } else {
        None
    }
}

/// Whether a value says anything: a number that is not 0, or a word.
fn states(value: &Value) -> bool {
    match value {
        Value::Number(number) => number.as_f64() != Some(0.0),
        Value::String(text) => !text.is_empty(),
        Value::Array(list) => list.iter().any(states),
        Value::Object(map) => match map.get("data") {
            Some(data) => states(data),
            None => map.values().any(states),
        },
        _ => false,
    }
}

/// Whether rows come before columns in a size of that name; `None` where programs differ.
pub fn rows_first(key: &str) -> Option<bool> {
    match plain(key).as_str() {
        shape if shape.contains("shape") => Some(true),
        // MATLAB's `ImageSize` is rows and columns, others' is not.
        _ if key == "ImageSize" => None,
        _ => Some(false),
    }
}

/// What a key consists of, in lower case; numbers compare by what they count, so `cam9` comes before `cam10`.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    Number(u64),
    Text(String),
}

pub fn in_parts(key: &str) -> Vec<Part> {
    let letters: Vec<char> = key.to_lowercase().chars().collect();
    let runs = letters.chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit());
    let texts = runs.map(String::from_iter);
    texts
        .map(|text| text.parse().map_or(Part::Text(text), Part::Number))
        .collect()
}

/// Whether names say that one camera comes before another: by their numbers, or as left and right.
pub fn is_in_order(first: &str, second: &str) -> bool {
    let (a, b) = (in_parts(first), in_parts(second));
    let mut differ = a.iter().zip(&b).filter(|(a, b)| a != b);
    let numbered = match (differ.next(), differ.next()) {
        (Some((Part::Number(a), Part::Number(b))), None) => a < b,
        _ => false,
    };
    let (first, second) = (first.to_lowercase(), second.to_lowercase());
    let rest = first.strip_suffix('l');
    (a.len() == b.len() && numbered)
        || (first.contains("left") && second.contains("right"))
        || rest.is_some_and(|rest| second.strip_suffix('r') == Some(rest))
}
