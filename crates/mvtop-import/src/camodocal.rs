//! camodocal's cameras, as VINS reads them, and VINS' own file with the places of its cameras.
//!
//! Source: <https://github.com/hengli/camodocal>, `src/camera_models`: PINHOLE and PINHOLE_FULL have OpenCV's
//! coefficients; MEI those of OpenCV's omnidir, its sphere's `xi` among `mirror_parameters`; KANNALA_BRANDT
//! calls OpenCV's k1 to k4 k2 to k5, and the focal lengths mu and mv. SCARAMUZZA is a polynomial that no
//! rig file has. Of VINS, `body_T_cam0` is the pose of the first camera in the frame of the IMU, metres, and
//! `cam0_calib` its file.

use serde_json::{Map, Value, json};

use crate::draft::Draft;
use crate::node::Node;
use crate::source::Source;
use crate::unread::words;
use crate::{Checked, Options, opencv, unread, yaml};

/// What is read of a camera.
const KNOWN: [&str; 7] = [
    "model_type",
    "camera_name",
    "image_width",
    "image_height",
    "projection_parameters",
    "distortion_parameters",
    "mirror_parameters",
];

/// Whether it is a camera, or VINS' file.
pub fn is_it(value: &Value) -> bool {
    value.get("model_type").is_some() || value.get("body_T_cam0").is_some()
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut documents = Vec::new();
    let mut files = Vec::new();
    let mut bodies = Vec::new();
    for source in sources {
        let document = yaml::document(source)?;
        let top = Node::new(&document, &source.name);
        if top.has("model_type") {
            let stem = source.stem();
            let name = match top.find(&["camera_name"]) {
                // VINS' cameras are all called `camera`.
                Some(name) if name.value != "camera" => name.text()?.to_owned(),
                _ => stem,
            };
            files.push((source.file_name(), name.clone()));
            documents.push((name, source.name.clone(), camera(&top, options)?));
        } else if top.has("body_T_cam0") {
            bodies.push((source, document));
        } else {
            documents.push((source.stem(), source.name.clone(), document));
        }
    }
    let in_body = !bodies.is_empty();
    for (source, document) in bodies {
        let top = Node::new(&document, &source.name);
        let stems: Vec<&str> = files.iter().map(|(file, _)| stem(file)).collect();
        let numbers = match top.has("cam0_calib") {
            true => Vec::new(),
            false => numbers(&top, &stems)?,
        };
        for (index, pose) in places(&top) {
            let file = top.find(&[&format!("cam{index}_calib")]);
            let file = file.map(|file| file.text()).transpose()?;
            let file = file.map(str::to_lowercase);
            let (_, name) = match file {
                None => match numbers.iter().position(|number| *number == index) {
                    Some(of) => &files[of],
                    None => continue,
                },
                Some(file) => files
                    .iter()
                    .find(|(known, _)| *known == file)
                    .ok_or_else(|| {
                        format!(
                            "{}: camera {index} is `{file}`, which is not given; give it too",
                            source.name
                        )
                    })?,
            };
            let place = json!({ "T_world_cam": pose.value });
            documents.push((name.clone(), source.name.clone(), place));
        }
    }
    let mut draft = opencv::assemble(documents, options)?;
    if in_body {
        draft.metres = Some(1.0);
        draft
            .notes
            .push("the world frame is that of the body".into());
    }
    let posing = "give VINS' file with body_T_cam0, or a file with T_world_cam of each camera";
    Ok(Draft { posing, ..draft })
}

/// The name of a file without its ending.
fn stem(file: &str) -> &str {
    file.rsplit_once('.').map_or(file, |(stem, _)| stem)
}

/// The places of cameras in the body by their numbers.
fn places<'a>(top: &Node<'a>) -> Vec<(usize, Node<'a>)> {
    let all = top.entries().into_iter();
    let numbered = all.filter_map(|(key, node)| {
        let number = key.strip_prefix("body_T_cam")?.parse().ok()?;
        Some((number, node))
    });
    numbered.collect()
}

/// The number of the camera that each file is of: by the numbers or sides in their names, or by their order where no
/// name has any.
fn numbers(top: &Node, stems: &[&str]) -> Checked<Vec<usize>> {
    let known: Vec<usize> = places(top).into_iter().map(|(number, _)| number).collect();
    let number = |stem: &str| {
        let words = words(stem);
        let side = ["left", "right"]
            .iter()
            .position(|side| words.iter().any(|word| word == side));
        let mut numbers = words.iter().filter_map(|word| word.parse().ok());
        side.or(numbers.find(|number| known.contains(number)))
    };
    let named: Vec<Option<usize>> = stems.iter().map(|stem| number(stem)).collect();
    let says = |stem: &&str| words(stem).iter().any(|word| word.parse::<usize>().is_ok());
    if named.iter().all(Option::is_none) && !stems.iter().any(says) {
        return Ok((0..stems.len()).collect());
    }
    let all: Option<Vec<usize>> = named.into_iter().collect();
    let once = |all: &Vec<usize>| (1..all.len()).all(|i| !all[..i].contains(&all[i]));
    all.filter(once).ok_or_else(|| {
        format!(
            "{}: the names of the cameras' files ({}) do not say which body_T_camN each has; give cam0_calib, \
             cam1_calib, ... there",
            top.place,
            stems.join(", ")
        )
    })
}

/// A camera with OpenCV's names.
fn camera(top: &Node, options: &Options) -> Checked<Value> {
    unread::refuse(top, &KNOWN, options)?;
    let model = top.get(&["model_type"])?;
    let part = |key: &str| {
        top.find(&[key])
            .map_or(Ok(Vec::new()), |node| node.object())
    };
    let mut all = Map::new();
    for key in ["image_width", "image_height"] {
        all.insert(key.into(), top.get(&[key])?.value.clone());
    }
    let mut given = part("projection_parameters")?;
    given.extend(part("distortion_parameters")?);
    given.extend(part("mirror_parameters")?);
    let (name, renamed): (&str, &[(&str, &str)]) = match model.text()?.to_uppercase().as_str() {
        "PINHOLE" | "PINHOLE_FULL" => ("pinhole", &[]),
        "MEI" => ("pinhole", &[("gamma1", "fx"), ("gamma2", "fy")]),
        "KANNALA_BRANDT" => (
            "fisheye",
            &[
                ("mu", "fx"),
                ("mv", "fy"),
                ("k2", "k1"),
                ("k3", "k2"),
                ("k4", "k3"),
                ("k5", "k4"),
            ],
        ),
        _ => return Err(model.wrong("PINHOLE, PINHOLE_FULL, MEI or KANNALA_BRANDT")),
    };
    all.insert("model".into(), name.into());
    for (key, node) in given {
        let known = renamed.iter().find(|(theirs, _)| *theirs == key);
        let ours = known.map_or(key, |(_, ours)| *ours);
        if all.insert(ours.to_owned(), node.value.clone()).is_some() {
            return Err(format!("{}: it is there twice", node.place));
        }
    }
    Ok(Value::Object(all))
}
