//! What files say, sorted by camera.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use super::join::{merge, named, put, share};
use super::keys::{is_of_lens, is_section, is_unit, split};
use super::order::{in_parts, is_in_order};
use super::pair::{Pair, is_pair, of_place};
use crate::unread::{self, plain};
use crate::{Checked, Options, Unit, draft};

/// Values of one camera, by the names of [`super::keys`].
pub type Fields = Map<String, Value>;

/// Of [`Fields`]: what the size's key is called.
pub const SIZE_KEY: &str = "size's key";
/// Of [`Fields`]: whether it has librealsense's names, whose matrices are written by columns.
pub const BY_COLUMNS: &str = "names of librealsense";
/// Of a camera's place.
pub const PLACE: &[&str] = &["R", "T", "rvec", "pose", "world_from_cam", "cam_from_world"];
/// What the name of a camera in a list is called, without case and signs; the first one counts.
const NAME_KEYS: &[&str] = &[
    "id",
    "name",
    "cameraid",
    "cameraname",
    "camid",
    "camname",
    "label",
    "camera",
    "cam",
    "serial",
    "serialnumber",
    "index",
    "port",
    "deviceid",
    "device",
];

/// Values of a camera whose matrix is elsewhere, or of all cameras.
pub struct Part {
    pub name: String,
    pub fields: Fields,
    /// Whether it is of a whole document, so of no camera by name.
    pub whole: bool,
}

/// What files say, in their order.
#[derive(Default)]
pub struct Found {
    pub cameras: Vec<(String, Fields)>,
    /// Of two cameras, whether nothing says which one comes first.
    pub unordered: bool,
    parts: Vec<Part>,
    /// Keys that are none of the names and state something, the camera before them where there is one.
    unread: Vec<String>,
    units: Vec<Unit>,
}

/// Whether there is a camera in it, under whatever name.
pub fn has_camera(value: &Value) -> bool {
    has(value, &is_camera)
}

fn is_camera(fields: &BTreeMap<&str, String>) -> bool {
    fields.contains_key("K") || fields.contains_key("fx")
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
pub fn is_placed<V>(has: impl Fn(&str) -> Option<V>) -> bool {
    let any = |keys: &[&str]| keys.iter().any(|key| has(key).is_some());
    (any(&["R", "rvec"]) && any(&["T"])) || any(&["pose", "world_from_cam", "cam_from_world"])
}

/// What an object says of the one thing that it is of.
fn own_fields(value: &Value) -> BTreeMap<&'static str, String> {
    let own = entries(value);
    let flat = own.iter().filter_map(|(key, value)| split(key, value));
    flat.filter(|(_, end)| end.is_empty()).collect()
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
            .map(|(i, value)| match value.as_array().map(Vec::as_slice) {
                // A map with numbers as keys, as a list of pairs.
                Some([Value::Number(key), of_key @ Value::Object(_)]) => {
                    (format!("cam{key}"), of_key)
                }
                Some([Value::String(key), of_key @ Value::Object(_)]) => (key.clone(), of_key),
                _ => (name_in_list(value, i), value),
            })
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
                true => entries(inner)
                    .into_iter()
                    .map(|(own, value)| (in_section(&key, own, value), value))
                    .collect(),
                false => vec![(key, inner)],
            },
        )
        .collect()
}

/// The key of an entry of a section: what a lens is called is its model.
fn in_section(section: &str, key: String, value: &Value) -> String {
    match is_of_lens(section) && value.is_string() && ["name", "type", "kind"].contains(&&*key) {
        true => "distortion_model".to_owned(),
        false => key,
    }
}

fn name_in_list(value: &Value, index: usize) -> String {
    let named = NAME_KEYS.iter().find_map(|name| {
        let mut fields = value.as_object().into_iter().flatten();
        let (_, named) = fields
            .find(|(key, value)| plain(key) == *name && (value.is_string() || value.is_number()))?;
        Some(named)
    });
    match named {
        Some(Value::String(name)) => name.clone(),
        Some(Value::Number(number)) => format!("cam{number}"),
        _ => format!("cam{index}"),
    }
}

impl Found {
    /// Sorts what an object says by camera.
    ///
    /// - `name`: of the file, or of the camera whose object it is
    /// - `whole`: whether it is a document
    pub fn collect(&mut self, name: &str, value: &Value, whole: bool) -> Checked<()> {
        if !value.is_object() && !value.is_array() {
            return Err("expected an object or a list of cameras".into());
        }
        let (before, parts_before) = (self.cameras.len(), self.parts.len());
        let mut numbered: BTreeMap<String, Vec<(String, &'static str, Value)>> = BTreeMap::new();
        let mut by_key: Vec<String> = Vec::new();
        let mut named = Fields::new();
        let all = entries(value);
        let rectifies = all.iter().any(|(key, inner)| unread::rectifies(key, inner));
        for (key, inner) in all {
            let key = in_section(name, key, inner);
            if is_unit(&key) {
                self.units.push(unit(&key, inner)?);
            } else if let Some((field, suffix)) = split(&key, inner) {
                if field == "roi" && rectifies {
                    continue;
                }
                if !suffix.is_empty() {
                    let of_one = numbered.entry(suffix).or_default();
                    of_one.push((key, field, inner.clone()));
                    continue;
                }
                if field != "model" && named.contains_key(field) {
                    return Err(format!("`{key}` is there twice, under different names"));
                }
                put(&mut named, field, inner.clone())?;
                if field == "size" {
                    named.insert(SIZE_KEY.to_owned(), key.into());
                } else if ["ppx", "ppy", "coeffs"].contains(&key.as_str()) {
                    named.insert(BY_COLUMNS.to_owned(), true.into());
                }
            } else if self.is_part(&key, inner) {
                let id = key.rsplit('/').next().unwrap_or(&key);
                let is_one = !own_fields(inner).is_empty();
                self.collect(if is_one { id } else { name }, inner, false)?;
                if has_camera(inner) {
                    by_key.push(id.to_owned());
                }
            } else if unread::matters(&key, inner) {
                self.unread.push(match whole {
                    true => key,
                    false => format!("{name}: {key}"),
                });
            }
        }
        self.unordered |= match by_key.as_slice() {
            [first, second] => value.is_object() && !is_in_order(first, second),
            _ => false,
        };
        let numbered = self.of_suffixes(numbered)?;
        if named.contains_key("K") || named.contains_key("fx") {
            // Values inside a camera are of its lens, but a place may be of something else.
            let inside = self.parts[parts_before..].iter_mut();
            let no_place =
                |part: &&mut Part| !PLACE.iter().any(|key| part.fields.contains_key(*key));
            for part in inside.filter(no_place) {
                part.name = name.to_owned();
            }
            self.cameras.push((draft::id(name), named));
            self.cameras.extend(numbered);
            return Ok(());
        }
        let mut place = Fields::new();
        for key in PLACE {
            place.extend(named.remove_entry(*key));
        }
        self.cameras.extend(numbered);
        // What is left is of all cameras here: the size of their images, or their lens.
        let inside = &mut self.cameras[before..];
        if inside.is_empty() {
            place.extend(named);
        } else {
            share(inside, &named)?;
        }
        if !place.is_empty() {
            self.parts.push(Part {
                name: name.to_owned(),
                fields: place,
                whole,
            });
        }
        Ok(())
    }

    /// Whether a value is about cameras, or has values of one.
    fn is_part(&self, key: &str, value: &Value) -> bool {
        let placed = |fields: &BTreeMap<&str, String>| is_placed(|key| fields.get(key));
        has_camera(value)
            || has(value, &placed)
            || (value.is_object()
                && value.get("data").is_none()
                && !unread::is_harmless(key, value)
                && !own_fields(value).is_empty())
    }

    /// Cameras whose keys end in their names; what else ends so is of rectified images, or was not read.
    fn of_suffixes(
        &mut self,
        numbered: BTreeMap<String, Vec<(String, &'static str, Value)>>,
    ) -> Checked<Vec<(String, Fields)>> {
        let mut cameras = Vec::new();
        for (suffix, of_one) in numbered {
            if !of_one.iter().any(|(_, field, _)| *field == "K") {
                let rest = of_one.into_iter();
                let rest = rest.filter(|(key, _, value)| unread::matters(key, value));
                self.unread.extend(rest.map(|(key, ..)| key));
                continue;
            }
            let mut fields = Fields::new();
            for (key, field, value) in of_one {
                if fields.contains_key(field) {
                    return Err(format!("`{key}` is there twice, under different names"));
                }
                if field == "size" {
                    fields.insert(SIZE_KEY.to_owned(), key.into());
                }
                fields.insert(field.to_owned(), value);
            }
            cameras.push((suffix, fields));
        }
        cameras.sort_by_cached_key(|(suffix, _)| in_parts(suffix));
        let named = cameras.into_iter().map(|(suffix, fields)| {
            let id = match suffix.parse::<u32>() {
                Ok(_) => format!("cam{suffix}"),
                Err(_) => suffix,
            };
            (id, fields)
        });
        Ok(named.collect())
    }

    /// Joins what several objects say of one camera; what is left is the R and T of a pair, each camera of which may
    /// have a place of its own as well.
    pub fn join(&mut self) -> Checked<Option<Pair>> {
        if self.cameras.is_empty() {
            return Err("expected camera matrices (K, M1, camera_matrix, ... of 3x3 numbers) or fx, fy, cx, cy, \
                        got none"
                .into());
        }
        for (index, (id, _)) in self.cameras.iter().enumerate() {
            if self.cameras[..index].iter().any(|(other, _)| other == id) {
                return Err(format!(
                    "two cameras are called `{id}`; give each a name of its own, as that of its file or in its entry"
                ));
            }
        }
        let mut left = Vec::new();
        for mut part in std::mem::take(&mut self.parts) {
            if let Some((id, camera)) = named(&mut self.cameras, &part.name) {
                merge(id, camera, part.fields)?;
                continue;
            }
            if part.whole {
                let (place, of_all) = of_place(part.fields);
                share(&mut self.cameras, &of_all)?;
                part.fields = place;
            }
            if !part.fields.is_empty() {
                left.push(part);
            }
        }
        let placed = |(_, fields): &(String, Fields)| is_placed(|key| fields.get(key));
        match (left.len(), self.cameras.as_mut_slice()) {
            (0, _) => Ok(None),
            (1, [(id, camera)]) if left[0].whole => {
                merge(id, camera, left.remove(0).fields)?;
                Ok(None)
            }
            (1, cameras)
                if is_pair(&left[0], cameras)?
                    && (!cameras.iter().any(placed) || cameras.iter().all(placed)) =>
            {
                let Part { name, fields, .. } = left.remove(0);
                let (mut fields, of_all) = of_place(fields);
                share(cameras, &of_all)?;
                if cameras
                    .iter()
                    .any(|(_, fields)| fields.contains_key(BY_COLUMNS))
                {
                    fields.insert(BY_COLUMNS.to_owned(), true.into());
                }
                Ok(Some(Pair { name, fields }))
            }
            _ => {
                let places = left
                    .iter()
                    .any(|part| is_placed(|key| part.fields.get(key)));
                let names =
                    |list: Vec<&str>| list.into_iter().take(4).collect::<Vec<_>>().join(", ");
                Err(format!(
                    "there are {} of {}, but the cameras are called {}; give both the same names, or leave out \
                     what is of no camera",
                    if places { "places" } else { "lenses or sizes" },
                    names(left.iter().map(|part| part.name.as_str()).collect()),
                    names(self.cameras.iter().map(|(name, _)| name.as_str()).collect()),
                ))
            }
        }
    }

    /// Refuses what is stated and was not read.
    pub fn refuse_unread(&self, options: &Options) -> Checked<()> {
        unread::refuse_all(self.unread.iter().cloned(), options)
    }

    /// Metres per unit of length, where the file says it.
    pub fn metres(&self, options: &Options) -> Checked<Option<f64>> {
        let Some(first) = self.units.first() else {
            return Ok(None);
        };
        let asked = options.metres().unwrap_or(first.metres());
        match self.units.iter().all(|unit| unit.metres() == asked) {
            true => Ok(Some(asked)),
            false => Err(
                "the unit of length that is stated is not the one of all, or not the one of `unit` (--unit) or \
                 `scale` (--scale); leave these out"
                    .into(),
            ),
        }
    }
}

fn unit(key: &str, value: &Value) -> Checked<Unit> {
    let known = value.as_str().and_then(Unit::of_file);
    known.ok_or_else(|| format!("`{key}`: expected m, cm or mm, got {value}"))
}
