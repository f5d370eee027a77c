//! Joints of a URDF, a robot's description in XML.
//!
//! Source: <https://docs.ros.org/en/rolling/Tutorials/Intermediate/URDF/URDF-Main.html>

use std::f64::consts::TAU;

use mvtop_geometry::transform;
use nalgebra::{Isometry3, UnitQuaternion};
use roxmltree::{Document, Node, ParsingOptions};

use crate::Checked;
use crate::source::Source;

/// Most elements and attributes that are read: descriptions of robots have thousands.
const MOST_NODES: u32 = 1 << 20;

/// From one link to the next.
pub struct Joint {
    pub name: String,
    /// "fixed", or how it moves.
    pub kind: String,
    pub parent: String,
    pub child: String,
    pub parent_from_child: Isometry3<f64>,
}

impl Joint {
    pub fn is_fixed(&self) -> bool {
        self.kind == "fixed"
    }
}

/// All joints of the robot.
pub fn joints(source: &Source) -> Checked<Vec<Joint>> {
    let of = |problem: String| format!("{}: {problem}", source.name);
    let options = ParsingOptions {
        nodes_limit: MOST_NODES,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(source.text()?, options)
        .map_err(|error| of(format!("no XML: {error}")))?;
    let robot = document.root_element();
    if !robot.has_tag_name("robot") {
        let got = robot.tag_name().name();
        return Err(of(format!("expected a URDF's `robot`, got `{got}`")));
    }
    let xacro = |node: Node| {
        let namespace = node.tag_name().namespace().unwrap_or_default();
        let unset = |value: &str| value.contains("${") || value.contains("$(");
        namespace.contains("xacro") || node.attributes().any(|a| unset(a.value()))
    };
    if robot.descendants().any(xacro) {
        return Err(of(
            "the macros of xacro are still in it; expand them: xacro FILE > robot.urdf".into(),
        ));
    }
    let joints = robot.children().filter(|node| node.has_tag_name("joint"));
    joints.map(|node| joint(node).map_err(of)).collect()
}

fn joint(node: Node) -> Checked<Joint> {
    let name = attribute(node, "name", "a joint")?;
    let place = format!("joint `{name}`");
    let child_of = |tag: &str| node.children().find(|child| child.has_tag_name(tag));
    let link = |tag: &str| {
        let of = child_of(tag).ok_or_else(|| format!("{place}: its `{tag}` is missing"))?;
        attribute(of, "link", &format!("{place}: `{tag}`"))
    };
    let three = |key: &str| -> Checked<[f64; 3]> {
        let Some(text) = child_of("origin").and_then(|origin| origin.attribute(key)) else {
            return Ok([0.0; 3]);
        };
        let numbers: Option<Vec<f64>> = text
            .split_whitespace()
            .map(|word| word.parse().ok().filter(|x: &f64| x.is_finite()))
            .collect();
        numbers
            .and_then(|numbers| numbers.try_into().ok())
            .ok_or_else(|| format!("{place}: `{key}` must be 3 finite numbers, got {text:?}"))
    };
    let attributes = child_of("origin").into_iter();
    let mut attributes = attributes.flat_map(|origin| origin.attributes());
    if let Some(other) = attributes.find(|one| !["xyz", "rpy"].contains(&one.name())) {
        return Err(format!(
            "{place}: expected `xyz` and `rpy` of its `origin`, got `{}`; give the turn as `rpy`",
            other.name()
        ));
    }
    Ok(Joint {
        kind: attribute(node, "type", &place)?,
        parent: link("parent")?,
        child: link("child")?,
        parent_from_child: from_xyz_and_rpy(three("xyz")?, three("rpy")?)
            .map_err(|error| format!("{place}: {error}"))?,
        name,
    })
}

fn attribute(node: Node, key: &str, place: &str) -> Checked<String> {
    let value = node.attribute(key).map(str::to_owned);
    value.ok_or_else(|| format!("{place}: the attribute `{key}` is missing"))
}

/// parent_from_child as a URDF has it.
///
/// - `rpy`: turns about the parent's x, then y, then z, radians
pub fn from_xyz_and_rpy(xyz: [f64; 3], rpy: [f64; 3]) -> Checked<Isometry3<f64>> {
    let [roll, pitch, yaw] = rpy;
    if rpy.iter().any(|angle| angle.abs() > TAU) {
        return Err(format!(
            "`rpy` must be radians, none beyond a full turn, got {rpy:?}"
        ));
    }
    let [x, y, z, w] = UnitQuaternion::from_euler_angles(roll, pitch, yaw)
        .coords
        .into();
    transform::from_quaternion_wxyz([w, x, y, z], xyz).map_err(|error| error.to_string())
}
