//! OpenCV: FileStorage as YAML or JSON, of one camera, of a stereo pair, or of several cameras with
//! `rvec` and `tvec` or `R` and `T` each; also other files with its names.

pub mod keys;

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde_json::{Map, Value};

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Foreign, Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Direction, Options, yaml};
use keys::{About, about, in_parts, is_in_order, is_section, rows_first, split};

/// What is said of one camera, by the names of [`keys`].
type Fields = Map<String, Value>;

/// Of [`Fields`]: keys that are none of the names, but state something.
const UNUSED: &str = "unused";
/// Of [`Fields`]: what the size's key is called.
const SIZE_KEY: &str = "size's key";
/// Coefficients that have a key each, as `brown_conrady` orders them.
const BROWN: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
/// A principal point farther from the middle of its image is implausible, share of a side.
const OFF_MIDDLE: f64 = 0.1;

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

fn camera(
    id: &str,
    node: &Node,
    options: &Options,
    notes: &mut Vec<String>,
) -> Checked<DraftCamera> {
    let of = |problem: String| format!("camera `{id}`: {problem}");
    let plane = match node.find(&["K"]) {
        Some(matrix) => Plane::from_matrix(matrix.vector()?).map_err(of)?,
        None => {
            let number = |key: &str| node.get(&[key])?.number();
            Plane::new([number("fx")?, number("fy")?, number("cx")?, number("cy")?])
        }
    };
    let lens = lens(node, options, notes).map_err(of)?;
    Ok(DraftCamera {
        id: draft::id(id),
        size: size(id, node, &plane, options)?,
        plane,
        lens,
        pose: pose(node)?,
    })
}

/// By its name; where there is none, by the names of its coefficients.
fn lens(node: &Node, options: &Options, notes: &mut Vec<String>) -> Checked<Lens> {
    let number = |key: &str| node.find(&[key]).map(|node| node.number()).transpose();
    let fisheye = node
        .find(&["fisheye"])
        .is_some_and(|node| match node.value {
            Value::Bool(yes) => *yes,
            value => value.as_f64().is_some_and(|number| number != 0.0),
        });
    let named = node.find(&["model"]).and_then(|model| model.value.as_str());
    let model = options.model.as_deref().or(named);
    let model = model.filter(|name| !["pinhole", "perspective"].contains(&&*name.to_lowercase()));
    let [k1, k2, p1, p2, k3, k4, k5, k6] = {
        let mut each = [None; 8];
        for (coefficient, key) in each.iter_mut().zip(BROWN) {
            *coefficient = number(key)?;
        }
        each
    };
    let any = [k1, k2, p1, p2, k3, k4, k5, k6].iter().any(Option::is_some);
    let or_0 = |number: Option<f64>| number.unwrap_or(0.0);
    let is_fisheye = fisheye
        || model.is_some_and(
            |name| matches!(Lens::named(name, &[0.0; 4]), Ok(lens) if lens.is_fisheye()),
        );
    let params = match (node.find(&["D"]), any) {
        (Some(_), true) => {
            return Err(
                "its coefficients are there twice, as a list and by a key each; leave one out"
                    .into(),
            );
        }
        (Some(params), false) => params.numbers()?,
        (None, true) if is_fisheye => {
            if let Some(more) = [p1, p2, k5, k6].into_iter().flatten().find(|k| *k != 0.0) {
                return Err(format!(
                    "a fisheye has k1 k2 k3 k4 alone, got a further coefficient of {more}"
                ));
            }
            [k1, k2, k3, k4].map(or_0).to_vec()
        }
        (None, true) => match [k4, k5, k6] {
            [None, None, None] => [k1, k2, p1, p2, k3].map(or_0).to_vec(),
            [Some(k4), None, None] if k4 != 0.0 => {
                return Err(
                    "`k4` without `k5` and `k6` is a fisheye's to some programs and of r⁸ to others; give \
                     `model` (--model fisheye) if it is a fisheye's"
                        .into(),
                );
            }
            _ => [k1, k2, p1, p2, k3, k4, k5, k6].map(or_0).to_vec(),
        },
        (None, false) => {
            let id = &node.place;
            notes.push(format!(
                "camera `{id}`: no distortion coefficients were found, so none are assumed"
            ));
            Vec::new()
        }
    };
    let four_of_a_list = params.len() == 4 && !any;
    let lens = match model {
        _ if fisheye => Lens::kannala_brandt(&params),
        Some(name) => Lens::named(name, &params),
        // calibrateCamera gives 5 or more, but never 4 unless it is told to.
        None if four_of_a_list
            && options.model.is_none()
            && named.is_none()
            && !node.has("xi")
            && params.iter().any(|&p| p != 0.0) =>
        {
            Err(
                "4 coefficients are k1 k2 p1 p2 of a pinhole or k1 k2 k3 k4 of a fisheye, and the file does \
                 not say which; give `model` (--model pinhole or fisheye)"
                    .into(),
            )
        }
        None => Lens::brown_conrady(&params),
    }?;
    match (number("xi")?, lens) {
        (None | Some(0.0), lens) => Ok(lens),
        // OpenCV's omnidir: a sphere before the pinhole.
        (Some(xi), Lens::Native(distortion)) if !Lens::Native(distortion.clone()).is_fisheye() => {
            Ok(Lens::Foreign(Foreign::Omni { xi, distortion }))
        }
        (Some(xi), _) => Err(format!(
            "`xi` of {xi} on top of its lens cannot be expressed"
        )),
    }
}

/// Width and height, px, of a list whose order the name and the principal point tell.
fn size(id: &str, node: &Node, plane: &Plane, options: &Options) -> Checked<Option<[u32; 2]>> {
    let Some(list) = node.find(&["size"]) else {
        return match (node.find(&["width"]), node.find(&["height"])) {
            (Some(width), Some(height)) => Ok(Some([width.pixels()?, height.pixels()?])),
            _ => Ok(None),
        };
    };
    let [a, b] = list.size()?;
    let key = node
        .find(&[SIZE_KEY])
        .map_or("size", |key| key.value.as_str().unwrap_or("size"));
    let off = |[w, h]: [u32; 2]| {
        let side = |center: f64, side: u32| (center / f64::from(side) - 0.5).abs();
        side(plane.cx, w).max(side(plane.cy, h))
    };
    let (columns_first, rows_first_) = ([a, b], [b, a]);
    // One of two orders is out where the other puts the principal point far nearer to the middle.
    let out = |this, other| off(this) > OFF_MIDDLE && off(other) < off(this) / 4.0;
    let read = match rows_first(key) {
        _ if a == b => Some(columns_first),
        Some(true) if !out(rows_first_, columns_first) => Some(rows_first_),
        Some(false) if !out(columns_first, rows_first_) => Some(columns_first),
        None if out(rows_first_, columns_first) => Some(columns_first),
        None if out(columns_first, rows_first_) => Some(rows_first_),
        _ => None,
    };
    match read.or(options
        .size_of(id)
        .filter(|size| [columns_first, rows_first_].contains(size)))
    {
        Some(size) => Ok(Some(size)),
        None => Err(format!(
            "camera `{id}`: `{key}` of {a} and {b} px may be rows and columns or width and height, and the \
             principal point, {:.0} {:.0}, does not agree with one of them; give `image_size` (--image-size WxH)",
            plane.cx, plane.cy
        )),
    }
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
