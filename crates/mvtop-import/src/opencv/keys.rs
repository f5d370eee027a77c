//! What keys are called, which camera they are of, and which of two comes first.

use serde_json::{Map, Value};

use crate::lens::Lens;
use crate::node::count_of_numbers;
use crate::unread::{cuts, names_a_lens, plain};
use crate::{Direction, ImageSize};

/// What programs call the same thing, without case and underscores.
const NAMES: &[(&str, &[&str])] = &[
    (
        "K",
        &[
            "k",
            "m",
            "a",
            "kk",
            "mtx",
            "cameramatrix",
            "cammatrix",
            "intrinsicmatrix",
            "intrinsicsmatrix",
            "calibrationmatrix",
            "intrinsics",
            "intrinsic",
            "cameraintrinsics",
            "cameraintrinsic",
        ],
    ),
    (
        "D",
        &[
            "d",
            "dist",
            "distcoeffs",
            "distcoeff",
            "distcoef",
            "distcoefs",
            "distparams",
            "distortion",
            "distortions",
            "distortioncoefficients",
            "distortioncoeffs",
            "distortionvector",
            "distortionparameters",
            "distortionparams",
            "lensdistortion",
            "coeffs",
            "coefficients",
            // Bouguet's toolbox, which OpenCV's order is from.
            "kc",
        ],
    ),
    (
        "R",
        &["r", "rot", "rmat", "rotmat", "rotation", "rotationmatrix"],
    ),
    (
        "T",
        &["t", "trans", "translation", "translationvector", "tvec"],
    ),
    ("rvec", &["rvec", "rotationvector", "om"]),
    (
        "size",
        &[
            "size",
            "imagesize",
            "imgsize",
            "resolution",
            "imageresolution",
            "imgshape",
            "imageshape",
            "shape",
            "hw",
            "wh",
            "imagehw",
            "imagewh",
            "imghw",
            "imgwh",
        ],
    ),
    (
        "width",
        &["width", "imagewidth", "imgwidth", "w", "cols", "columns"],
    ),
    (
        "height",
        &["height", "imageheight", "imgheight", "h", "rows"],
    ),
    (
        "model",
        &[
            "model",
            "cameramodel",
            "distortionmodel",
            "lensmodel",
            "distortiontype",
            "lenstype",
            "projectiontype",
            "projectionmodel",
        ],
    ),
    (
        NAMED,
        &[
            "type",
            "kind",
            "lens",
            "cameratype",
            "modeltype",
            "projection",
        ],
    ),
    ("fisheye", &["fisheyemodel", "fisheye", "isfisheye"]),
    (
        "world_from_cam",
        &[
            "worldfromcam",
            "worldfromcamera",
            "tworldcam",
            "tworldcamera",
            "worldtcam",
            "worldtcamera",
            "camtoworld",
            "cameratoworld",
            "cam2world",
            "camera2world",
            "c2w",
            "tbasecam",
            "tbasecamera",
            "basefromcam",
        ],
    ),
    (
        "cam_from_world",
        &[
            "camfromworld",
            "camerafromworld",
            "tcamworld",
            "tcameraworld",
            "camtworld",
            "cameratworld",
            "worldtocam",
            "worldtocamera",
            "world2cam",
            "world2camera",
            "w2c",
        ],
    ),
    (
        "direction",
        &[
            "direction",
            "posedirection",
            "posetype",
            "poseconvention",
            "extrinsicdirection",
            "extrinsicsdirection",
            "extrinsictype",
            "extrinsicstype",
            "extrinsicsconvention",
            "transformdirection",
            "transformtype",
        ],
    ),
    (
        "axes",
        &[
            "axes",
            "axesconvention",
            "convention",
            "coordinateconvention",
            "coordinatesystem",
            "cameraconvention",
            "cameraaxes",
        ],
    ),
    (
        "roi",
        &["roi", "imageroi", "croproi", "crop", "regionofinterest"],
    ),
    (
        "pose",
        &[
            "pose",
            "posematrix",
            "extrinsic",
            "extrinsics",
            "extrinsicmatrix",
            "extrinsicsmatrix",
            "transform",
            "rt",
        ],
    ),
];
/// What OpenCV's axes of a camera are called: x right, y down, z forward.
const AXES: &[&str] = &[
    "opencv",
    "cv",
    "rdf",
    "rightdownforward",
    "xrightydownzforward",
];
/// A model, where the value is the name of one: `lens` may be "8 mm" as well.
const NAMED: &str = "model by its value";
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

/// Whether rows come before columns in a size of that name; `None` where programs differ.
pub fn rows_first(key: &str) -> Option<bool> {
    match plain(key).as_str() {
        shape if shape.contains("shape") || shape.ends_with("hw") => Some(true),
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
