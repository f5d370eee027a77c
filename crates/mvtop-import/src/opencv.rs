//! OpenCV: FileStorage as YAML or JSON, of one camera, of a stereo pair, or of several cameras with
//! `rvec` and `tvec` or `R` and `T` each; also other files with its names.

mod keys;

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde_json::{Map, Value};

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Direction, Options, yaml};
use keys::{in_parts, is_in_order, split};

/// What is said of one camera, by the names of [`keys`].
type Fields = Map<String, Value>;

/// What files say, in their order.
#[derive(Default)]
struct Found {
    cameras: Vec<(String, Fields)>,
    /// R and T of no camera: of a pair.
    shared: Vec<(String, Fields)>,
    /// Of two cameras, whether nothing says which one comes first.
    unordered: bool,
}

/// Whether there is a camera in it, under whatever name.
pub fn has_camera(value: &Value) -> bool {
    let named =
        |map: &Map<String, Value>| map.keys().any(|key| matches!(split(key), Some(("K", _))));
    match value {
        Value::Object(map) => named(map) || map.values().any(has_camera),
        Value::Array(list) => list.iter().take(4).any(has_camera),
        _ => false,
    }
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut found = Found::default();
    for source in sources {
        let document = yaml::document(source)?;
        collect(&source.stem(), &document, &mut found)
            .map_err(|problem| format!("{}: {problem}", source.name))?;
    }
    let Found {
        cameras,
        shared,
        unordered,
    } = found;
    if cameras.is_empty() {
        return Err("expected camera matrices (K, M1, camera_matrix, ...), got none".into());
    }
    let mut ids = BTreeSet::new();
    if let Some((id, _)) = cameras.iter().find(|(id, _)| !ids.insert(id)) {
        return Err(format!(
            "two cameras are called `{id}`; give each file its own name"
        ));
    }
    let pair = match shared.as_slice() {
        [] => None,
        [(name, pair)] => {
            let place = format!("{name}: R, T");
            let pair = Node {
                value: &Value::Object(pair.clone()),
                place,
            };
            Some(transform(&pair)?)
        }
        [_, ..] => {
            return Err("R and T are there several times; give one file of each pair".into());
        }
    };
    if pair.is_some() && cameras.len() != 2 {
        return Err(format!(
            "R and T are those of a pair of cameras, got {} cameras; give rvec and tvec of each",
            cameras.len()
        ));
    }
    if pair.is_some() && unordered {
        return Err(format!(
            "R and T map the first camera to the second, but the keys `{}` and `{}` do not say which one is \
             the first; give each camera a file of its own, in that order",
            cameras[0].0, cameras[1].0
        ));
    }
    let mut draft = Vec::new();
    let mut notes = Vec::new();
    for (index, (id, mut fields)) in cameras.into_iter().enumerate() {
        // R1 and R2 of a pair turn its images to rectified ones.
        if pair.is_some() && !fields.contains_key("T") {
            fields.remove("R");
        }
        let value = Value::Object(fields);
        let mut camera = camera(&id, &Node::new(&value, &id), options, &mut notes)?;
        if let Some(second_from_first) = pair {
            let cam_from_world = [Isometry3::identity(), second_from_first][index];
            camera.pose = Some(Pose::cam_from_world(cam_from_world));
        }
        draft.push(camera);
    }
    if pair.is_some() {
        notes.push(format!(
            "R and T map `{}` to `{}` (stereoCalibrate), and the world frame is that of the first",
            draft[0].id, draft[1].id
        ));
    }
    Ok(Draft {
        cameras: draft,
        metres: None,
        posing: "give R and T of the pair, or rvec and tvec of each camera",
        notes,
    })
}

/// Sorts what an object says by camera.
fn collect(name: &str, value: &Value, found: &mut Found) -> Checked<()> {
    let mut numbered: BTreeMap<String, Fields> = BTreeMap::new();
    let mut by_key: Vec<String> = Vec::new();
    let mut items: Vec<(String, &Value)> = match value {
        Value::Object(map) => map
            .iter()
            .map(|(key, value)| (key.clone(), value))
            .collect(),
        Value::Array(list) => {
            let key = |value: &Value, i: usize| {
                let named = ["id", "name", "camera_id", "serial"]
                    .iter()
                    .find_map(|k| value.get(*k));
                match named {
                    Some(Value::String(name)) => name.clone(),
                    Some(Value::Number(number)) => format!("cam{number}"),
                    _ => format!("cam{i}"),
                }
            };
            list.iter()
                .enumerate()
                .map(|(i, value)| (key(value, i), value))
                .collect()
        }
        _ => return Err("expected an object or a list of cameras".into()),
    };
    if value.is_object() {
        // Keys come in the order of text, not in the file's.
        items.sort_by_cached_key(|(key, _)| in_parts(key));
    }
    let mut named: Fields = Fields::new();
    for (key, value) in items {
        match split(&key) {
            Some((field, suffix)) => {
                let fields = match suffix.is_empty() {
                    true => &mut named,
                    false => numbered.entry(suffix).or_default(),
                };
                if fields.insert(field.to_owned(), value.clone()).is_some() {
                    return Err(format!("`{key}` is there twice, under different names"));
                }
            }
            None if value.is_array() && key == "cameras" => collect(name, value, found)?,
            None if has_camera(value) => {
                let inner = value.get("cameras").unwrap_or(value);
                let flat = inner.as_object().is_some_and(|map| {
                    map.keys().any(|key| {
                        split(key).is_some_and(|(field, end)| field == "K" && end.is_empty())
                    })
                });
                let id = key.rsplit('/').next().unwrap_or(&key);
                collect(if flat { id } else { name }, inner, found)?;
                by_key.push(id.to_owned());
            }
            None => {}
        }
    }
    // R1, R2, P1, P2 and Q are about rectified images, which these are not.
    numbered.retain(|_, fields| fields.contains_key("K"));
    found.unordered |= match by_key.as_slice() {
        [first, second] => value.is_object() && !is_in_order(first, second),
        _ => false,
    };
    if named.contains_key("K") {
        found.cameras.push((draft::id(name), named));
    } else {
        let mut pair = Fields::new();
        for key in ["R", "T", "rvec"] {
            pair.extend(named.remove_entry(key));
        }
        if !pair.is_empty() {
            found.shared.push((name.to_owned(), pair));
        }
        // What is left is of both cameras: the size of their images.
        for fields in numbered.values_mut() {
            fields.extend(named.clone());
        }
    }
    let mut numbered = Vec::from_iter(numbered);
    numbered.sort_by_cached_key(|(suffix, _)| in_parts(suffix));
    for (suffix, fields) in numbered {
        let id = match suffix.as_str() {
            "l" => "left".to_owned(),
            "r" => "right".to_owned(),
            digits if digits.parse::<u32>().is_ok() => format!("cam{digits}"),
            other => other.to_owned(),
        };
        found.cameras.push((id, fields));
    }
    Ok(())
}

fn camera(
    id: &str,
    node: &Node,
    options: &Options,
    notes: &mut Vec<String>,
) -> Checked<DraftCamera> {
    let of = |problem: String| format!("camera `{id}`: {problem}");
    let plane = Plane::from_matrix(node.get(&["K"])?.vector()?).map_err(of)?;
    let params = match node.find(&["D"]) {
        Some(params) => params.numbers()?,
        None => {
            notes.push(of(
                "no distortion coefficients were found, so none are assumed".into(),
            ));
            Vec::new()
        }
    };
    let fisheye = node
        .find(&["fisheye"])
        .is_some_and(|node| match node.value {
            Value::Bool(yes) => *yes,
            value => value.as_f64().is_some_and(|number| number != 0.0),
        });
    let named = node.find(&["model"]).and_then(|model| model.value.as_str());
    let lens = match (options.model.as_deref().or(named), params.len()) {
        _ if fisheye => Lens::kannala_brandt(&params),
        (Some(name), _) if !["pinhole", "perspective"].contains(&name) => Lens::named(name, &params),
        // calibrateCamera gives 5 or more, but never 4 unless it is told to.
        (None, 4) if params.iter().any(|&p| p != 0.0) => Err(
            "4 coefficients are k1 k2 p1 p2 of a pinhole or k1 k2 k3 k4 of a fisheye, and the file does \
             not say which; give `model` (--model pinhole or fisheye)"
                .into(),
        ),
        _ => Lens::brown_conrady(&params),
    };
    let size = match (
        node.find(&["size"]),
        node.find(&["width"]),
        node.find(&["height"]),
    ) {
        (Some(size), _, _) => Some(size.size()?),
        (_, Some(width), Some(height)) => Some([width.pixels()?, height.pixels()?]),
        _ => None,
    };
    Ok(DraftCamera {
        id: draft::id(id),
        size,
        plane,
        lens: lens.map_err(of)?,
        pose: pose(node)?,
    })
}

/// rvec and tvec are OpenCV's, from world to camera; what else there may be does not say.
fn pose(node: &Node) -> Checked<Option<Pose>> {
    let matrix = |key: &str| {
        let found = node.find(&[key]);
        found
            .map(|node| draft::rigid(&node.place, &node.matrix4()?))
            .transpose()
    };
    if let Some(pose) = matrix("world_from_cam")? {
        return Ok(Some(Pose::world_from_cam(pose)));
    }
    if let Some(pose) = matrix("cam_from_world")? {
        return Ok(Some(Pose::cam_from_world(pose)));
    }
    let (transform, direction) = if let Some(pose) = matrix("pose")? {
        (pose, None)
    } else if node.has("R") || node.has("rvec") || node.has("T") {
        let direction = node.has("rvec").then_some(Direction::CamFromWorld);
        (transform(node)?, direction)
    } else {
        return Ok(None);
    };
    Ok(Some(Pose {
        transform,
        direction,
    }))
}

/// R, or a Rodrigues vector that is called one, with T.
fn transform(node: &Node) -> Checked<Isometry3<f64>> {
    let t: [f64; 3] = node.get(&["T"])?.vector()?;
    let rotation = node.get(&["R", "rvec"])?;
    let &[x, y, z] = rotation.numbers()?.as_slice() else {
        return draft::rotation_and_translation(&rotation.place, &rotation.vector()?, t);
    };
    let place = &rotation.place;
    if node.has("R") {
        return Err(format!(
            "{place}: expected a 3x3 matrix, got 3 numbers, which may be a Rodrigues vector or Euler \
             angles; give the former as `rvec`, the latter as a matrix"
        ));
    }
    let turn = Vector3::new(x, y, z);
    if turn.norm() > TAU {
        return Err(format!(
            "{place}: expected a Rodrigues vector in radians, not longer than a whole turn (6.28), got \
             a length of {:.2}; turn degrees into radians, give other angles as a matrix `R`",
            turn.norm()
        ));
    }
    let rotation = UnitQuaternion::from_scaled_axis(turn);
    Ok(Isometry3::from_parts(Vector3::from(t).into(), rotation))
}
