//! What keys are called, which camera they are of, and which of two comes first.

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
        ],
    ),
    ("R", &["r", "rmat", "rotation", "rotationmatrix"]),
    ("T", &["t", "translation", "translationvector", "tvec"]),
    ("rvec", &["rvec", "rotationvector", "om"]),
    (
        "size",
        &["size", "imagesize", "resolution", "imgsize", "imgshape"],
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

/// Which of the names a key is, and what it says of which camera: "1" of `M1`, "left" of `K_left`.
pub fn split(key: &str) -> Option<(&'static str, String)> {
    let plain: String = key.to_lowercase().chars().filter(|c| *c != '_').collect();
    let endings = ["left", "right", "l", "r"];
    let digits = plain.trim_end_matches(|c: char| c.is_ascii_digit());
    let mut cuts = vec![plain.as_str()];
    cuts.push(digits);
    cuts.extend(endings.iter().filter_map(|end| plain.strip_suffix(end)));
    cuts.into_iter().find_map(|base| {
        let known = NAMES.iter().find(|(_, names)| names.contains(&base));
        known.map(|(name, _)| (*name, plain[base.len()..].to_owned()))
    })
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
