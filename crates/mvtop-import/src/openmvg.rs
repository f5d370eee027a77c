//! OpenMVG's `sfm_data.json`: views, intrinsics that they share, and poses.
//!
//! Source: <https://github.com/openMVG/openMVG>, `sfm/sfm_data_io_cereal.hpp` and `cameras/`: `rotation` maps
//! world to camera, `center` is the camera's place in the world; pixel centers are integers. The key of
//! its coefficients names the lens: `disto_k1`, `disto_k3` (k1 k2 k3), `disto_t2` (k1 k2 k3 t1 t2, OpenCV's p1 p2)
//! and `fisheye` (OpenCV's k1 to k4). The unit is arbitrary.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};
use nalgebra::{Isometry3, Vector3};

/// Keys of the file.
const OF_FILE: [&str; 7] = [
    "sfm_data_version",
    "root_path",
    "views",
    "intrinsics",
    "extrinsics",
    "structure",
    "control_points",
];
/// Keys of a view; the last ones are of what was known of its place before.
const OF_VIEW: [&str; 13] = [
    "local_path",
    "filename",
    "width",
    "height",
    "id_view",
    "id_intrinsic",
    "id_pose",
    "use_pose_center_prior",
    "center_weight",
    "center",
    "use_pose_rotation_prior",
    "rotation_weight",
    "rotation",
];

/// Whether it says so.
pub fn is_it(value: &Value) -> bool {
    value.get("sfm_data_version").is_some()
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let [source] = sources else {
        let got = sources.len();
        return Err(format!("expected one sfm_data.json, got {got} files"));
    };
    let document = yaml::document(source)?;
    let top = Node::new(&document, &source.name);
    unread::refuse(&top, &OF_FILE, options)?;
    let intrinsics = by_number(&top, "intrinsics", options)?;
    let poses = by_number(&top, "extrinsics", options)?;
    let mut cameras = Vec::new();
    let mut unposed = Vec::new();
    for (number, view) in by_number(&top, "views", options)? {
        let view = inner(&view, options)?;
        unread::refuse(&view, &OF_VIEW, options)?;
        let whole = |key: &str| -> Checked<u64> {
            let node = view.get(&[key])?;
            let number = node.value.as_u64();
            number.ok_or_else(|| node.wrong("a whole number"))
        };
        let path = view.get(&["filename"])?.text()?;
        let name = path.rsplit_once('.').map_or(path, |(name, _)| name);
        let Some(pose) = poses.get(&whole("id_pose")?) else {
            unposed.push(name.to_owned());
            continue;
        };
        let of = whole("id_intrinsic")?;
        let shared = intrinsics
            .get(&of)
            .ok_or_else(|| format!("{}: view {number}: no intrinsics {of}", source.name))?;
        let (size, plane, lens) = optics(&inner(shared, options)?, options)?;
        cameras.push(DraftCamera {
            id: draft::id(name),
            size: Some(size),
            plane,
            lens,
            pose: Some(Pose::cam_from_world(cam_from_world(pose, options)?)),
        });
    }
    Ok(Draft {
        cameras,
        metres: None,
        posing: "give its extrinsics",
        notes: left_out(&unposed),
    })
}

/// A note of views without a pose.
pub fn left_out(names: &[String]) -> Vec<String> {
    match names {
        [] => Vec::new(),
        names => vec![format!(
            "left out, as they have no pose: {}",
            names.join(", ")
        )],
    }
}

/// Entries of a map that is written as a list of `key` and `value`.
fn by_number<'a>(top: &Node<'a>, key: &str, options: &Options) -> Checked<BTreeMap<u64, Node<'a>>> {
    let mut all = BTreeMap::new();
    for item in top.get(&[key])?.list()? {
        unread::refuse(&item, &["key", "value"], options)?;
        let node = item.get(&["key"])?;
        let number = node.value.as_u64();
        let number = number.ok_or_else(|| node.wrong("a whole number"))?;
        if all.insert(number, item.get(&["value"])?).is_some() {
            return Err(format!("{}: {number} is there twice", item.place));
        }
    }
    Ok(all)
}

/// What a pointer of cereal's points to.
fn inner<'a>(node: &Node<'a>, options: &Options) -> Checked<Node<'a>> {
    let Some(pointer) = node.find(&["ptr_wrapper"]) else {
        return Ok(node.clone());
    };
    let known = ["polymorphic_id", "polymorphic_name", "ptr_wrapper"];
    unread::refuse(node, &known, options)?;
    unread::refuse(&pointer, &["id", "data"], options)?;
    pointer.get(&["data"])
}

/// What all lenses have may be an object of its own.
const OF_ALL: [&str; 5] = [
    "width",
    "height",
    "focal_length",
    "principal_point",
    "value0",
];

fn optics(node: &Node, options: &Options) -> Checked<([u32; 2], Plane, Lens)> {
    let of_all = node.find(&["value0"]).unwrap_or_else(|| node.clone());
    let side = |key: &str| of_all.get(&[key])?.pixels();
    let focal = of_all.get(&["focal_length"])?.number()?;
    let [cx, cy] = of_all.get(&["principal_point"])?.vector()?;
    let lenses = ["disto_k1", "disto_k3", "disto_t2", "fisheye"];
    let found: Vec<&str> = lenses.into_iter().filter(|key| node.has(key)).collect();
    let lens = match found.as_slice() {
        [] => Ok(Lens::PINHOLE),
        ["disto_k1"] => {
            let [k1] = node.get(&found)?.vector()?;
            Lens::brown_conrady(&[k1, 0.0, 0.0, 0.0, 0.0])
        }
        ["disto_k3"] => {
            let [k1, k2, k3] = node.get(&found)?.vector()?;
            Lens::brown_conrady(&[k1, k2, 0.0, 0.0, k3])
        }
        ["disto_t2"] => {
            let [k1, k2, k3, p1, p2] = node.get(&found)?.vector()?;
            Lens::brown_conrady(&[k1, k2, p1, p2, k3])
        }
        ["fisheye"] => Lens::kannala_brandt(&node.get(&found)?.vector::<4>()?),
        several => Err(format!("several lenses, {}", several.join(" and "))),
    };
    let known: Vec<&str> = OF_ALL.into_iter().chain(lenses).collect();
    unread::refuse(node, &known, options)?;
    unread::refuse(&of_all, &known, options)?;
    Ok((
        [side("width")?, side("height")?],
        Plane::new([focal, focal, cx, cy]),
        lens.map_err(|problem| format!("{}: {problem}", node.place))?,
    ))
}

fn cam_from_world(node: &Node, options: &Options) -> Checked<Isometry3<f64>> {
    unread::refuse(node, &["rotation", "center"], options)?;
    let rotation = node.get(&["rotation"])?;
    let center = Vector3::from(node.get(&["center"])?.vector::<3>()?);
    let turned = draft::rotation_and_translation(&rotation.place, &rotation.vector()?, [0.0; 3])?;
    let back = turned.rotation * -center;
    Ok(Isometry3::from_parts(back.into(), turned.rotation))
}
