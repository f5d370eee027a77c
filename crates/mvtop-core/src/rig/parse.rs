//! From the text of a rig file to a checked [`Rig`].

use serde_json::Value;

use super::fields::{Checked, Fields, shorten, show};
use super::{FORMAT, Rig, VERSION, transform, unit};
use crate::camera::{BrownConrady, Camera, Distortion, KannalaBrandt, Lens};

/// Longest image side, px, and most cameras: far above real rigs, low enough to bound memory.
const LONGEST_SIDE: f64 = 20_000.0;
const MOST_CAMERAS: usize = 1000;
/// Longest id, bytes; ids become parts of file names.
const LONGEST_ID: usize = 100;

/// Reads a rig; the error is one sentence without the file's name.
pub(super) fn rig(text: &str) -> Checked<Rig> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let value: Value = serde_json::from_str(text).map_err(|error| syntax(text, &error))?;
    let fields = Fields::new(
        "top level".into(),
        &value,
        &["format", "version", "unit", "cameras"],
        &["reference"],
    )?;
    if fields.value("format") != FORMAT {
        return Err(fields.wrong("format", &format!("\"{FORMAT}\""), fields.value("format")));
    }
    if fields.value("version") != VERSION {
        return Err(fields.wrong("version", &VERSION.to_string(), fields.value("version")));
    }
    let unit = unit::Unit::named(fields.text("unit")?).ok_or_else(|| {
        fields.wrong(
            "unit",
            "one of \"m\", \"cm\" and \"mm\"",
            fields.value("unit"),
        )
    })?;
    let list = fields.list("cameras")?;
    if list.is_empty() || list.len() > MOST_CAMERAS {
        return Err(format!(
            "`cameras` must list 1 to {MOST_CAMERAS} cameras, got {}",
            list.len()
        ));
    }
    let mut cameras: Vec<Camera> = Vec::with_capacity(list.len());
    for (index, value) in list.iter().enumerate() {
        let camera = camera(index, value, unit.metres())?;
        if cameras.iter().any(|other| other.id == camera.id) {
            return Err(format!(
                "two cameras have the id `{}`; ids must differ",
                camera.id
            ));
        }
        cameras.push(camera);
    }
    let reference = match fields.optional("reference") {
        None => 0,
        Some(_) => {
            let id = fields.text("reference")?;
            cameras
                .iter()
                .position(|camera| camera.id == id)
                .ok_or_else(|| {
                    let ids: Vec<_> = cameras.iter().map(|camera| camera.id.as_str()).collect();
                    format!(
                        "`reference` is `{}`, but the cameras are {}",
                        shorten(id),
                        shorten(&ids.join(", "))
                    )
                })?
        }
    };
    unit.check(&cameras)?;
    Ok(Rig { cameras, reference })
}

fn syntax(text: &str, error: &serde_json::Error) -> String {
    let line = text
        .lines()
        .nth(error.line().saturating_sub(1))
        .unwrap_or("");
    let rest = line.get(error.column().saturating_sub(1)..).unwrap_or("");
    // Python's json writes these, but they are no JSON.
    let hint = if ["NaN", "Infinity", "-Infinity"]
        .iter()
        .any(|word| rest.starts_with(word))
    {
        "; NaN and Infinity are not allowed"
    } else {
        ""
    };
    format!("not valid JSON: {error}{hint}")
}

fn camera(index: usize, value: &Value, unit: f64) -> Checked<Camera> {
    // Errors name the camera by its id as soon as it has a usable one.
    let place = match value.get("id").and_then(Value::as_str) {
        Some(id) if id_problem(id).is_none() => format!("camera `{id}`"),
        _ => format!("camera number {}", index + 1),
    };
    let fields = Fields::new(
        place,
        value,
        &["id", "width", "height", "fx", "fy", "cx", "cy"],
        &["model", "distortion", "T_world_cam", "T_cam_world"],
    )?;
    let id = fields.text("id")?;
    if let Some(problem) = id_problem(id) {
        return Err(format!(
            "{}: the id {:?} {problem}",
            fields.place,
            shorten(id)
        ));
    }
    let (width, height) = (side(&fields, "width")?, side(&fields, "height")?);
    Ok(Camera {
        id: id.to_owned(),
        width,
        height,
        lens: Lens {
            fx: focal_length(&fields, "fx", width)?,
            fy: focal_length(&fields, "fy", height)?,
            cx: principal_point(&fields, "cx", "width", width)?,
            cy: principal_point(&fields, "cy", "height", height)?,
            distortion: distortion(&fields)?,
        },
        world_from_cam: world_from_cam(&fields, unit)?,
    })
}

fn id_problem(id: &str) -> Option<String> {
    let usable = |c: char| c.is_alphanumeric() || "._-".contains(c);
    if id.is_empty() {
        Some("is empty".into())
    } else if id.len() > LONGEST_ID {
        Some(format!("is longer than {LONGEST_ID} bytes"))
    } else if !id.chars().all(usable) || id.starts_with(['.', '-']) {
        Some(
            "cannot be part of a file name; use letters, digits, `_`, `-` and `.`, starting with \
             a letter, a digit or `_`"
                .into(),
        )
    } else {
        None
    }
}

fn side(fields: &Fields, key: &str) -> Checked<u32> {
    let side = fields.number(key)?;
    if side.fract() == 0.0 && (1.0..=LONGEST_SIDE).contains(&side) {
        Ok(side as u32)
    } else {
        let expected = format!("a whole number of pixels from 1 to {LONGEST_SIDE}");
        Err(fields.wrong(key, &expected, fields.value(key)))
    }
}

fn focal_length(fields: &Fields, key: &str, side: u32) -> Checked<f64> {
    let focal = fields.number(key)?;
    let place = &fields.place;
    if focal <= 0.0 {
        Err(format!(
            "{place}: the focal length `{key}` must be above 0 px, got {focal}"
        ))
    } else if focal < f64::from(side) / 100.0 {
        Err(format!(
            "{place}: the focal length `{key}` of {focal} px is too short for an image of {side} \
             px; give it in pixels, not in mm or as a share of the image"
        ))
    } else {
        Ok(focal)
    }
}

fn principal_point(fields: &Fields, key: &str, side_key: &str, side: u32) -> Checked<f64> {
    let center = fields.number(key)?;
    let side = f64::from(side);
    if (-side..=2.0 * side).contains(&center) {
        Ok(center)
    } else {
        Err(format!(
            "{}: the principal point `{key}` of {center} px lies more than one image size outside \
             the image of `{side_key}` {side} px",
            fields.place
        ))
    }
}

fn distortion(fields: &Fields) -> Checked<Distortion> {
    let place = &fields.place;
    let fisheye = match fields
        .optional("model")
        .map(|model| (model, model.as_str()))
    {
        None | Some((_, Some("pinhole"))) => false,
        Some((_, Some("fisheye"))) => true,
        Some((other, _)) => {
            return Err(fields.wrong("model", "\"pinhole\" or \"fisheye\"", other));
        }
    };
    let (model, params) = match fields.optional("distortion") {
        None if fisheye => ("kannala_brandt", vec![0.0; 4]),
        None => return Ok(Distortion::None),
        Some(value) => {
            let place = format!("{place}, `distortion`");
            let fields = Fields::new(place, value, &["model", "params"], &[])?;
            (fields.text("model")?, fields.numbers("params")?)
        }
    };
    match (fisheye, model) {
        (false, "brown_conrady") if params.is_empty() => Ok(Distortion::None),
        (false, "brown_conrady") => BrownConrady::new(&params).map(Distortion::BrownConrady),
        (true, "kannala_brandt") => KannalaBrandt::new(&params).map(Distortion::KannalaBrandt),
        (false, "kannala_brandt") => {
            return Err(format!(
                "{place}: the distortion kannala_brandt needs `model` \"fisheye\", got \"pinhole\""
            ));
        }
        (true, "brown_conrady") => {
            return Err(format!(
                "{place}: the distortion brown_conrady needs `model` \"pinhole\", got \"fisheye\""
            ));
        }
        (_, other) => {
            return Err(format!(
                "{place}: the distortion's `model` must be \"brown_conrady\" or \
                 \"kannala_brandt\", got {}",
                show(&other.into())
            ));
        }
    }
    .map_err(|error| format!("{place}: {error}"))
}

fn world_from_cam(fields: &Fields, unit: f64) -> Checked<nalgebra::Isometry3<f64>> {
    let place = &fields.place;
    let read = |key: &str, value| transform::read(format!("{place}, `{key}`"), value, unit);
    match (
        fields.optional("T_world_cam"),
        fields.optional("T_cam_world"),
    ) {
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
