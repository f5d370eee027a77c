//! From the text of a rig file to a checked [`Rig`].

use serde_json::Value;

use super::fields::{Checked, Fields, shorten, show};
use super::{FORMAT, Rig, VERSION, unit};
use crate::camera::{self, Camera, Intrinsics, Projection};
use crate::{Error, Result, json, transform};

/// Reads a rig.
///
/// - `origin`: how to name it in an error
pub(super) fn rig(origin: &str, text: &str) -> Result<Rig> {
    let refused = |problem, cause| Error::Rig {
        origin: origin.to_owned(),
        problem,
        cause,
    };
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let value = json::from_str(text).map_err(|error| refused(syntax(text, &error), Some(error)))?;
    read(&value).map_err(|problem| refused(problem, None))
}

/// The error is one sentence without the rig's name.
fn read(value: &Value) -> Checked<Rig> {
    let fields = Fields::new(
        "top level".into(),
        value,
        &["format", "version", "unit", "cameras"],
        &["reference", "trust_unit"],
    )?;
    if fields.value("format") != FORMAT {
        return Err(fields.wrong("format", &format!("\"{FORMAT}\"")));
    }
    if fields.value("version") != VERSION {
        return Err(fields.wrong("version", &VERSION.to_string()));
    }
    let unit = unit::Unit::named(fields.text("unit")?)
        .ok_or_else(|| fields.wrong("unit", "one of \"m\", \"cm\" and \"mm\""))?;
    let list = fields.list("cameras")?.iter().enumerate();
    let cameras = list.map(|(index, value)| camera(index, value, unit.metres));
    let mut rig = Rig::checked(cameras.collect::<Checked<_>>()?, 0)?;
    if fields.optional("reference").is_some() {
        let id = fields.text("reference")?;
        rig.reference = rig.index_of(id).ok_or_else(|| {
            let ids: Vec<_> = rig.cameras.iter().map(Camera::id).collect();
            let (id, ids) = (shorten(id), shorten(&ids.join(", ")));
            format!("`reference` is `{id}`, but the cameras are {ids}")
        })?;
    }
    match unit::implausible(&rig.cameras) {
        Some(spread) if !fields.flag("trust_unit")? => Err(spread.in_unit(unit)),
        _ => Ok(rig),
    }
}

fn syntax(text: &str, error: &serde_json::Error) -> String {
    let line = text.lines().nth(error.line().saturating_sub(1));
    let rest = line.and_then(|line| line.get(error.column().saturating_sub(1)..));
    // Python's json writes these, but they are no JSON.
    let words = ["NaN", "Infinity", "-Infinity"];
    let hint = match rest {
        Some(rest) if words.iter().any(|word| rest.starts_with(word)) => {
            "; NaN and Infinity are not allowed"
        }
        _ => "",
    };
    format!("not valid JSON: {error}{hint}")
}

fn camera(index: usize, value: &Value, unit: f64) -> Checked<Camera> {
    // Errors name the camera by its id as soon as it has a usable one.
    let id_problem = camera::id_problem;
    let place = match value.get("id").and_then(Value::as_str) {
        Some(id) if id_problem(id).is_none() => format!("camera `{id}`"),
        _ => format!("camera number {}", index + 1),
    };
    let fields = Fields::new(
        place,
        value,
        &["id", "width", "height", "fx", "fy", "cx", "cy"],
        &[
            "model",
            "skew",
            "distortion",
            "max_angle_deg",
            "T_world_cam",
            "T_cam_world",
        ],
    )?;
    let place = &fields.place;
    let id = fields.text("id")?;
    if let Some(problem) = id_problem(id) {
        return Err(format!("{place}: {problem}"));
    }
    let size = [side(&fields, "width")?, side(&fields, "height")?];
    let [fx, fy] = [fields.number("fx")?, fields.number("fy")?];
    let [cx, cy] = [fields.number("cx")?, fields.number("cy")?];
    let optional = |key| fields.optional(key).map(|_| fields.number(key)).transpose();
    let (skew, max_angle) = (optional("skew")?, optional("max_angle_deg")?);
    let intrinsics = Intrinsics::new(fx, fy, cx, cy, projection(&fields)?)
        .and_then(|lens| lens.with_skew(skew.unwrap_or_default()))
        .and_then(|lens| match max_angle {
            Some(degrees) => lens.with_max_angle(degrees),
            None => Ok(lens),
        })
        .map_err(|error| format!("{place}: {error}"))?;
    Camera::new(id, size, intrinsics, world_from_cam(&fields, unit)?)
        .map_err(|error| error.to_string())
}

fn side(fields: &Fields, key: &str) -> Checked<u32> {
    let side = fields.number(key)?;
    if side.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&side) {
        Ok(side as u32)
    } else {
        let problem = camera::side_problem(key, &show(fields.value(key)));
        Err(format!("{}: {problem}", fields.place))
    }
}

fn projection(fields: &Fields) -> Checked<Projection> {
    let place = &fields.place;
    let family = match fields.optional("model") {
        Some(_) => fields.text("model")?,
        None => "pinhole",
    };
    let (distortion, params) = match fields.optional("distortion") {
        None => (None, Vec::new()),
        Some(value) => {
            let place = format!("{place}, `distortion`");
            let fields = Fields::new(place, value, &["model", "params"], &[])?;
            (Some(fields.text("model")?), fields.numbers("params")?)
        }
    };
    let (family, distortion) = (shorten(family), distortion.map(shorten));
    Projection::from_params(&family, distortion.as_deref(), &params)
        .map_err(|error| format!("{place}: {error}"))
}

fn world_from_cam(fields: &Fields, unit: f64) -> Checked<nalgebra::Isometry3<f64>> {
    let place = &fields.place;
    let read = |key: &str, value| transform::from_json(format!("{place}, `{key}`"), value, unit);
    let [world_cam, cam_world] = ["T_world_cam", "T_cam_world"].map(|key| fields.optional(key));
    match (world_cam, cam_world) {
        (Some(value), None) => read("T_world_cam", value),
        (None, Some(value)) => read("T_cam_world", value).map(|pose| pose.inverse()),
        (Some(_), Some(_)) => Err(format!(
            "{place}: give only one of `T_world_cam` (camera to world) and `T_cam_world` (world \
             to camera)"
        )),
        (None, None) => Err(format!(
            "{place}: its place is missing, give either `T_world_cam` (camera to world) or \
             `T_cam_world` (world to camera)"
        )),
    }
}
