//! EasyMocap's `intri.yml` and `extri.yml`: keys that end in the name of a camera, and a list of `names`.
//!
//! Source: <https://github.com/zju3dv/EasyMocap>, `easymocap/mytools/camera_utils.py`: `K_NAME` and
//! `dist_NAME` (k1 k2 p1 p2 k3), `H_NAME` and `W_NAME` where they are known; `R_NAME` is a Rodrigues
//! vector and `Rot_NAME` its matrix, `T_NAME` the translation, all from world to camera.

use serde_json::{Map, Value, json};

use crate::draft::Draft;
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, opencv, unread, yaml};

/// What a key is called in [`opencv`].
const NAMES: [(&str, &str); 8] = [
    ("K", "camera_matrix"),
    ("dist", "dist_coeffs"),
    ("D", "dist_coeffs"),
    ("R", "rvec"),
    ("Rot", "rotation_matrix"),
    ("T", "tvec"),
    ("H", "height"),
    ("W", "width"),
];

/// Whether it has names, and a matrix or a place of the first.
pub fn is_it(value: &Value) -> bool {
    let first = value.get("names").and_then(|names| names.get(0));
    let has = |key: &str, name: &str| value.get(format!("{key}_{name}")).is_some();
    name(first).is_some_and(|name| has("K", &name) || has("Rot", &name))
}

/// A name of digits is read as a number, but 01 is not 1.
fn name(value: Option<&Value>) -> Option<String> {
    match value? {
        Value::String(name) => Some(name.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    }
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut documents = Vec::new();
    for source in sources {
        let document = yaml::document(source)?;
        let top = Node::new(&document, &source.name);
        let mut names = Vec::new();
        for item in top.get(&["names"])?.list()? {
            names.push(name(Some(item.value)).ok_or_else(|| item.wrong("the name of a camera"))?);
        }
        // `K_a_1` is of `a_1`, also where another camera is called `1`.
        let split = |key: &str| {
            let ends = names.iter().enumerate().filter_map(|(index, name)| {
                let start = key.strip_suffix(name.as_str())?.strip_suffix('_')?;
                Some((index, start.len()))
            });
            ends.min_by_key(|(_, length)| *length)
        };
        let mut cameras = vec![Map::new(); names.len()];
        let mut known = vec!["names"];
        for (key, node) in top.entries() {
            let Some((index, length)) = split(key) else {
                continue;
            };
            known.push(key);
            let theirs = &key[..length];
            let ours = NAMES.iter().find(|(name, _)| *name == theirs);
            let ours = ours.map_or(theirs, |(_, ours)| ours);
            cameras[index].insert(ours.to_owned(), node.value.clone());
        }
        unread::refuse(&top, &known, options)?;
        for (name, mut camera) in names.into_iter().zip(cameras) {
            camera.insert("direction".into(), "world_to_camera".into());
            documents.push((
                source.name.clone(),
                source.name.clone(),
                json!({ name: camera }),
            ));
        }
    }
    let draft = opencv::assemble(documents, options)?;
    let posing = "give extri.yml as well, with its R and T";
    Ok(Draft { posing, ..draft })
}
