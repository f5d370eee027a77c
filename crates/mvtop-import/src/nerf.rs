//! NeRF's `transforms.json`: poses of cameras in OpenGL's axes, in a unit of their own.

use nalgebra::Matrix4;
use serde_json::Value;

use crate::draft::{self, Draft, DraftCamera, Pose, opencv_from_opengl};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::opencv::keys::is_yes;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};

/// What is read of the file and of each of its frames.
const READ: [&str; 19] = [
    "frames",
    "file_path",
    "transform_matrix",
    "w",
    "h",
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "camera_angle_x",
    "camera_angle_y",
    "camera_model",
    "is_fisheye",
    "k1",
    "k2",
    "k3",
    "k4",
    "p1",
    "p2",
];
/// What nerfstudio, instant-ngp and NeRF's Blender scenes have of scenes, training and files.
const OTHERS: [&str; 33] = [
    "fix_premult",
    "is_hdr",
    "enable_depth_loading",
    "enable_ray_loading",
    "black_transparent",
    "aabb",
    "aabb_scale",
    "applied_scale",
    "applied_transform",
    "auto_scale_poses_override",
    "bounds",
    "colmap_im_id",
    "depth_file_path",
    "depth_path",
    "depth_unit_scale_factor",
    "driver_parameters",
    "far",
    "fisheye_crop_radius",
    "integer_depth_scale",
    "light",
    "mask_path",
    "n_extra_learnable_dims",
    "near",
    "offset",
    "orientation_override",
    "ply_file_path",
    "render_aabb",
    "rotation",
    "scale",
    "scene_scale",
    "sharpness",
    "up",
    "white_transparent",
];
/// Largest difference of a focal length and that of an angle of view beside it, share.
const SAME_FOCAL: f64 = 0.01;

/// Whether it has frames with poses, or the angle of view of all.
pub fn is_it(value: &Value) -> bool {
    let frames = value.get("frames").and_then(Value::as_array);
    let posed = |frame: &Value| frame.get("transform_matrix").is_some();
    value.get("camera_angle_x").is_some() || frames.is_some_and(|all| all.iter().any(posed))
}

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
    let known = [&READ[..], &OTHERS].concat();
    for node in [top, frame] {
        unread::refuse(node, &known, options)?;
    }
    let focal = |key, angle, side: f64| -> Checked<Option<f64>> {
        let of_angle = |node: Node| Ok(side / 2.0 / (node.number()? / 2.0).tan());
        let Some(focal) = number(key)? else {
            return find(&[angle]).map(of_angle).transpose();
        };
        for node in [top, frame].iter().filter(|node| node.has(key)) {
            let other: Option<f64> = node.find(&[angle]).map(of_angle).transpose()?;
            let own = node.get(&[key])?;
            let ratio = other.unwrap_or(own.number()?) / own.number()?;
            if (ratio - 1.0).abs() > SAME_FOCAL {
                return Err(own.wrong(&format!("the focal length of `{angle}`")));
            }
        }
        Ok(Some(focal))
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
    let fisheye = find(&["is_fisheye"])
        .map(|node| is_yes(node.value).ok_or_else(|| node.wrong("true or false")));
    let fisheye = fisheye.transpose()?;
    let of_model = model.map(|model| model == "OPENCV_FISHEYE");
    if let (Some(model), Some(fisheye)) = (model, fisheye)
        && of_model != Some(fisheye)
    {
        return Err(format!(
            "the camera_model {model:?} and an is_fisheye of {fisheye} do not agree; leave the wrong one out"
        ));
    }
    match model {
        _ if of_model.or(fisheye) == Some(true) => match [p1, p2] {
            [0.0, 0.0] => Lens::kannala_brandt(&[k1, k2, k3, k4]),
            _ => Err(format!(
                "a fisheye with p1 {p1} and p2 {p2} cannot be expressed"
            )),
        },
        Some("PINHOLE" | "SIMPLE_PINHOLE") if [k1, k2, k3, k4, p1, p2] != [0.0; 6] => Err(
            "a camera_model without distortion has coefficients; name the one that it is".into(),
        ),
        None | Some("OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL") => {
            match k4 {
                0.0 => Lens::brown_conrady(&[k1, k2, p1, p2, k3]),
                // r⁸ to some programs, OpenCV's k4 to others.
                _ => Err(format!(
                    "`k4` of {k4} without a fisheye means different things to different programs; refused"
                )),
            }
        }
        Some(other) => Err(format!(
            "the camera_model {other:?} is not known; expected OPENCV, OPENCV_FISHEYE or PINHOLE"
        )),
    }
}
