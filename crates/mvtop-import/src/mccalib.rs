//! MC-Calib's `calibrated_cameras_data.yml`.
//!
//! Source: <https://github.com/rameau-fr/MC-Calib>, `McCalib/src/McCalib.cpp`: `camera_pose_matrix` is the pose of
//! the camera in the frame of the reference camera of its `camera_group`; `distortion_type` 0 is OpenCV's
//! Brown-Conrady, 1 its fisheye. The unit is that of the board.

use serde_json::{Map, Value};

use crate::draft::Draft;
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, opencv, unread, yaml};

/// What a key is called in [`opencv`].
const NAMES: [(&str, &str); 5] = [
    ("camera_matrix", "camera_matrix"),
    ("distortion_vector", "dist_coeffs"),
    ("img_width", "width"),
    ("img_height", "height"),
    ("camera_pose_matrix", "T_world_cam"),
];
/// Keys that are about no lens and no place.
const OTHERS: [&str; 2] = ["distortion_type", "camera_group"];

/// Whether it has a camera as MC-Calib writes it.
pub fn is_it(value: &Value) -> bool {
    let camera = value.get("camera_0");
    camera.is_some_and(|camera| camera.get("camera_pose_matrix").is_some())
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let [source] = sources else {
        let got = sources.len();
        return Err(format!("expected one file of MC-Calib, got {got}"));
    };
    let document = yaml::document(source)?;
    let top = Node::new(&document, &source.name);
    let mut documents = Vec::new();
    let mut group = None;
    let mut cameras = top.entries();
    cameras.retain(|(_, camera)| camera.has("camera_matrix"));
    let known: Vec<&str> = cameras.iter().map(|(name, _)| *name).collect();
    unread::refuse(&top, &known, options)?;
    for (name, camera) in cameras {
        if let Some(of) = camera.find(&["camera_group"]) {
            let of = of.number()?;
            if *group.get_or_insert(of) != of {
                return Err(format!(
                    "{}: expected one `camera_group`, got several, whose cameras have no frame in common; \
                     calibrate with boards that link them",
                    source.name
                ));
            }
        }
        let fields = camera.value.as_object().into_iter().flatten();
        let fields = fields.filter(|(key, _)| !OTHERS.contains(&key.as_str()));
        let mut fields: Map<String, Value> = fields
            .map(|(key, value)| {
                let known = NAMES.iter().find(|(theirs, _)| theirs == key);
                (
                    known.map_or(key.as_str(), |(_, ours)| ours).to_owned(),
                    value.clone(),
                )
            })
            .collect();
        let kind = camera.get(&["distortion_type"])?;
        let model = match kind.number()? {
            0.0 => "pinhole",
            1.0 => "fisheye",
            _ => return Err(kind.wrong("0 (Brown-Conrady) or 1 (fisheye)")),
        };
        fields.insert("model".into(), model.into());
        documents.push((name.to_owned(), source.name.clone(), Value::Object(fields)));
    }
    let draft = opencv::assemble(documents, options)?;
    let posing = "give its camera_pose_matrix";
    Ok(Draft { posing, ..draft })
}
