//! multical's `calibration.json`: cameras with OpenCV's intrinsics, and their places by name.
//!
//! Source: <https://github.com/oliver-batchelor/multical>, `multical/io/export_calib.py`: `camera_poses` maps the
//! rig, or the master camera, to the camera of that name; with a master the others are called
//! `NAME_to_MASTER`. `image_size` is width and height. The unit is that of the board.

use serde_json::{Map, Value, json};

use crate::draft::Draft;
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, opencv, unread, yaml};

/// Its models, all of which are OpenCV's pinhole.
const MODELS: [&str; 4] = ["standard", "rational", "thin_prism", "tilted"];

/// Whether it has cameras, and their places beside them.
pub fn is_it(value: &Value) -> bool {
    value.get("cameras").is_some() && value.get("camera_poses").is_some()
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut documents = Vec::new();
    for source in sources {
        let document = yaml::document(source)?;
        let top = Node::new(&document, &source.name);
        unread::refuse(&top, &["cameras", "camera_poses", "image_sets"], options)?;
        let poses = top.get(&["camera_poses"])?.object()?;
        for (name, camera) in top.get(&["cameras"])?.object()? {
            let fields = camera.object()?.into_iter();
            let mut fields: Map<String, Value> = fields
                .map(|(key, node)| (key.to_owned(), node.value.clone()))
                .collect();
            let model = camera
                .find(&["model"])
                .map(|model| model.text())
                .transpose()?;
            if model.is_none_or(|model| MODELS.contains(&model)) {
                fields.insert("model".into(), "pinhole".into());
            }
            let start = format!("{name}_to_");
            let pose = poses
                .iter()
                .find(|(key, _)| *key == name || key.starts_with(&start));
            if let Some((_, pose)) = pose {
                fields.insert("T_cam_world".into(), rows(pose)?);
            }
            documents.push((name.to_owned(), source.name.clone(), Value::Object(fields)));
        }
    }
    let mut draft = opencv::assemble(documents, options)?;
    draft.notes.push(
        "the world frame is that of the rig, or of the master camera where there is one".into(),
    );
    let posing = "give its place in `camera_poses`";
    Ok(Draft { posing, ..draft })
}

/// Rows of the homogeneous matrix of R and T.
fn rows(pose: &Node) -> Checked<Value> {
    let r: [f64; 9] = pose.get(&["R"])?.vector()?;
    let t: [f64; 3] = pose.get(&["T"])?.vector()?;
    let row = |i: usize| json!([r[3 * i], r[3 * i + 1], r[3 * i + 2], t[i]]);
    Ok(json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]))
}
