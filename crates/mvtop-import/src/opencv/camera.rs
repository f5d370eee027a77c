//! One camera by OpenCV's names: its matrix, lens, size and pose.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde_json::Value;

use super::SIZE_KEY;
use super::keys::rows_first;
use crate::draft::{self, DraftCamera, Pose};
use crate::lens::{Foreign, Lens, Plane};
use crate::node::Node;
use crate::{Checked, Direction, Options};

/// Coefficients that have a key each, as `brown_conrady` orders them.
const BROWN: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
/// A principal point farther from the middle of its image is implausible, share of a side.
const OFF_MIDDLE: f64 = 0.1;

/// What is said of one camera, by the names of [`super::keys`].
pub fn camera(
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
pub fn transform(node: &Node) -> Checked<Isometry3<f64>> {
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
