//! aniposelib's TOML, which Pose2Sim, Caliscope and FreeMoCap write as well: a table of each camera.
//!
//! Source: <https://github.com/lambdaloop/aniposelib>, `cameras.py`: `matrix`, `distortions`, `size` (width
//! and height), `rotation` (a Rodrigues vector) and `translation` from world to camera; `fisheye` says
//! that the four distortions are those of OpenCV's fisheye, else they are OpenCV's k1 k2 p1 p2 k3.
//! The unit is that of the board. Caliscope's `camera_array.toml` has the tables in `cameras`, a matrix for a
//! `rotation` as well, and tables without a `matrix` of cameras that were left out; `rotation_count` turns what it
//! shows, not the images.

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

/// Of Caliscope, what says nothing of the lens or the place.
const OTHERS: [&str; 2] = ["rotation_count", "verified_resolutions"];

/// Whether it has tables as aniposelib writes them.
pub fn is_it(value: &Value) -> bool {
    tables(value).any(|(_, table)| is_camera(table))
}

/// Tables by their names.
fn tables(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    let cameras = value.get("cameras").unwrap_or(value);
    cameras.as_object().into_iter().flatten()
}

fn is_camera(value: &Value) -> bool {
    value.get("matrix").is_some() && value.get("distortions").is_some()
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut documents = Vec::new();
    for source in sources {
        let document = yaml::document(source)?;
        for (key, table) in tables(&document).filter(|(_, table)| is_camera(table)) {
            let name = match (table.get("name"), table.get("cam_id")) {
                (Some(Value::String(name)), _) => name.clone(),
                (_, Some(Value::Number(id))) => format!("cam_{id}"),
                _ => key.clone(),
            };
            let fields = table.as_object().into_iter().flatten();
            let fields = fields.filter(|(key, _)| !OTHERS.contains(&key.as_str()));
            let camera = fields.map(|(key, value)| {
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
            documents.push((name, source.name.clone(), Value::Object(camera)));
        }
    }
    let draft = opencv::assemble(documents, options)?;
    let posing = "give its `rotation` and `translation`";
    Ok(Draft { posing, ..draft })
}
