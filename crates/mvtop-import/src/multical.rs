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
        let mut masters = Vec::new();
        let cameras = top.get(&["cameras"])?.object()?;
        for (name, camera) in &cameras {
            let name = *name;
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
            if let Some((key, pose)) = pose {
                unread::refuse(pose, &["R", "T"], options)?;
                masters.push((*key, key.strip_prefix(&start).unwrap_or(name)));
                fields.insert("T_cam_world".into(), rows(pose)?);
            }
            documents.push((name.to_owned(), source.name.clone(), Value::Object(fields)));
        }
        let read: Vec<&str> = masters.iter().map(|(key, _)| *key).collect();
        if read.len() == cameras.len() {
            unread::refuse(&top.get(&["camera_poses"])?, &read, options)?;
        }
        check_master(&masters)?;
    }
    let mut draft = opencv::assemble(documents, options)?;
    draft.notes.push(
        "the world frame is that of the rig, or of the master camera where there is one".into(),
    );
    let posing = "give its place in `camera_poses`";
    Ok(Draft { posing, ..draft })
}

/// Refuses places that are not of one master camera.
///
/// - `places`: key and master of each; of the rig or of the master itself, the camera's own name
fn check_master(places: &[(&str, &str)]) -> Checked<()> {
    let mut masters = places.iter().filter(|(key, master)| key != master);
    let Some((first, master)) = masters.next() else {
        return Ok(());
    };
    let own = places.iter().any(|(key, _)| key == master);
    let others = masters.find(|(_, other)| other != master);
    match (own, others) {
        (true, None) => Ok(()),
        (_, Some((other, _))) => Err(format!(
            "camera_poses: `{first}` and `{other}` are of two master cameras; give all places for one"
        )),
        (false, None) => Err(format!(
            "camera_poses: `{first}` is of the master camera `{master}`, which has no place; give that as well"
        )),
    }
}

/// Rows of the homogeneous matrix of R and T.
fn rows(pose: &Node) -> Checked<Value> {
    let r: [f64; 9] = pose.get(&["R"])?.vector()?;
    let t: [f64; 3] = pose.get(&["T"])?.vector()?;
    let row = |i: usize| json!([r[3 * i], r[3 * i + 1], r[3 * i + 2], t[i]]);
    Ok(json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]))
}
