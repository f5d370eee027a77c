//! OpenCV: FileStorage as YAML or JSON, of one camera, of a stereo pair, or of several cameras with
//! `rvec` and `tvec` or `R` and `T` each; also other files with its names.

mod camera;
pub mod keys;

use std::collections::BTreeMap;

use nalgebra::Isometry3;
use serde_json::{Map, Value};

use self::camera::{camera, transform};
use self::keys::{About, about, in_parts, is_in_order, is_section, split};
use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, yaml};

/// What is said of one camera, by the names of [`keys`].
type Fields = Map<String, Value>;

/// Of [`Fields`]: keys that are none of the names, but state something.
const UNUSED: &str = "unused";
/// Of [`Fields`]: what the size's key is called.
const SIZE_KEY: &str = "size's key";

/// What files say, in their order.
#[derive(Default)]
struct Found {
    cameras: Vec<(String, Fields)>,
    /// R and T of no camera in the same object: of a pair, or of the camera of that name.
    places: Vec<(String, Fields)>,
    /// Of two cameras, whether nothing says which one comes first.
    unordered: bool,
}

/// Whether there is a camera in it, under whatever name.
pub fn has_camera(value: &Value) -> bool {
    has(value, &|fields| {
        fields.contains_key("K") || fields.contains_key("fx")
    })
}

/// Whether there is an object in it, at any depth, of which that holds.
fn has(value: &Value, what: &dyn Fn(&BTreeMap<&str, String>) -> bool) -> bool {
    match value {
        Value::Object(map) => {
            let fields = map
                .iter()
                .filter_map(|(key, value)| split(key, value))
                .collect();
            what(&fields) || map.values().any(|value| has(value, what))
        }
        Value::Array(list) => list.iter().take(4).any(|value| has(value, what)),
        _ => false,
    }
}

/// Whether fields hold a pose.
fn is_placed<V>(has: impl Fn(&str) -> Option<V>) -> bool {
    let any = |keys: &[&str]| keys.iter().any(|key| has(key).is_some());
    (any(&["R", "rvec"]) && any(&["T"])) || any(&["pose", "world_from_cam", "cam_from_world"])
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let documents = sources
        .iter()
        .map(|source| Ok((source.stem(), source.name.clone(), yaml::document(source)?)));
    assemble(documents.collect::<Checked<_>>()?, options)
}

/// The rig of documents with OpenCV's names.
///
/// - `documents`: of each the name of the camera that it is of, if it is of one; the file's name, for
///   errors; and what it says
pub fn assemble(documents: Vec<(String, String, Value)>, options: &Options) -> Checked<Draft> {
    let mut found = Found::default();
    for (name, file, document) in &documents {
        collect(name, document, &mut found).map_err(|problem| format!("{file}: {problem}"))?;
    }
    let pair = join(&mut found)?;
    let Found {
        cameras, unordered, ..
    } = found;
    let pair = match pair {
        None => None,
        Some((name, pair)) => {
            let place = format!("{name}: R, T");
            let pair = Node {
                value: &Value::Object(pair),
                place,
            };
            Some(transform(&pair)?)
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
        let unused = fields.remove(UNUSED);
        let value = Value::Object(fields);
        let mut camera = camera(&id, &Node::new(&value, &id), options, &mut notes)?;
        if let Some(second_from_first) = pair {
            let cam_from_world = [Isometry3::identity(), second_from_first][index];
            camera.pose = Some(Pose::cam_from_world(cam_from_world));
        }
        if let Some(unused) = unused {
            all_used(&id, &unused, &camera)?;
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

/// Joins what several objects say of one camera; what is left is the R and T of a pair.
fn join(found: &mut Found) -> Checked<Option<(String, Fields)>> {
    if found.cameras.is_empty() {
        return Err("expected camera matrices (K, M1, camera_matrix, ... of 3x3 numbers) or fx, fy, cx, cy, \
                    got none"
            .into());
    }
    let cameras = &mut found.cameras;
    for (index, (id, _)) in cameras.iter().enumerate() {
        if cameras[..index].iter().any(|(other, _)| other == id) {
            return Err(format!(
                "two cameras are called `{id}`; give each file its own name"
            ));
        }
    }
    let mut left = Vec::new();
    for (name, place) in found.places.drain(..) {
        let Some((id, camera)) = cameras.iter_mut().find(|(id, _)| *id == draft::id(&name)) else {
            left.push((name, place));
            continue;
        };
        for (key, value) in place {
            if camera.insert(key.clone(), value).is_some() && key != UNUSED {
                return Err(format!(
                    "camera `{id}`: `{key}` is there twice; leave one out"
                ));
            }
        }
    }
    let placed = |(_, fields): &(String, Fields)| is_placed(|key| fields.get(key));
    if left.is_empty() || cameras.iter().all(placed) || (cameras.len() == 1 && left.len() > 1) {
        return Ok(None);
    }
    match left.len() {
        1 if !cameras.iter().any(placed) => Ok(left.pop()),
        _ => {
            let names = |list: &[(String, Fields)]| {
                let names: Vec<_> = list.iter().take(4).map(|(name, _)| name.as_str()).collect();
                names.join(", ")
            };
            Err(format!(
                "there are places of {}, but the cameras are called {}; give both the same names",
                names(&left),
                names(cameras)
            ))
        }
    }
}

/// Refuses a camera of which more is stated than was read.
fn all_used(id: &str, unused: &Value, camera: &DraftCamera) -> Checked<()> {
    for (key, value) in unused.as_object().into_iter().flatten() {
        let (what, used) = match about(key, value) {
            Some(About::Lens) => ("lens", false),
            Some(About::Place) => ("place", camera.pose.is_some()),
            Some(About::Size) => ("size", camera.size.is_some()),
            None => continue,
        };
        if !used {
            return Err(format!(
                "camera `{id}`: the key `{key}` looks like a part of its {what} and is not known; give it by a \
                 name that docs/how-to/import-a-calibration.md lists, or leave it out if it is none"
            ));
        }
    }
    Ok(())
}

/// Entries of an object or a list, those of sections among them, by name.
fn entries(value: &Value) -> Vec<(String, &Value)> {
    let mut all: Vec<(String, &Value)> = match value {
        Value::Object(map) => map
            .iter()
            .map(|(key, value)| (key.clone(), value))
            .collect(),
        Value::Array(list) => list
            .iter()
            .enumerate()
            .map(|(i, value)| (name_in_list(value, i), value))
            .collect(),
        _ => Vec::new(),
    };
    if value.is_object() {
        // Keys come in the order of text, not in the file's.
        all.sort_by_cached_key(|(key, _)| in_parts(key));
    }
    all.into_iter()
        .flat_map(
            |(key, inner)| match value.is_object() && is_section(&key, inner) {
                true => entries(inner),
                false => vec![(key, inner)],
            },
        )
        .collect()
}

fn name_in_list(value: &Value, index: usize) -> String {
    let named = ["id", "name", "camera_id", "camera_name", "serial"]
        .iter()
        .find_map(|key| value.get(*key));
    match named {
        Some(Value::String(name)) => name.clone(),
        Some(Value::Number(number)) => format!("cam{number}"),
        _ => format!("cam{index}"),
    }
}

/// Sorts what an object says by camera.
fn collect(name: &str, value: &Value, found: &mut Found) -> Checked<()> {
    if !value.is_object() && !value.is_array() {
        return Err("expected an object or a list of cameras".into());
    }
    let mut numbered: BTreeMap<String, Fields> = BTreeMap::new();
    let mut by_key: Vec<String> = Vec::new();
    let mut named: Fields = Fields::new();
    let mut unused: Fields = Fields::new();
    for (key, inner) in entries(value) {
        if let Some((field, suffix)) = split(&key, inner) {
            let fields = match suffix.is_empty() {
                true => &mut named,
                false => numbered.entry(suffix).or_default(),
            };
            if fields.insert(field.to_owned(), inner.clone()).is_some() {
                return Err(format!("`{key}` is there twice, under different names"));
            }
            if field == "size" {
                fields.insert(SIZE_KEY.to_owned(), key.into());
            }
        } else if has_camera(inner) || has(inner, &|fields| is_placed(|key| fields.get(key))) {
            let own = entries(inner);
            let flat = own.iter().filter_map(|(key, value)| split(key, value));
            let fields: BTreeMap<_, _> = flat.filter(|(_, end)| end.is_empty()).collect();
            let is_one = fields.contains_key("K")
                || fields.contains_key("fx")
                || is_placed(|key| fields.get(key));
            let id = key.rsplit('/').next().unwrap_or(&key);
            collect(if is_one { id } else { name }, inner, found)?;
            if has_camera(inner) {
                by_key.push(id.to_owned());
            }
        } else if about(&key, inner).is_some() {
            unused.insert(key, inner.clone());
        }
    }
    // R1, R2, P1, P2 and Q are about rectified images, which these are not.
    numbered.retain(|_, fields| fields.contains_key("K"));
    found.unordered |= match by_key.as_slice() {
        [first, second] => value.is_object() && !is_in_order(first, second),
        _ => false,
    };
    if !unused.is_empty() {
        named.insert(UNUSED.to_owned(), unused.into());
    }
    if named.contains_key("K") || named.contains_key("fx") {
        found.cameras.push((draft::id(name), named));
    } else {
        let mut place = Fields::new();
        for key in ["R", "T", "rvec", "pose", "world_from_cam", "cam_from_world"] {
            place.extend(named.remove_entry(key));
        }
        if !place.is_empty() {
            found.places.push((name.to_owned(), place));
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
