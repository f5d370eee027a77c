//! HALCON's camera parameters (`write_cam_par`) and poses (`write_pose`), a file each.
//!
//! Lengths on the sensor are metres, and so are coefficients: a radius of one focal length is `Focus`.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Foreign, Lens, Plane};
use crate::names::matched;
use crate::source::Source;
use crate::{Checked, Options, unread};

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let is_pose = |source: &&Source| {
        let text = source.text().unwrap_or_default();
        let mut lines = text.lines().map(str::trim);
        lines.any(|line| line.starts_with("t ")) && !text.contains("Focus")
    };
    let (poses, cameras): (Vec<_>, Vec<_>) = sources.iter().partition(is_pose);
    if ![0, cameras.len()].contains(&poses.len()) {
        return Err(format!(
            "expected a file of pose for each of the {} files of camera parameters, in the same order, \
             got {}",
            cameras.len(),
            poses.len()
        ));
    }
    let stems = |all: &[&Source]| all.iter().map(|source| source.stem()).collect::<Vec<_>>();
    let of_camera = matched(&stems(&poses), &stems(&cameras))?;
    let pose_of = |index: usize| match &of_camera {
        Some(of) => of.iter().position(|camera| *camera == index),
        None => Some(index),
    };
    let mut draft = Vec::new();
    for (index, source) in cameras.iter().enumerate() {
        let mut camera = camera(source, options)?;
        if let Some(source) = pose_of(index).and_then(|pose| poses.get(pose)) {
            let transform =
                pose(source.text()?).map_err(|problem| format!("{}: {problem}", source.name))?;
            camera.pose = Some(Pose {
                transform,
                direction: None,
            });
        }
        draft.push(camera);
    }
    Ok(Draft {
        cameras: draft,
        metres: Some(1.0),
        posing: "give a file of pose (write_pose) for each camera, in the same order",
        notes: Vec::new(),
    })
}

fn camera(source: &Source, options: &Options) -> Checked<DraftCamera> {
    let of = |problem: String| format!("{}: {problem}", source.name);
    let mut values: BTreeMap<String, f64> = BTreeMap::new();
    let mut texts = Vec::new();
    for line in source.text()?.lines() {
        // `Focus:foc: 0.008;`; further lines, indented, say its type and what it is.
        if line.starts_with([' ', '\t', '#']) {
            continue;
        }
        let mut parts = line.splitn(3, ':').map(str::trim);
        let (Some(name), Some(_), Some(value)) = (parts.next(), parts.next(), parts.next()) else {
            continue;
        };
        let value = value.trim_end_matches(';').trim();
        if value.parse::<f64>().is_err()
            && name != "ParGroup"
            && unread::matters(name, &value.into())
        {
            texts.push(name.to_owned());
        }
        if let Ok(value) = value.parse::<f64>() {
            if !value.is_finite() {
                return Err(of(format!("`{name}` must be a finite number, got {value}")));
            }
            if values.insert(name.to_lowercase(), value).is_some() {
                return Err(of(format!("`{name}` is there twice")));
            }
        }
    }
    let get = |key: &str| values.get(key).copied();
    let need = |key: &str| get(key).ok_or_else(|| of(format!("the parameter `{key}` is missing")));
    let other = [
        ("vx", "a line scan camera"),
        ("vy", "a line scan camera"),
        ("magnification", "a telecentric lens"),
        ("tilt", "a tilted lens"),
        ("rot", "a tilted lens"),
        ("imageplanedist", "a tilted lens"),
    ];
    if let Some((_, what)) = other.iter().find(|(key, _)| get(key).is_some()) {
        return Err(of(format!(
            "{what} cannot be expressed; expected an area scan camera with a plain lens"
        )));
    }
    let known = |key: &str| {
        [
            "focus",
            "sx",
            "sy",
            "cx",
            "cy",
            "kappa",
            "imagewidth",
            "imageheight",
        ]
        .contains(&key)
            || (1..=5).any(|number| key == format!("poly{number}"))
    };
    let rest = values
        .iter()
        .filter(|(key, value)| !known(key) && **value != 0.0);
    let rest = rest.map(|(key, _)| key.clone()).chain(texts);
    unread::refuse_all(rest, options).map_err(of)?;
    let focus = need("focus")?;
    if focus <= 0.0 {
        return Err(of("a telecentric lens (Focus 0) cannot be expressed".into()));
    }
    let [sx, sy] = [need("sx")?, need("sy")?];
    if sx <= 0.0 || sy <= 0.0 {
        return Err(of(format!(
            "`Sx` and `Sy` must be above 0, got {sx} and {sy}"
        )));
    }
    let plane = Plane::new([focus / sx, focus / sy, need("cx")?, need("cy")?]);
    let poly = |number: usize| get(&format!("poly{number}"));
    let lens = match (get("kappa"), poly(1)) {
        (Some(_), Some(_)) => return Err(of("expected Kappa or Poly1 to Poly5, got both".into())),
        (Some(kappa), None) => Foreign::Division {
            k: kappa * focus * focus,
        },
        (None, Some(_)) => {
            let p = |number| poly(number).ok_or_else(|| of(format!("`Poly{number}` is missing")));
            let f2 = focus * focus;
            Foreign::Polynomial {
                k: [p(1)? * f2, p(2)? * f2 * f2, p(3)? * f2 * f2 * f2],
                p: [p(4)? * focus, p(5)? * focus],
            }
        }
        (None, None) => return Err(of("expected Kappa or Poly1 to Poly5, got neither".into())),
    };
    let lens = match lens {
        Foreign::Division { k: 0.0 }
        | Foreign::Polynomial {
            k: [0.0, 0.0, 0.0],
            p: [0.0, 0.0],
        } => Lens::PINHOLE,
        lens => Lens::Foreign(lens),
    };
    let side = |key: &str| match need(key)? {
        side if side.fract() == 0.0 && (1.0..=1e9).contains(&side) => Ok(side as u32),
        side => Err(of(format!(
            "`{key}` must be a whole number of pixels, got {side}"
        ))),
    };
    Ok(DraftCamera {
        id: draft::id(&source.stem()),
        size: Some([side("imagewidth")?, side("imageheight")?]),
        plane,
        lens,
        pose: None,
    })
}

/// Lines `f`, `r` and `t`: the kind of representation, three numbers of rotation, and metres.
fn pose(text: &str) -> Checked<Isometry3<f64>> {
    let line = |start: &str| -> Checked<Vec<f64>> {
        let mut lines = text.lines().map(str::trim);
        let line = lines.find_map(|line| line.strip_prefix(start)?.strip_prefix([' ', '\t']));
        let line =
            line.ok_or_else(|| format!("expected a line that starts with `{start}`, got none"))?;
        let parse = |word: &str| word.parse::<f64>().ok().filter(|x| x.is_finite());
        let numbers: Option<Vec<f64>> = line.split_whitespace().map(parse).collect();
        numbers.ok_or_else(|| format!("`{start}` must be finite numbers, got {line:?}"))
    };
    let three = |start: &str| -> Checked<[f64; 3]> {
        let numbers = line(start)?;
        numbers
            .try_into()
            .map_err(|n: Vec<f64>| format!("`{start}` must be 3 numbers, got {}", n.len()))
    };
    let code = line("f")?.first().copied().unwrap_or(-1.0);
    let ([a, b, c], t) = (three("r")?, three("t")?);
    let about = |axis: nalgebra::Unit<Vector3<f64>>, deg: f64| {
        Rotation3::from_axis_angle(&axis, deg.to_radians())
    };
    let (x, y, z) = (
        about(Vector3::x_axis(), a),
        about(Vector3::y_axis(), b),
        about(Vector3::z_axis(), c),
    );
    // Codes of create_pose: from 8 on the translation comes before the rotation; the rest is how the
    // rotation is written. Odd ones turn coordinate systems instead of points.
    let rotation: UnitQuaternion<f64> = match code {
        0.0 | 8.0 => (x * y * z).into(),
        2.0 | 10.0 => (z * y * x).into(),
        // HALCON's vector is as long as the tangent of half the angle.
        4.0 | 12.0 => UnitQuaternion::from_quaternion(Quaternion::new(1.0, a, b, c)),
        _ => {
            return Err(format!(
                "the kind of representation `f` must be 0, 2, 4, 8, 10 or 12, got {code}; convert the \
                 pose with convert_pose_type to 'Rp+T', 'gba', 'point'"
            ));
        }
    };
    let t = Translation3::new(t[0], t[1], t[2]);
    Ok(match code >= 8.0 {
        true => Isometry3::from_parts(Translation3::identity(), rotation) * t.inverse(),
        false => Isometry3::from_parts(t, rotation),
    })
}
