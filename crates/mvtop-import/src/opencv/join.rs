//! Joins what several objects say of one camera.

use serde_json::Value;

use super::found::{Fields, PLACE, SIZE_KEY};
use crate::names::own_words;
use crate::unread::plain;
use crate::{Checked, draft};

/// Puts a field among others; what is there already must not be another one.
pub fn put(fields: &mut Fields, field: &str, value: Value) -> Checked<()> {
    let pinhole = |value: &Value| value.as_str().is_some_and(|name| plain(name) == "pinhole");
    match fields.get(field) {
        Some(there) if *there == value => {}
        // `camera_model: pinhole` and `distortion_model: radtan` are one lens.
        Some(there) if field == "model" && pinhole(there) => {
            fields.insert(field.to_owned(), value);
        }
        Some(_) if field == "model" && pinhole(&value) => {}
        Some(_) if field == SIZE_KEY => {}
        Some(_) => return Err(format!("`{field}` is there twice; leave one out")),
        None => {
            fields.insert(field.to_owned(), value);
        }
    }
    Ok(())
}

/// The camera of that name; `rgbDistortion` is of `rgbIntrinsic`, unless there are several of that kind.
pub fn named<'a>(
    cameras: &'a mut [(String, Fields)],
    name: &str,
) -> Option<&'a mut (String, Fields)> {
    let (id, bare) = (draft::id(name), own_words(name));
    let exact = cameras.iter().position(|(other, _)| *other == id);
    let alike = cameras.iter().enumerate();
    let mut alike = alike.filter(|(_, (other, _))| !bare.is_empty() && own_words(other) == bare);
    let index = exact.or_else(|| match (alike.next(), alike.next()) {
        (Some((index, _)), None) => Some(index),
        _ => None,
    })?;
    cameras.get_mut(index)
}

/// Adds values of a camera from another place.
pub fn merge(id: &str, camera: &mut Fields, more: Fields) -> Checked<()> {
    for (field, value) in more {
        let twice = PLACE.contains(&field.as_str()) && camera.contains_key(&field);
        let done = match twice {
            true => Err(format!("`{field}` is there twice; leave one out")),
            false => put(camera, &field, value),
        };
        done.map_err(|problem| format!("camera `{id}`: {problem}"))?;
    }
    Ok(())
}

/// Gives each camera the values of all.
pub fn share(cameras: &mut [(String, Fields)], of_all: &Fields) -> Checked<()> {
    for (id, camera) in cameras {
        merge(id, camera, of_all.clone())?;
    }
    Ok(())
}
