//! Frames and their parents: TF's messages, a URDF's joints, and lists as these are.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_2;

use mvtop_geometry::transform;
use nalgebra::{Isometry3, UnitQuaternion};
use serde_json::Value;

use super::hand_eye;
use super::urdf::{Joint, from_xyz_and_rpy};
use crate::node::Node;
use crate::{Checked, Options, unread};

/// Keys of a frame in a list.
const KEYS: [&str; 5] = ["parent", "xyz", "rpy", "q_wxyz", "q_xyzw"];
/// What turns a body's frame (x forward) to optical axes, as one types it.
const TO_OPTICAL: &str = "rpy: [-1.570796, 0, -1.570796]";

/// Largest difference of two turns that are the same, radians.
const SAME_TURN: f64 = 1e-3;

/// Frames that stand still in each other.
#[derive(Default)]
pub struct Tree {
    /// Parent of each frame, and parent_from_child.
    still: BTreeMap<String, (String, Isometry3<f64>)>,
    /// Frames that a joint moves, with its name and kind: each is a root.
    moved: BTreeMap<String, (String, String)>,
}

/// A camera in the tree.
pub struct Placed {
    /// Of its optical axes.
    pub frame: String,
    /// The frame above it that has no parent.
    pub root: String,
    pub root_from_cam: Isometry3<f64>,
}

impl Tree {
    pub fn is_empty(&self) -> bool {
        self.still.is_empty()
    }

    /// Adds those of a message, of a list of messages, of a list of frames, or of a hand-eye result.
    pub fn add(&mut self, top: &Node, options: &Options) -> Checked<()> {
        if hand_eye::is_it(top.value) {
            let (robot, camera, pose) = hand_eye::read(top, options)?;
            return self.insert(&top.place, robot, camera, pose);
        }
        if is_list(top) {
            for (frame, item) in top.entries() {
                let (parent, pose) = of_list(&item)?;
                self.insert(&item.place, parent, frame, pose)?;
            }
            return Ok(());
        }
        let messages = match top.find(&["transforms"]) {
            Some(list) => {
                unread::refuse(top, &["transforms"], options)?;
                list.list()?
            }
            None if top.value.is_array() => top.list()?,
            None => vec![top.clone()],
        };
        for item in messages {
            unread::refuse(&item, &["header", "child_frame_id", "transform"], options)?;
            let header = item.get(&["header"])?;
            unread::refuse(&header, &["frame_id", "seq", "stamp"], options)?;
            let parent = header.get(&["frame_id"])?.text()?;
            let child = item.get(&["child_frame_id"])?.text()?;
            self.insert(&item.place, parent, child, of_message(&item, options)?)?;
        }
        Ok(())
    }

    /// Adds a URDF's joints. What stands above one that moves is not known.
    pub fn add_joints(&mut self, place: &str, joints: Vec<Joint>) -> Checked<()> {
        for joint in joints {
            if joint.is_fixed() {
                self.insert(place, &joint.parent, &joint.child, joint.parent_from_child)?;
            } else {
                self.moved
                    .insert(plain(&joint.child), (joint.name, joint.kind));
            }
        }
        Ok(())
    }

    /// The joint that moves a root, as a sentence's end; nothing where none does.
    pub fn moved_by(&self, root: &str) -> String {
        match self.moved.get(root) {
            Some((name, kind)) => format!(" (moved by the {kind} joint `{name}`)"),
            None => String::new(),
        }
    }

    fn insert(
        &mut self,
        place: &str,
        parent: &str,
        child: &str,
        parent_from_child: Isometry3<f64>,
    ) -> Checked<()> {
        let known = (plain(parent), parent_from_child);
        match self.still.insert(plain(child), known) {
            Some(_) => Err(format!("{place}: the frame `{child}` is there twice")),
            None => Ok(()),
        }
    }

    /// A frame in that one with the usual turn from a body's axes to optical ones.
    fn optical_child(&self, frame: &str) -> Option<&str> {
        let [roll, pitch, yaw] = [-FRAC_PI_2, 0.0, -FRAC_PI_2];
        let usual = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        let mut all = self.still.iter();
        let (child, _) = all.find(|(_, (parent, pose))| {
            parent == frame && pose.rotation.angle_to(&usual) < SAME_TURN
        })?;
        Some(child)
    }

    /// Where a camera stands.
    ///
    /// - `frame`: of its optical axes, where its file says it
    pub fn placed(&self, name: &str, frame: Option<&str>) -> Checked<Placed> {
        let name = plain(name);
        let frame = frame.map(plain);
        // A frame of optical axes (z forward) goes before one of the camera's bare name, which may be a body's, as
        // `_link` and `_frame` are (x forward).
        let stated = frame.iter().filter(|frame| is_optical(frame)).cloned();
        let ends = [
            "_optical_frame",
            "_color_optical_frame",
            "_optical",
            "_optical_link",
        ];
        let usual = ends.iter().map(|end| format!("{name}{end}"));
        let bare = frame.iter().chain([&name]).cloned();
        let candidates: Vec<String> = stated.clone().chain(usual).chain(bare).collect();
        let parents: BTreeSet<&String> = self.still.values().map(|(parent, _)| parent).collect();
        let known = |frame: &&String| self.still.contains_key(*frame) || parents.contains(frame);
        let bodies = [format!("{name}_link"), format!("{name}_frame")];
        let body = |frame: &String| {
            format!(
                "camera `{name}`: its frame `{frame}` is a body's (x forward), expected its optical frame (z \
                 forward); if that is turned the usual way, add `{name}_optical_frame: {{parent: {frame}, \
                 {TO_OPTICAL}}}` to a list of frames, and name the camera `{name}`"
            )
        };
        let missing = stated.clone().find(|frame| !known(&frame));
        if let Some(frame) = missing {
            let known: Vec<&str> = self.still.keys().map(String::as_str).collect();
            return Err(format!(
                "camera `{name}`: its file states the optical frame `{frame}`, and no transform has it, only {}; give \
                 that transform",
                known.join(", ")
            ));
        }
        let Some(frame) = candidates.iter().find(known) else {
            if let Some(frame) = bodies.iter().find(known) {
                return Err(body(frame));
            }
            let known: Vec<&str> = self.still.keys().map(String::as_str).collect();
            return Err(format!(
                "camera `{name}`: no transform of its optical frame ({}) among those of {}; set its \
                 camera_name, or the message's frame_id, to one of them",
                candidates.join(", "),
                known.join(", ")
            ));
        };
        if ["_link", "_frame"].iter().any(|end| frame.ends_with(end)) && !is_optical(frame) {
            return Err(body(frame));
        }
        if let Some(child) = self.optical_child(frame).filter(|_| !is_optical(frame)) {
            return Err(format!(
                "camera `{name}`: its frame `{frame}` is a body's, as `{child}` has the usual turn to optical axes in \
                 it; set the message's frame_id to `{child}`"
            ));
        }
        let (mut at, mut root_from_cam) = (frame, Isometry3::identity());
        for _ in 0..=self.still.len() {
            match self.still.get(at) {
                None => {
                    return Ok(Placed {
                        frame: frame.clone(),
                        root: at.clone(),
                        root_from_cam,
                    });
                }
                Some((parent, parent_from_child)) => {
                    root_from_cam = parent_from_child * root_from_cam;
                    at = parent;
                }
            }
        }
        Err(format!(
            "camera `{name}`: the transforms above `{frame}` go round in a circle"
        ))
    }
}

/// Whether it is a message of TF, several of these, or frames by their names.
pub fn is_it(value: &Value) -> bool {
    let is_message = |value: &Value| value.get("child_frame_id").is_some();
    let messages = value.get("transforms").unwrap_or(value);
    is_message(value)
        || messages
            .as_array()
            .is_some_and(|list| list.iter().any(is_message))
        || is_list(&Node::new(value, ""))
}

/// Whether it is frames by their names, each with its parent.
fn is_list(top: &Node) -> bool {
    let entries = top.entries();
    !entries.is_empty() && entries.iter().all(|(_, item)| item.has("parent"))
}

fn is_optical(frame: &str) -> bool {
    frame.contains("optical")
}

fn plain(frame: &str) -> String {
    frame.trim_start_matches('/').to_owned()
}

/// As a URDF has it: metres, and turns about the parent's x, then y, then z, radians; what is left out
/// is 0.
fn of_list<'a>(item: &Node<'a>) -> Checked<(&'a str, Isometry3<f64>)> {
    if let Some((key, value)) = item.entries().iter().find(|(key, _)| !KEYS.contains(key)) {
        let keys = KEYS.join(", ");
        return Err(format!(
            "{}: the key `{key}` is none of {keys}",
            value.place
        ));
    }
    let parent = item.get(&["parent"])?.text()?;
    let t = item.find(&["xyz"]).map_or(Ok([0.0; 3]), |t| t.vector())?;
    let turns: Vec<Node> = ["rpy", "q_wxyz", "q_xyzw"]
        .iter()
        .filter_map(|key| item.find(&[key]))
        .collect();
    let pose = match &turns[..] {
        [] => from_xyz_and_rpy(t, [0.0; 3]),
        [turn] if item.has("rpy") => from_xyz_and_rpy(t, turn.vector()?),
        [turn] if item.has("q_wxyz") => from_quaternion(turn.vector()?, t),
        [turn] => {
            let [x, y, z, w] = turn.vector()?;
            from_quaternion([w, x, y, z], t)
        }
        _ => return Err(item.wrong("one of rpy, q_wxyz and q_xyzw")),
    };
    let pose = pose.map_err(|error| format!("{}: {error}", item.place))?;
    Ok((parent, pose))
}

fn from_quaternion(wxyz: [f64; 4], t: [f64; 3]) -> Checked<Isometry3<f64>> {
    transform::from_quaternion_wxyz(wxyz, t).map_err(|error| error.to_string())
}

fn of_message(item: &Node, options: &Options) -> Checked<Isometry3<f64>> {
    let motion = item.get(&["transform"])?;
    let (wxyz, t) = hand_eye::parts(&motion, options)?;
    from_quaternion(wxyz, t).map_err(|error| format!("{}: {error}", motion.place))
}
