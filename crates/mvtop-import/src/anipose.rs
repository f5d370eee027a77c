//! aniposelib's TOML, which Pose2Sim, Caliscope and FreeMoCap write as well: a table of each camera.
//!
//! Source: <https://github.com/lambdaloop/aniposelib>, `cameras.py`: `matrix`, `distortions`, `size` (width
//! and height), `rotation` (a Rodrigues vector) and `translation` from world to camera; `fisheye` says
//! that the four distortions are those of OpenCV's fisheye, else they are OpenCV's k1 k2 p1 p2 k3.
//! The unit is that of the board.

use serde_json::{Map, Value};

use crate::draft::Draft;
use crate::opencv::keys::is_yes;
use crate::source::Source;
use crate::{Checked, Options, opencv, yaml};

/// What a key is called in [`opencv`].
const NAMES: [(&str, &str); 5] = [
    ("matrix", "camera_matrix"),
    ("distortions", "dist_coeffs"),
    ("rotation", "rvec"),
    ("translation", "tvec"),
    ("size", "image_size"),
];

/// Whether it has tables as aniposelib writes them.
pub fn is_it(value: &Value) -> bool {
    let tables = value.as_object().into_iter().flat_map(Map::values);
    tables.into_iter().any(is_camera)
}

fn is_camera(value: &Value) -> bool {
    value.get("matrix").is_some() && value.get("distortions").is_some()
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut documents = Vec::new();
    for source in sources {
        let document = yaml::document(source)?;
        let tables = document.as_object().into_iter().flatten();
        for (key, table) in tables.filter(|(_, table)| is_camera(table)) {
            let name = table.get("name").and_then(Value::as_str).unwrap_or(key);
            let camera = table.as_object().into_iter().flatten().map(|(key, value)| {
                let known = NAMES.iter().find(|(theirs, _)| theirs == key);
                let ours = known.map_or(key.as_str(), |(_, ours)| ours);
                (ours.to_owned(), value.clone())
            });
            let mut camera: Map<String, Value> = camera.collect();
            // Without a word about it, it is no fisheye.
            let fisheye = table.get("fisheye").and_then(is_yes).unwrap_or_default();
            if !fisheye && !camera.contains_key("model") {
                camera.insert("model".into(), "pinhole".into());
            }
            documents.push((name.to_owned(), source.name.clone(), Value::Object(camera)));
        }
    }
    let draft = opencv::assemble(documents, options)?;
    let posing = "give its `rotation` and `translation`";
    Ok(Draft { posing, ..draft })
}
