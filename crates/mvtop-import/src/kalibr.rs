//! Kalibr's chain of cameras, and files of OpenVINS, which state the inverse (`T_imu_cam`).

use nalgebra::Isometry3;

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Foreign, Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};

const CHAIN: &[&str] = &["T_cn_cnm1"];
/// Keys of a camera, those of OpenVINS among them.
const KNOWN: [&str; 11] = [
    "camera_model",
    "intrinsics",
    "distortion_model",
    "distortion_coeffs",
    "resolution",
    "T_cn_cnm1",
    "T_cam_imu",
    "T_imu_cam",
    "timeshift_cam_imu",
    "rostopic",
    "cam_overlaps",
];

/// Largest difference of two places that are the same: radians, and a share of the distance.
const SAME_PLACE: f64 = 1e-2;
/// Shortest distance that this is a share of, metres: files have four digits behind the point.
const LEAST_BASELINE: f64 = 0.1;

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut cameras = Vec::new();
    let mut notes = Vec::new();
    let several = sources.len() > 1;
    for source in sources {
        let document = yaml::document(source)?;
        let top = Node::new(&document, &source.name);
        let mut found: Vec<_> = top.entries();
        found.retain(|(_, node)| node.has("camera_model"));
        // cam10 comes after cam9.
        found.sort_by_key(|(name, _)| (name.len(), *name));
        if found.is_empty() {
            let name = &source.name;
            return Err(format!(
                "{name}: expected cam0 with `camera_model` and `intrinsics`, got none"
            ));
        }
        let known: Vec<&str> = found.iter().map(|(name, _)| *name).collect();
        unread::refuse(&top, &known, options)?;
        let poses = poses(&found, several, &mut notes)?;
        for ((name, node), pose) in found.iter().zip(poses) {
            let (plane, lens) = optics(node, options)?;
            let sides = node.get(&["resolution"])?.size()?;
            let size =
                draft::ordered_size(name, "resolution", Some(false), sides, &plane, options)?;
            cameras.push(DraftCamera {
                id: draft::id(name),
                size: Some(size),
                plane,
                lens,
                pose,
            });
        }
    }
    Ok(Draft {
        cameras,
        metres: Some(1.0),
        posing: "give T_cn_cnm1 of each camera but the first, or T_cam_imu of all",
        notes,
    })
}

/// World is the first camera where there is a chain, else the IMU, which cameras of several files have in common.
fn poses(
    cameras: &[(&str, Node)],
    several: bool,
    notes: &mut Vec<String>,
) -> Checked<Vec<Option<Pose>>> {
    let of_imu = |node: &Node| node.has("T_cam_imu") || node.has("T_imu_cam");
    let chained = cameras.len() > 1
        && cameras[1..]
            .iter()
            .all(|(_, node)| node.find(CHAIN).is_some());
    let chained = match several {
        true if chained && !cameras.iter().all(|(_, node)| of_imu(node)) => {
            return Err(
                "expected one chain of cameras, got several files, which have no frame in common without T_cam_imu \
                 of each camera; calibrate all cameras together"
                    .into(),
            );
        }
        several => chained && !several,
    };
    let mut poses = Vec::new();
    let mut cam_from_first = Isometry3::identity();
    for (index, (_, node)) in cameras.iter().enumerate() {
        let pose = if chained {
            if let Some(node) = node.find(CHAIN).filter(|_| index > 0) {
                cam_from_first = draft::rigid(&node.place, &node.matrix4()?)? * cam_from_first;
            }
            Some(Pose::cam_from_world(cam_from_first))
        } else if let Some(node) = node.find(&["T_cam_imu"]) {
            Some(Pose::cam_from_world(draft::rigid(
                &node.place,
                &node.matrix4()?,
            )?))
        } else if let Some(node) = node.find(&["T_imu_cam"]) {
            Some(Pose::world_from_cam(draft::rigid(
                &node.place,
                &node.matrix4()?,
            )?))
        } else {
            None
        };
        poses.push(pose);
    }
    check_imu(cameras)?;
    if poses.iter().any(Option::is_some) {
        let world = if chained {
            "the first camera"
        } else {
            "the IMU"
        };
        let note = format!("the world frame is that of {world}");
        if !notes.contains(&note) {
            notes.push(note);
        }
    }
    Ok(poses)
}

/// Refuses places in the frame of the IMU that are not each other's inverse, or not those of the chain.
fn check_imu(cameras: &[(&str, Node)]) -> Checked<()> {
    let matrix = |node: &Node, key: &str| -> Checked<Option<Isometry3<f64>>> {
        let found = node.find(&[key]);
        found
            .map(|node| draft::rigid(&node.place, &node.matrix4()?))
            .transpose()
    };
    let mut before: Option<Isometry3<f64>> = None;
    for (index, (_, node)) in cameras.iter().enumerate() {
        let (direct, inverse) = (matrix(node, "T_cam_imu")?, matrix(node, "T_imu_cam")?);
        if let (Some(direct), Some(inverse)) = (direct, inverse)
            && differ(&direct, &inverse.inverse())
        {
            return Err(twice(node, "`T_cam_imu` and the inverse of `T_imu_cam`"));
        }
        let own = direct.or(inverse.map(|pose| pose.inverse()));
        if let (Some(own), Some(before), Some(chain)) = (own, before, matrix(node, CHAIN[0])?)
            && index > 0
            && differ(&chain, &(own * before.inverse()))
        {
            return Err(twice(
                node,
                "`T_cn_cnm1` and the transform between the places in the IMU's frame",
            ));
        }
        before = own;
    }
    Ok(())
}

fn differ(a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
    let off = a.inverse() * b;
    let most = SAME_PLACE * a.translation.vector.norm().max(LEAST_BASELINE);
    off.rotation.angle() > SAME_PLACE || off.translation.vector.norm() > most
}

fn twice(node: &Node, what: &str) -> String {
    format!(
        "{}: its place is there twice and different, as {what}; leave the wrong one out",
        node.place
    )
}

/// By the names of camera and distortion model, never by the number of coefficients.
fn optics(node: &Node, options: &Options) -> Checked<(Plane, Lens)> {
    unread::refuse(node, &KNOWN, options)?;
    let of = |problem: String| format!("{}: {problem}", node.place);
    let intrinsics = node.get(&["intrinsics"])?;
    let distortion = match node.find(&["distortion_model"]) {
        Some(name) => name.text()?,
        None => "none",
    };
    let params = match node.find(&["distortion_coeffs"]) {
        Some(params) => params.numbers()?,
        None => Vec::new(),
    };
    let bare = |foreign| match params.iter().all(|&p| p == 0.0) {
        true => Ok(Lens::Foreign(foreign)),
        false => Err(of(format!(
            "{params:?} on top of its camera_model cannot be expressed"
        ))),
    };
    match node.get(&["camera_model"])?.text()? {
        "pinhole" => {
            let lens = Lens::named(distortion, &params).map_err(of)?;
            Ok((Plane::new(intrinsics.vector()?), lens))
        }
        "omni" => {
            let [xi, plane @ ..] = intrinsics.vector::<5>()?;
            let Lens::Native(projection) = Lens::named(distortion, &params).map_err(of)? else {
                return Err(of(format!("omni with {distortion} cannot be expressed")));
            };
            if projection.family() != "pinhole" {
                return Err(of(format!("omni with {distortion} cannot be expressed")));
            }
            let omni = Foreign::Omni {
                xi,
                distortion: projection,
            };
            Ok((Plane::new(plane), Lens::Foreign(omni)))
        }
        "ds" => {
            let [xi, alpha, plane @ ..] = intrinsics.vector::<6>()?;
            Ok((
                Plane::new(plane),
                bare(Foreign::DoubleSphere { xi, alpha })?,
            ))
        }
        "eucm" => {
            let [alpha, beta, plane @ ..] = intrinsics.vector::<6>()?;
            Ok((Plane::new(plane), bare(Foreign::Eucm { alpha, beta })?))
        }
        other => Err(of(format!(
            "the camera_model {other:?} is not known; expected pinhole, omni, ds or eucm"
        ))),
    }
}
