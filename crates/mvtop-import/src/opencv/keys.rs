//! What keys are called, and which camera they are of.

use serde_json::{Map, Value};

use super::names::{NAMED, NAMES};
use crate::lens::Lens;
use crate::node::count_of_numbers;
use crate::unread::{cuts, names_a_lens, plain};
use crate::{Direction, ImageSize};

/// What OpenCV's axes of a camera are called: x right, y down, z forward.
const AXES: &[&str] = &[
    "opencv",
    "cv",
    "rdf",
    "rightdownforward",
    "xrightydownzforward",
];
/// What the unit of length is called.
const UNITS: &[&str] = &[
    "unit",
    "units",
    "lengthunit",
    "unitoflength",
    "worldunit",
    "worldunits",
    "translationunit",
    "distanceunit",
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
/// Whether an object of that key is about a lens, so that its name is the lens'.
pub fn is_of_lens(key: &str) -> bool {
    let plain = plain(key);
    plain.starts_with("distortion")
        || [
            "lens",
            "model",
            "lensmodel",
            "cameramodel",
            "lensdistortion",
            "projection",
        ]
        .contains(&plain.as_str())
}

/// Objects that are about the camera around them, by how their keys begin.
const SECTIONS: &[&str] = &["intrinsic", "extrinsic", "distortion", "calib", "param"];
/// The same, by their whole keys.
const WHOLE_SECTIONS: &[&str] = &[
    "cameras",
    "metadata",
    "meta",
    "pose",
    "transform",
    "size",
    "imagesize",
    "resolution",
];

/// Which of the names a key is, and what it says of which camera: "1" of `M1`, "left" of `K_left` and `K_l`.
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
    cuts(&plain).find_map(|(base, of)| {
        let known = |(name, names): &&(&str, &[&str])| names.contains(&base) && fits(name, value);
        let (name, _) = NAMES.iter().find(known)?;
        Some((field(name), of.to_owned()))
    })
}

/// The field that a name is of.
fn field(name: &'static str) -> &'static str {
    if name == NAMED { "model" } else { name }
}

/// Whether a value may be what its key is called.
fn fits(name: &str, value: &Value) -> bool {
    let objects = || {
        value
            .as_array()
            .is_some_and(|list| list.iter().any(Value::is_object))
    };
    let list = || count_of_numbers(value).is_some() && !objects();
    match name {
        "K" => count_of_numbers(value) == Some(9),
        "width" | "height" => value
            .as_f64()
            .is_some_and(|side| side >= 2.0 && side.fract() == 0.0),
        "model" => value.is_string(),
        NAMED => value.as_str().is_some_and(|text| {
            names_a_lens(text) || (!text.is_empty() && Lens::named(text, &[0.0; 4]).is_ok())
        }),
        "fisheye" => is_yes(value).is_some(),
        "direction" => value.as_str().and_then(direction).is_some(),
        "axes" => value
            .as_str()
            .is_some_and(|text| AXES.contains(&&*plain(text))),
        "roi" => {
            count_of_numbers(value) == Some(4) || value.get("width").is_some_and(Value::is_number)
        }
        "size" => list() || value.as_str().and_then(size_of_text).is_some(),
        _ => list(),
    }
}

/// What a value says that is yes or no.
pub fn is_yes(value: &Value) -> Option<bool> {
    match value {
        Value::Bool(yes) => Some(*yes),
        Value::Number(number) => Some(number.as_f64() != Some(0.0)),
        Value::String(text) => match text.to_lowercase().as_str() {
            "true" | "yes" | "on" => Some(true),
            "false" | "no" | "off" => Some(false),
            _ => None,
        },
        _ => None,
    }
}

/// What a text says that places map to what: `camera_to_world`, as a matrix may be called as well.
pub fn direction(text: &str) -> Option<Direction> {
    let plain = plain(text);
    let (name, _) = NAMES.iter().find(|(_, names)| names.contains(&&*plain))?;
    Direction::named(name)
}

/// Width and height of `1280x960`.
pub fn size_of_text(text: &str) -> Option<[u32; 2]> {
    let size = ImageSize::parse(text)?;
    size.camera.is_none().then_some(size.size)
}

/// Whether a key says the unit of length.
pub fn is_unit(key: &str) -> bool {
    UNITS.contains(&plain(key).as_str())
}

/// A document by kinds (`{"K": {"left": ...}, "dist": {"left": ...}}`) as one by cameras (`{"left": {"K": ...,
/// "dist": ...}}`).
pub fn by_camera(value: Value) -> Value {
    let Value::Object(map) = value else {
        return value;
    };
    let mut cameras = Map::new();
    let mut kinds = Vec::new();
    for (key, inner) in map {
        let inner = by_camera(inner);
        match kind_of_cameras(&key, &inner) {
            Some(field) => kinds.push((key, field, inner)),
            None => {
                cameras.insert(key, inner);
            }
        }
    }
    for (key, field, inner) in kinds {
        let Value::Object(of_cameras) = inner else {
            continue;
        };
        // What is called like one of them and is no object leaves no room for it.
        let mut names = of_cameras.keys();
        if !names.all(|camera| cameras.get(camera).is_none_or(Value::is_object)) {
            cameras.insert(key, Value::Object(of_cameras));
            continue;
        }
        for (camera, value) in of_cameras {
            let own = cameras
                .entry(camera)
                .or_insert_with(|| Value::Object(Map::new()));
            if let Value::Object(own) = own {
                let twice = own.contains_key(field);
                own.insert(if twice { key.clone() } else { field.to_owned() }, value);
            }
        }
    }
    Value::Object(cameras)
}

/// What an object has of each camera by the camera's name, if it has nothing else.
fn kind_of_cameras(key: &str, value: &Value) -> Option<&'static str> {
    let cameras = value.as_object()?;
    if cameras.is_empty() || cameras.contains_key("data") {
        return None;
    }
    let plain = plain(key).replace("matrices", "matrix");
    let names = [plain.as_str(), plain.trim_end_matches('s')];
    let known = |(_, known): &&(&str, &[&str])| names.iter().any(|name| known.contains(name));
    let (name, _) = NAMES.iter().find(known)?;
    let of_cameras =
        |(key, value): (&String, &Value)| split(key, value).is_none() && fits(name, value);
    cameras.iter().all(of_cameras).then_some(field(name))
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

/// Whether a document has a list of camera matrices, as lists of one thing of all cameras have.
pub fn has_matrices_in_a_list(value: &Value) -> bool {
    let matrices = |value: &Value| {
        let list = value.as_array().filter(|list| list.len() > 1);
        list.is_some_and(|list| list.iter().all(|one| count_of_numbers(one) == Some(9)))
    };
    let of_k = |key: &String| {
        let plain = plain(key);
        let names = [plain.as_str(), plain.trim_end_matches('s')];
        let mut known = NAMES.iter().filter(|(name, _)| *name == "K");
        known.any(|(_, known)| names.iter().any(|name| known.contains(name)))
    };
    let mut all = value.as_object().into_iter().flatten();
    all.any(|(key, value)| of_k(key) && matrices(value))
}
