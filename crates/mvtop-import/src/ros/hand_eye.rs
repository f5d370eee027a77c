//! Results of hand-eye calibrations, which easy_handeye and easy_handeye2 write: one transform.
//!
//! Source: <https://github.com/IFL-CAMP/easy_handeye>, `handeye_calibration.py`, and
//! <https://github.com/marcoesposito1988/easy_handeye2>, `handeye_calibration.py`: `parameters` name the frames,
//! `transformation` (x, y, z, qx, qy, qz, qw) or `transform` (as a message of TF) is the camera's pose in
//! the robot's base, or in its hand where the camera is mounted there; metres.

use mvtop_geometry::transform;
use nalgebra::Isometry3;
use serde_json::Value;

use crate::node::Node;
use crate::{Checked, Options, unread};

/// Parameters of both programs; those about the robot's motion say nothing of the result.
const PARAMETERS: [&str; 12] = [
    "name",
    "namespace",
    "calibration_type",
    "eye_on_hand",
    "robot_base_frame",
    "robot_effector_frame",
    "tracking_base_frame",
    "tracking_marker_frame",
    "freehand_robot_movement",
    "move_group_namespace",
    "move_group",
    "publish_tf",
];

/// Whether it is such a result.
pub fn is_it(value: &Value) -> bool {
    let part = |key: &str| value.get("parameters").and_then(|all| all.get(key));
    part("tracking_base_frame").is_some()
}

/// The robot's frame, the camera's, and robot_from_camera, metres.
pub fn read<'a>(top: &Node<'a>, options: &Options) -> Checked<(&'a str, &'a str, Isometry3<f64>)> {
    unread::refuse(top, &["parameters", "transformation", "transform"], options)?;
    let parameters = top.get(&["parameters"])?;
    unread::refuse(&parameters, &PARAMETERS, options)?;
    let on_hand = match parameters.find(&["eye_on_hand"]) {
        Some(node) => node
            .value
            .as_bool()
            .ok_or_else(|| node.wrong("true or false"))?,
        None => {
            let kind = parameters.get(&["calibration_type"])?;
            match kind.text()? {
                "eye_in_hand" => true,
                "eye_on_base" => false,
                _ => return Err(kind.wrong("eye_in_hand or eye_on_base")),
            }
        }
    };
    let robot = match on_hand {
        true => parameters.get(&["robot_effector_frame"])?,
        false => parameters.get(&["robot_base_frame"])?,
    };
    let camera = parameters.get(&["tracking_base_frame"])?;
    let pose = match top.find(&["transformation"]) {
        Some(flat) => {
            unread::refuse(&flat, &["qw", "qx", "qy", "qz", "x", "y", "z"], options)?;
            let [w, x, y, z] = numbers(&flat, ["qw", "qx", "qy", "qz"])?;
            rigid(&flat, [w, x, y, z], numbers(&flat, ["x", "y", "z"])?)?
        }
        None => {
            let motion = top.get(&["transform"])?;
            let (wxyz, t) = parts(&motion, options)?;
            rigid(&motion, wxyz, t)?
        }
    };
    Ok((robot.text()?, camera.text()?, pose))
}

/// Quaternion (w x y z) and translation of a transform as ROS' messages have it.
pub fn parts(motion: &Node, options: &Options) -> Checked<([f64; 4], [f64; 3])> {
    let (q, t) = (motion.get(&["rotation"])?, motion.get(&["translation"])?);
    unread::refuse(motion, &["rotation", "translation"], options)?;
    unread::refuse(&q, &["w", "x", "y", "z"], options)?;
    unread::refuse(&t, &["x", "y", "z"], options)?;
    Ok((
        numbers(&q, ["w", "x", "y", "z"])?,
        numbers(&t, ["x", "y", "z"])?,
    ))
}

fn numbers<const N: usize>(node: &Node, keys: [&str; N]) -> Checked<[f64; N]> {
    let mut all = [0.0; N];
    for (number, key) in all.iter_mut().zip(keys) {
        *number = node.get(&[key])?.number()?;
    }
    Ok(all)
}

fn rigid(node: &Node, wxyz: [f64; 4], t: [f64; 3]) -> Checked<Isometry3<f64>> {
    transform::from_quaternion_wxyz(wxyz, t).map_err(|error| format!("{}: {error}", node.place))
}
