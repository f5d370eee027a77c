//! Open3D's `PinholeCameraParameters` and `PinholeCameraTrajectory` as JSON.
//!
//! Source: <https://github.com/isl-org/Open3D>, `camera/PinholeCamera*.cpp`: `extrinsic` maps world to camera;
//! it and `intrinsic_matrix` are written column by column. There is no distortion, and the file says no unit.

use serde_json::Value;

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};

/// Keys of a trajectory.
const KNOWN_OF_ALL: [&str; 4] = ["class_name", "version_major", "version_minor", "parameters"];
/// Keys of a camera.
const KNOWN: [&str; 8] = [
    "class_name",
    "version_major",
    "version_minor",
    "extrinsic",
    "intrinsic",
    "intrinsic_matrix",
    "width",
    "height",
];

/// Whether it says so.
pub fn is_it(value: &Value) -> bool {
    let name = value.get("class_name").and_then(Value::as_str);
    name.is_some_and(|name| name.starts_with("PinholeCamera"))
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut cameras = Vec::new();
    for source in sources {
        let document = yaml::document(source)?;
        let top = Node::new(&document, &source.name);
        match top.find(&["parameters"]) {
            Some(list) => {
                unread::refuse(&top, &KNOWN_OF_ALL, options)?;
                for (index, one) in list.list()?.iter().enumerate() {
                    cameras.push(camera(&format!("cam{index}"), one, options)?);
                }
            }
            None => cameras.push(camera(&source.stem(), &top, options)?),
        }
    }
    Ok(Draft {
        cameras,
        metres: None,
        posing: "give its extrinsic",
        notes: Vec::new(),
    })
}

fn camera(name: &str, node: &Node, options: &Options) -> Checked<DraftCamera> {
    let inner = node.find(&["intrinsic"]).unwrap_or_else(|| node.clone());
    unread::refuse(node, &KNOWN, options)?;
    unread::refuse(&inner, &KNOWN, options)?;
    let columns = inner.get(&["intrinsic_matrix"])?;
    let columns: [f64; 9] = columns.vector()?;
    let rows = std::array::from_fn(|i| columns[3 * (i % 3) + i / 3]);
    let plane =
        Plane::from_matrix(rows).map_err(|problem| format!("{}: {problem}", inner.place))?;
    let pose = |extrinsic: Node| {
        let columns: [f64; 16] = extrinsic.vector()?;
        let rows = std::array::from_fn(|i| std::array::from_fn(|j| columns[4 * j + i]));
        draft::rigid(&extrinsic.place, &rows).map(Pose::cam_from_world)
    };
    Ok(DraftCamera {
        id: draft::id(name),
        size: Some([
            inner.get(&["width"])?.pixels()?,
            inner.get(&["height"])?.pixels()?,
        ]),
        plane,
        lens: Lens::PINHOLE,
        pose: node.find(&["extrinsic"]).map(pose).transpose()?,
    })
}
