//! MATLAB's camera parameters as JSON: `jsonencode(toStruct(params))` of one camera or a stereo pair.
//!
//! Source: the documentation of `cameraParameters` and `stereoParameters`: pixels count from 1, so one is taken
//! off the principal point. `IntrinsicMatrix` is the transpose of `K`, as `RotationOfCamera2` is that of OpenCV's
//! R; `ImageSize` is rows and columns. Coefficients are OpenCV's, in two lists. `WorldUnits` is the unit.

use serde_json::Value;

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};
use nalgebra::Isometry3;

const PAIR: [&str; 2] = ["CameraParameters1", "CameraParameters2"];
/// What was read, and what is about other things.
const KNOWN: [&str; 24] = [
    "RadialDistortion",
    "TangentialDistortion",
    "Skew",
    "NumRadialDistortionCoefficients",
    "K",
    "IntrinsicMatrix",
    "FocalLength",
    "PrincipalPoint",
    "ImageSize",
    "WorldUnits",
    "WorldPoints",
    "EstimateSkew",
    "EstimateTangentialDistortion",
    "NumPatterns",
    "MeanReprojectionError",
    "ReprojectionErrors",
    "ReprojectedPoints",
    "RotationVectors",
    "TranslationVectors",
    "RotationMatrices",
    "PatternExtrinsics",
    "Intrinsics",
    "DetectedKeypoints",
    "Version",
];
/// Of a pair.
const OF_PAIR: [&str; 12] = [
    "CameraParameters1",
    "CameraParameters2",
    "RotationOfCamera2",
    "TranslationOfCamera2",
    "PoseCamera2",
    "FundamentalMatrix",
    "EssentialMatrix",
    "MeanReprojectionError",
    "NumPatterns",
    "WorldPoints",
    "WorldUnits",
    "RectificationParams",
];

/// Of the second camera's pose.
const OF_POSE: [&str; 6] = ["A", "R", "Translation", "Rotation", "T", "Dimensionality"];

/// Whether it is a camera, or a pair of these.
pub fn is_it(value: &Value) -> bool {
    let is_one = |value: &Value| {
        ["RadialDistortion", "TangentialDistortion", "ImageSize"]
            .iter()
            .all(|key| value.get(key).is_some())
    };
    is_one(value) || PAIR.iter().all(|key| value.get(key).is_some_and(is_one))
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut cameras = Vec::new();
    let mut units = Vec::new();
    for source in sources {
        let document = yaml::document(source)?;
        let top = Node::new(&document, &source.name);
        if !top.has(PAIR[0]) {
            cameras.push(camera(&source.stem(), &top, None, &mut units, options)?);
            continue;
        }
        unread::refuse(&top, &OF_PAIR, options)?;
        let other = second(&top, options)?;
        // Whatever that maps to what, the first camera is the world.
        let first = Pose {
            transform: Isometry3::identity(),
            direction: other.as_ref().and_then(|pose| pose.direction),
        };
        let poses = [Some(first), other];
        for (index, (key, pose)) in PAIR.into_iter().zip(poses).enumerate() {
            let id = format!("cam{}", index + 1);
            cameras.push(camera(&id, &top.get(&[key])?, pose, &mut units, options)?);
        }
    }
    let metres = match units.split_first() {
        Some((first, others)) if others.iter().all(|other| other == first) => Some(*first),
        _ => None,
    };
    Ok(Draft {
        cameras,
        metres,
        posing: "give the stereoParameters of the pair",
        notes: vec!["pixels count from 1 in MATLAB, so one was taken off principal points".into()],
    })
}

/// The place of the second camera.
fn second(top: &Node, options: &Options) -> Checked<Option<Pose>> {
    if let Some(rotation) = top.find(&["RotationOfCamera2"]) {
        let r: [f64; 9] = rotation.vector()?;
        let r = std::array::from_fn(|i| r[3 * (i % 3) + i / 3]);
        let t = top.get(&["TranslationOfCamera2"])?.vector()?;
        let transform = draft::rotation_and_translation(&rotation.place, &r, t)?;
        return Ok(Some(Pose::cam_from_world(transform)));
    }
    // Releases from 2022 on: what it maps to what is asked for.
    let pose = |pose: Node| {
        unread::refuse(&pose, &OF_POSE, options)?;
        let matrix = pose.get(&["A"])?;
        let transform = draft::rigid(&matrix.place, &matrix.matrix4()?)?;
        Ok(Pose {
            transform,
            direction: None,
        })
    };
    top.find(&["PoseCamera2"]).map(pose).transpose()
}

/// K, its transpose `IntrinsicMatrix`, or its numbers by name; those that are there must be the same.
fn matrix(node: &Node) -> Checked<[f64; 9]> {
    let transposed = |node: Node| -> Checked<[f64; 9]> {
        let columns: [f64; 9] = node.vector()?;
        Ok(std::array::from_fn(|i| columns[3 * (i % 3) + i / 3]))
    };
    let k = node.find(&["K"]).map(|node| node.vector()).transpose()?;
    let other = node
        .find(&["IntrinsicMatrix"])
        .map(transposed)
        .transpose()?;
    let Some(matrix) = k.or(other) else {
        let [fx, fy] = node.get(&["FocalLength"])?.vector()?;
        let [cx, cy] = node.get(&["PrincipalPoint"])?.vector()?;
        let skew = node.find(&["Skew"]).map_or(Ok(0.0), |skew| skew.number())?;
        return Ok([fx, skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    };
    let pair = |key: &str| -> Checked<[Option<f64>; 2]> {
        let found = node.find(&[key]);
        let found = found.map(|node| node.vector::<2>()).transpose()?;
        Ok(found.map_or([None; 2], |pair| pair.map(Some)))
    };
    let ([fx, fy], [cx, cy]) = (pair("FocalLength")?, pair("PrincipalPoint")?);
    let by_name = [fx, None, cx, None, fy, cy, None, None, None];
    for (index, there) in matrix.iter().enumerate() {
        for (what, other) in [
            ("IntrinsicMatrix", other.map(|other| other[index])),
            ("FocalLength or PrincipalPoint", by_name[index]),
        ] {
            draft::same_number(&format!("a number of K and of {what}"), other, *there)
                .map_err(|problem| format!("{}: {problem}", node.place))?;
        }
    }
    Ok(matrix)
}

fn camera(
    id: &str,
    node: &Node,
    pose: Option<Pose>,
    units: &mut Vec<f64>,
    options: &Options,
) -> Checked<DraftCamera> {
    let of = |problem: String| format!("{}: {problem}", node.place);
    let matrix = matrix(node)?;
    let plane = Plane::from_matrix(matrix).map_err(of)?;
    let plane = Plane {
        cx: plane.cx - 1.0,
        cy: plane.cy - 1.0,
        ..plane
    };
    let radial = node.get(&["RadialDistortion"])?.numbers()?;
    let [p1, p2] = node.get(&["TangentialDistortion"])?.vector()?;
    let [k1, k2, k3] = match radial.as_slice() {
        &[k1, k2] => [k1, k2, 0.0],
        &[k1, k2, k3] => [k1, k2, k3],
        other => {
            let got = other.len();
            return Err(of(format!(
                "expected 2 or 3 of RadialDistortion, got {got}"
            )));
        }
    };
    unread::refuse(node, &KNOWN, options)?;
    if let Some(unit) = node.find(&["WorldUnits"]) {
        units.push(match unit.text()? {
            "m" | "meters" => 1.0,
            "cm" | "centimeters" => 0.01,
            "mm" | "millimeters" => 0.001,
            "in" | "inches" => 0.0254,
            _ => return Err(unit.wrong("m, cm, mm or in")),
        });
    }
    let id = draft::id(id);
    let sides = node.get(&["ImageSize"])?.size()?;
    let size = draft::ordered_size(&id, "ImageSize", Some(true), sides, &plane, options)?;
    Ok(DraftCamera {
        id,
        size: Some(size),
        plane,
        lens: Lens::brown_conrady(&[k1, k2, p1, p2, k3]).map_err(of)?,
        pose,
    })
}
