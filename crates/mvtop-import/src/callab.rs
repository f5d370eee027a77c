//! DLR CalLab's files of `camera.N.KEY=VALUE`. `R` and `T` are the pose of the camera: Pw = R Pc + T.

use std::collections::BTreeMap;

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::source::Source;
use crate::{Checked, Options, unread};

/// What is read of a camera.
const KNOWN: [&str; 11] = [
    "A", "R", "T", "k1", "k2", "k3", "p1", "p2", "width", "height", "origin",
];

/// Values of a camera by their keys.
type Fields = BTreeMap<String, String>;

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut draft = Draft {
        cameras: Vec::new(),
        metres: None,
        posing: "give its R and T",
        notes: Vec::new(),
    };
    for source in sources {
        let mut cameras: BTreeMap<u32, Fields> = BTreeMap::new();
        for line in source.text()?.lines() {
            let line = line.split('#').next().unwrap_or_default();
            let Some((key, value)) = line.split_once('=') else {
                continue;
            };
            let mut parts = key.trim().splitn(3, '.');
            if parts.next() != Some("camera") {
                continue;
            }
            let number = parts.next().and_then(|number| number.parse().ok());
            if let Some((number, key)) = number.zip(parts.next()) {
                let fields = cameras.entry(number).or_default();
                let value = value.trim().to_owned();
                if fields.insert(key.trim().to_owned(), value).is_some() {
                    let name = &source.name;
                    return Err(format!("{name}: `camera.{number}.{key}` is there twice"));
                }
            }
        }
        if cameras.is_empty() {
            return Err(format!(
                "{}: expected lines as camera.0.A=[...], got none",
                source.name
            ));
        }
        for (number, fields) in cameras {
            let place = format!("{}: camera.{number}", source.name);
            draft
                .cameras
                .push(camera(&place, number, &fields, options)?);
        }
    }
    Ok(draft)
}

fn camera(place: &str, number: u32, fields: &Fields, options: &Options) -> Checked<DraftCamera> {
    let of = |problem: String| format!("{place}: {problem}");
    let numbers = |key: &str| -> Checked<Option<Vec<f64>>> {
        let Some(text) = fields.get(key) else {
            return Ok(None);
        };
        let words = text.split(|c: char| c.is_whitespace() || "[];,".contains(c));
        let parse = |word: &str| word.parse::<f64>().ok().filter(|number| number.is_finite());
        let numbers: Option<Vec<f64>> = words.filter(|word| !word.is_empty()).map(parse).collect();
        let wrong = || of(format!("`{key}` must be finite numbers, got {text:?}"));
        numbers.ok_or_else(wrong).map(Some)
    };
    let need = |key: &str| numbers(key)?.ok_or_else(|| of(format!("the key `{key}` is missing")));
    let sized = |key: &str, count: usize, got: usize| {
        of(format!("`{key}` must be {count} numbers, got {got}"))
    };
    let matrix: [f64; 9] = need("A")?
        .try_into()
        .map_err(|a: Vec<f64>| sized("A", 9, a.len()))?;
    let plane = Plane::from_matrix(matrix).map_err(of)?;
    let plane = match fields.get("origin").map(String::as_str) {
        None | Some("center") => plane,
        Some("corner") => plane.counted_from_corner(),
        Some(other) => {
            return Err(of(format!(
                "`origin` must be center or corner, got {other:?}"
            )));
        }
    };
    let one = |key: &str| -> Checked<f64> {
        let numbers = numbers(key)?.unwrap_or(vec![0.0]);
        <[f64; 1]>::try_from(numbers)
            .map(|[number]| number)
            .map_err(|n| sized(key, 1, n.len()))
    };
    let side = |key: &str| -> Checked<u32> {
        match one(key)? {
            side if side.fract() == 0.0 && (1.0..=1e9).contains(&side) => Ok(side as u32),
            side => Err(of(format!(
                "`{key}` must be a whole number of pixels, got {side}"
            ))),
        }
    };
    let unread = fields.iter().filter(|(key, text)| {
        !KNOWN.contains(&key.as_str()) && unread::matters(key, &text.as_str().into())
    });
    unread::refuse_all(unread.map(|(key, _)| key.clone()), options).map_err(of)?;
    let [k1, k2, k3] = [one("k1")?, one("k2")?, one("k3")?];
    let [p1, p2] = [one("p1")?, one("p2")?];
    if [p1, p2] != [0.0; 2] {
        // As Brown wrote them: p1 belongs to x, where OpenCV's p2 does. Not tried on a real file.
        return Err(of(
            "p1 and p2 are refused, as files differ in which of them is which; calibrate \
                       again with radial distortion only"
                .into(),
        ));
    }
    let pose = match (numbers("R")?, numbers("T")?) {
        (None, None) => None,
        (Some(r), Some(t)) => {
            let r = r.try_into().map_err(|r: Vec<f64>| sized("R", 9, r.len()))?;
            let t = t.try_into().map_err(|t: Vec<f64>| sized("T", 3, t.len()))?;
            Some(Pose::world_from_cam(draft::rotation_and_translation(
                place, &r, t,
            )?))
        }
        // Newer files have the whole transform as T.
        (None, Some(t)) if t.len() == 16 => {
            let rows = std::array::from_fn(|i| std::array::from_fn(|j| t[4 * i + j]));
            Some(Pose::world_from_cam(draft::rigid(place, &rows)?))
        }
        _ => return Err(of("expected both R and T, got one of them".into())),
    };
    Ok(DraftCamera {
        id: format!("cam{number}"),
        size: Some([side("width")?, side("height")?]),
        plane,
        lens: Lens::brown_conrady(&[k1, k2, p1, p2, k3]).map_err(of)?,
        pose,
    })
}
