//! One camera by OpenCV's names: its matrix, lens, size and pose.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde_json::Value;

use super::found::{BY_COLUMNS, SIZE_KEY};
use super::keys::{direction, is_yes, size_of_text};
use super::order::rows_first;
use crate::draft::{self, DraftCamera, Pose};
use crate::lens::{Foreign, Lens, Plane};
use crate::node::Node;
use crate::{Checked, Direction, Options};

/// Coefficients that have a key each, as `brown_conrady` orders them.
const BROWN: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
/// Largest difference of two rotations that are the same, radians.
pub const SAME_ROTATION: f64 = 1e-3;

/// What is said of one camera, by the names of [`super::keys`].
pub fn camera(
    id: &str,
    node: &Node,
    options: &Options,
    notes: &mut Vec<String>,
) -> Checked<DraftCamera> {
    let of = |problem: String| format!("camera `{id}`: {problem}");
    let plane = match node.find(&["K"]) {
        Some(matrix) => {
            let plane = Plane::from_matrix(matrix.vector()?).map_err(of)?;
            for (key, there) in [
                ("fx", plane.fx),
                ("fy", plane.fy),
                ("cx", plane.cx),
                ("cy", plane.cy),
            ] {
                let other = node.find(&[key]).map(|node| node.number()).transpose()?;
                draft::same_number(&format!("`{key}`"), other, there).map_err(of)?;
            }
            plane
        }
        None => {
            let number = |key: &str| node.get(&[key])?.number();
            Plane::new([number("fx")?, number("fy")?, number("cx")?, number("cy")?])
        }
    };
    let lens = lens(node, options, notes).map_err(of)?;
    let size = size(id, node, &plane, options)?;
    if let Some((roi, size)) = node.find(&["roi"]).zip(size.or(options.size_of(id))) {
        draft::whole_image(&roi, size)?;
    }
    Ok(DraftCamera {
        id: draft::id(id),
        size,
        plane,
        lens,
        pose: pose(node)?,
    })
}

/// By its name; where there is none, by the names of its coefficients.
fn lens(node: &Node, options: &Options, notes: &mut Vec<String>) -> Checked<Lens> {
    let number = |key: &str| node.find(&[key]).map(|node| node.number()).transpose();
    let stated = node.find(&["fisheye"]).and_then(|node| is_yes(node.value));
    let fisheye = stated == Some(true);
    let named = node.find(&["model"]).and_then(|model| model.value.as_str());
    let is_named_fisheye =
        |name: &str| Lens::named(name, &[0.0; 4]).is_ok_and(|lens| lens.is_fisheye());
    if let Some(asked) = options.model.as_deref() {
        let said = stated.or(named.map(is_named_fisheye));
        if said.is_some_and(|said| said != is_named_fisheye(asked)) {
            return Err(format!(
                "the file states another lens than `model` (--model {asked}); leave that out"
            ));
        }
    }
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
    let is_fisheye = fisheye || model.is_some_and(is_named_fisheye);
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

/// Width and height, px; of a list, its name and the principal point tell the order.
fn size(id: &str, node: &Node, plane: &Plane, options: &Options) -> Checked<Option<[u32; 2]>> {
    let sides = match (node.find(&["width"]), node.find(&["height"])) {
        (Some(width), Some(height)) => Some([width.pixels()?, height.pixels()?]),
        _ => None,
    };
    let Some(list) = node.find(&["size"]) else {
        return Ok(sides);
    };
    let key = node
        .find(&[SIZE_KEY])
        .map_or("size", |key| key.value.as_str().unwrap_or("size"));
    let size = match list.value.as_str().and_then(size_of_text) {
        Some(size) => size,
        None => {
            let order = rows_first(key);
            let sides = listed(&list, order)?;
            draft::ordered_size(id, key, order, sides, plane, options)?
        }
    };
    match sides {
        Some(sides) if sides != size => Err(format!(
            "camera `{id}`: `{key}` of {}x{} px and a width and height of {}x{} px differ; leave one out",
            size[0], size[1], sides[0], sides[1]
        )),
        _ => Ok(Some(size)),
    }
}

/// Two sides; a shape may have the number of channels behind them.
fn listed(list: &Node, rows_first: Option<bool>) -> Checked<[u32; 2]> {
    match list.numbers()?.as_slice() {
        [rows, columns, channels]
            if rows_first == Some(true) && [1.0, 3.0, 4.0].contains(channels) =>
        {
            let two = Value::from(vec![*rows, *columns]);
            Node::new(&two, &list.place).size()
        }
        _ => list.size(),
    }
}

/// rvec and tvec are OpenCV's, from world to camera, unless a direction is stated; what else there may be does not
/// say.
fn pose(node: &Node) -> Checked<Option<Pose>> {
    let stated = node.find(&["direction"]);
    let stated = stated.and_then(|text| direction(text.value.as_str()?));
    let mut found = Vec::new();
    for (key, direction) in [
        ("world_from_cam", Some(Direction::WorldFromCam)),
        ("cam_from_world", Some(Direction::CamFromWorld)),
        ("pose", stated),
    ] {
        if let Some(matrix) = node.find(&[key]) {
            if stated.is_some() && stated != direction {
                return Err(format!(
                    "{}: its name and the direction that is stated do not agree; leave the wrong one out",
                    matrix.place
                ));
            }
            let transform = draft::rigid(&matrix.place, &matrix.matrix4()?)?;
            found.push(Pose {
                transform,
                direction,
            });
        }
    }
    if ["R", "rvec", "T"].iter().any(|key| node.has(key)) {
        found.push(Pose {
            transform: transform(node)?,
            direction: stated.or(node.has("rvec").then_some(Direction::CamFromWorld)),
        });
    }
    let mut found = found.into_iter();
    let first = found.next();
    match found.next() {
        Some(_) => Err(format!(
            "{}: its place is there twice, as a matrix and otherwise; leave one out",
            node.place
        )),
        None => Ok(first),
    }
}

/// R, or a Rodrigues vector that is called one, with T.
pub fn transform(node: &Node) -> Checked<Isometry3<f64>> {
    let t: [f64; 3] = node.get(&["T"])?.vector()?;
    let rotation = node.get(&["R", "rvec"])?;
    let place = &rotation.place;
    let &[x, y, z] = rotation.numbers()?.as_slice() else {
        if node.has(BY_COLUMNS) && rotation.value.get(0).is_some_and(Value::is_number) {
            return Err(format!(
                "{place}: nine numbers in a row are columns to librealsense and rows to others; give a list of \
                 three rows"
            ));
        }
        let pose = draft::rotation_and_translation(place, &rotation.vector()?, t)?;
        if let Some(vector) = node.find(&["rvec"]).filter(|_| node.has("R")) {
            let vector = UnitQuaternion::from_scaled_axis(Vector3::from(vector.vector::<3>()?));
            if pose.rotation.angle_to(&vector) > SAME_ROTATION {
                return Err(format!(
                    "{place}: it and its Rodrigues vector are different rotations; leave the wrong one out"
                ));
            }
        }
        return Ok(pose);
    };
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
