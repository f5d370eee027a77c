//! aniposelib's TOML, which Pose2Sim, Caliscope and FreeMoCap write as well: a table of each camera.
//!
//! Source: <https://github.com/lambdaloop/aniposelib>, `cameras.py`: `matrix`, `distortions`, `size` (width
//! and height), `rotation` (a Rodrigues vector) and `translation` from world to camera; `fisheye` says
//! that the four distortions are those of OpenCV's fisheye, else they are OpenCV's k1 k2 p1 p2 k3.
//! The unit is that of the board. Caliscope's `camera_array.toml` has the tables in `cameras`, a matrix for a
//! `rotation` as well, and tables without a `matrix` of cameras that were left out; `rotation_count` turns what it
//! shows, not the images.

use nalgebra::{Matrix3, Vector3};
use serde_json::{Map, Value, json};

use crate::draft::Draft;
use crate::node::Node;
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

/// Of `metadata`, what aniposelib and FreeMoCap say of the calibration.
const METADATA: [&str; 8] = [
    "recording_info",
    "adjusted",
    "error",
    "charuco_square_size",
    "charuco_board_object",
    "path_to_recorded_videos",
    "date_time_calibrated",
    "groundplane_calibration",
];

/// Of FreeMoCap, the place of the camera in the world, which its rotation and translation say already.
const WORLD: [&str; 2] = ["world_position", "world_orientation"];
/// Largest difference of these: of an orientation, of a position in the file's unit or as a share of its distance.
const SAME: f64 = 1e-6;

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

/// Whether it says anything of a camera; Caliscope's tables of cameras that were left out do not.
fn states_camera(value: &Value) -> bool {
    let mut names = NAMES.iter().filter(|(theirs, _)| *theirs != "size");
    names.any(|(theirs, _)| value.get(theirs).is_some())
}

/// Refuses a place in the world that is not the inverse of `rotation` and `translation`.
fn check_world(table: &Node) -> Checked<()> {
    let [at, turn] = WORLD.map(|key| table.find(&[key]));
    let (Some(t), Some(turned)) = (table.find(&["translation"]), table.find(&["rotation"])) else {
        return Ok(());
    };
    let place = json!({ "T": t.value, "rvec": turned.value });
    let world_from_cam = opencv::transform(&Node::new(&place, &table.place))?.inverse();
    let most = SAME * world_from_cam.translation.vector.norm().max(1.0);
    if let Some(at) = at
        && (Vector3::from(at.vector::<3>()?) - world_from_cam.translation.vector).amax() > most
    {
        return Err(at.wrong("-Rᵀ t of `rotation` and `translation`; leave the wrong ones out"));
    }
    if let Some(turn) = turn {
        let rows = Matrix3::from_row_slice(&turn.vector::<9>()?);
        let expected = world_from_cam.rotation.to_rotation_matrix();
        if (rows - expected.matrix()).amax() > SAME {
            return Err(
                turn.wrong("the transpose of the matrix of `rotation`; leave the wrong one out")
            );
        }
    }
    Ok(())
}

/// What a file says beside its cameras.
fn others(document: &Value) -> Map<String, Value> {
    let tables = tables(document);
    // Of cameras, and of those that were left out.
    let cameras: Vec<&String> = tables
        .filter(|(_, table)| states_camera(table) || table.get("size").is_some())
        .map(|(key, _)| key)
        .collect();
    let is_camera = |key: &String| cameras.contains(&key);
    let mut others = Map::new();
    for (key, value) in document.as_object().into_iter().flatten() {
        match (key.as_str(), value) {
            ("cameras", Value::Object(all)) => {
                let left = all.iter().filter(|(key, _)| !is_camera(key));
                others.extend(left.map(|(key, value)| (key.clone(), value.clone())));
            }
            ("metadata", Value::Object(all)) => {
                let left = all
                    .iter()
                    .filter(|(key, _)| !METADATA.contains(&key.as_str()));
                others.insert(
                    key.clone(),
                    Value::Object(
                        left.map(|(key, value)| (key.clone(), value.clone()))
                            .collect(),
                    ),
                );
            }
            _ if is_camera(key) => {}
            _ => {
                others.insert(key.clone(), value.clone());
            }
        }
    }
    others
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut documents = Vec::new();
    for source in sources {
        let document = yaml::document(source)?;
        documents.push((
            source.stem(),
            source.name.clone(),
            Value::Object(others(&document)),
        ));
        for (key, table) in tables(&document).filter(|(_, table)| states_camera(table)) {
            check_world(&Node::new(table, &format!("{}: {key}", source.name)))?;
            let name = match (table.get("name"), table.get("cam_id")) {
                (Some(Value::String(name)), _) => name.clone(),
                (_, Some(Value::Number(id))) => format!("cam_{id}"),
                _ => key.clone(),
            };
            let fields = table.as_object().into_iter().flatten();
            let placed = table.get("rotation").is_some() && table.get("translation").is_some();
            let fields = fields.filter(|(key, _)| {
                let key = key.as_str();
                !(OTHERS.contains(&key) || placed && WORLD.contains(&key))
            });
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
