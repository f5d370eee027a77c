//! NeRF's `transforms.json`: poses of cameras in OpenGL's axes, in a unit of their own.

use nalgebra::Matrix4;

use crate::draft::{self, Draft, DraftCamera, Pose, opencv_from_opengl};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::opencv::keys::is_yes;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};

/// What is read of lenses; the files have many keys of other kinds.
const LENS: [&str; 7] = ["k1", "k2", "k3", "k4", "p1", "p2", "is_fisheye"];

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let [source] = sources else {
        return Err(format!(
            "expected one transforms.json, got {} files",
            sources.len()
        ));
    };
    let document = yaml::document(source)?;
    let top = Node::new(&document, &source.name);
    let mut cameras = Vec::new();
    for frame in top.get(&["frames"])?.list()? {
        cameras.push(camera(&top, &frame, options)?);
    }
    Ok(Draft {
        cameras,
        metres: None,
        posing: "give its transform_matrix",
        notes: vec![
            "poses were turned from OpenGL's axes (y up, z backward) to y down, z forward".into(),
            "principal points count from the corner of the image, so half a pixel was taken off"
                .into(),
        ],
    })
}

fn camera(top: &Node, frame: &Node, options: &Options) -> Checked<DraftCamera> {
    // What a frame says goes before what the file says of all.
    let find = |keys: &[&str]| frame.find(keys).or_else(|| top.find(keys));
    let number = |key: &str| find(&[key]).map(|node| node.number()).transpose();
    let path = frame.get(&["file_path"])?.text()?;
    let path = path.trim_start_matches("./").trim_start_matches("images/");
    let name = match path.rsplit_once('.') {
        Some((name, ending)) if ending.len() <= 4 => name,
        _ => path,
    };
    let id = draft::id(name);
    let side = |key: &str| find(&[key]).map(|node| node.pixels()).transpose();
    let said = side("w")?.zip(side("h")?);
    let size = said
        .map(|(w, h)| [w, h])
        .or(options.size_of(&id))
        .ok_or_else(|| {
            format!(
                "{}: no `w` and `h`; give `image_size` (--image-size WxH)",
                frame.place
            )
        })?;
    let [w, h] = size.map(f64::from);
    for node in [top, frame] {
        unread::refuse_suspicious(node, &LENS, options)?;
    }
    let focal = |key, angle, side: f64| -> Checked<Option<f64>> {
        Ok(match number(key)? {
            Some(focal) => Some(focal),
            None => number(angle)?.map(|angle| side / 2.0 / (angle / 2.0).tan()),
        })
    };
    let fx = focal("fl_x", "camera_angle_x", w)?.ok_or_else(|| {
        format!(
            "{}: expected `fl_x` or `camera_angle_x`, got neither",
            frame.place
        )
    })?;
    let fy = focal("fl_y", "camera_angle_y", h)?.unwrap_or(fx);
    let [cx, cy] = [
        number("cx")?.unwrap_or(w / 2.0),
        number("cy")?.unwrap_or(h / 2.0),
    ];
    let matrix = frame.get(&["transform_matrix"])?;
    let rows = matrix.matrix4()?;
    let flip = opencv_from_opengl().to_homogeneous();
    let world_from_cam = Matrix4::from_fn(|row, column| rows[row][column]) * flip;
    let rows =
        std::array::from_fn(|row| std::array::from_fn(|column| world_from_cam[(row, column)]));
    Ok(DraftCamera {
        id,
        size: Some(size),
        plane: Plane::from_corner([fx, fy, cx, cy]),
        lens: lens(&find).map_err(|problem| format!("{}: {problem}", frame.place))?,
        pose: Some(Pose::world_from_cam(draft::rigid(&matrix.place, &rows)?)),
    })
}

fn lens<'a>(find: &impl Fn(&[&str]) -> Option<Node<'a>>) -> Checked<Lens> {
    let number = |key: &str| find(&[key]).map_or(Ok(0.0), |node| node.number());
    let [k1, k2, k3, k4] = [number("k1")?, number("k2")?, number("k3")?, number("k4")?];
    let [p1, p2] = [number("p1")?, number("p2")?];
    let model = find(&["camera_model"])
        .map(|node| node.text())
        .transpose()?;
    let fisheye = find(&["is_fisheye"]).and_then(|node| is_yes(node.value)) == Some(true);
    match (model, fisheye) {
        (Some("OPENCV_FISHEYE"), _) | (None, true) => match [p1, p2] {
            [0.0, 0.0] => Lens::kannala_brandt(&[k1, k2, k3, k4]),
            _ => Err(format!(
                "a fisheye with p1 {p1} and p2 {p2} cannot be expressed"
            )),
        },
        (None | Some("OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL"), _) => {
            match k4 {
                0.0 => Lens::brown_conrady(&[k1, k2, p1, p2, k3]),
                // r⁸ to some programs, OpenCV's k4 to others.
                _ => Err(format!(
                    "`k4` of {k4} without a fisheye means different things to different programs; refused"
                )),
            }
        }
        (Some(other), _) => Err(format!(
            "the camera_model {other:?} is not known; expected OPENCV, OPENCV_FISHEYE or PINHOLE"
        )),
    }
}
