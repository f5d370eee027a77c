//! Calibrations of OAK cameras, as DepthAI's `eepromToJsonFile` writes them.
//!
//! Source: <https://github.com/luxonis/depthai-core>, `CalibrationHandler.cpp`: `extrinsics` map a camera's
//! coordinates to those of the camera at `toCameraSocket`, -1 for none, in cm; `cameraType` 0 is OpenCV's pinhole
//! with up to 14 coefficients, 1 its fisheye with 4. `specTranslation` is the design's, not measured.

use std::collections::BTreeMap;

use nalgebra::Isometry3;
use serde_json::Value;

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};

/// Keys of a camera; `lensPosition` is the focus that it was calibrated at.
const KNOWN: [&str; 9] = [
    "cameraType",
    "distortionCoeff",
    "extrinsics",
    "height",
    "width",
    "intrinsicMatrix",
    "lensPosition",
    "specHfovDeg",
    "hfovDeg",
];

/// Keys of the whole board: names, IMU and housing, and what rectifies a pair.
const OF_BOARD: [&str; 22] = [
    "batchName",
    "batchTime",
    "boardConf",
    "boardCustom",
    "boardName",
    "boardOptions",
    "boardRev",
    "cameraData",
    "deviceName",
    "hardwareConf",
    "housingExtrinsics",
    "housing",
    "imuExtrinsics",
    "miscellaneousData",
    "productName",
    "stereoEnableDistortionCorrection",
    "stereoRectificationData",
    "stereoUseSpecTranslation",
    "swapLeftRightCam",
    "version",
    "verticalCameraSocket",
    "schema_version",
];
const OF_EXTRINSICS: [&str; 4] = [
    "rotationMatrix",
    "specTranslation",
    "toCameraSocket",
    "translation",
];

/// Coefficients of OpenCV's fisheye.
const FISHEYE: usize = 4;

/// A camera's coordinates in those of the camera at another socket.
type Link = (i64, Isometry3<f64>);

/// Whether it has cameras as DepthAI writes them.
pub fn is_it(value: &Value) -> bool {
    value.get("cameraData").is_some()
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let [source] = sources else {
        let got = sources.len();
        return Err(format!("expected one file of an OAK camera, got {got}"));
    };
    let document = yaml::document(source)?;
    let top = Node::new(&document, &source.name);
    unread::refuse(&top, &OF_BOARD, options)?;
    let (mut cameras, mut links) = (Vec::new(), BTreeMap::new());
    for pair in top.get(&["cameraData"])?.list()? {
        let [socket, data] = &pair.list()?[..] else {
            return Err(pair.wrong("a socket's number and its camera"));
        };
        let number = socket.value.as_i64();
        let letter = number.and_then(|number| u8::try_from(number).ok());
        let (Some(number), Some(letter)) = (number, letter.filter(|number| *number < 26)) else {
            return Err(socket.wrong("a socket's number"));
        };
        if links.insert(number, link(data, options)?).is_some() {
            return Err(socket.wrong("each socket once"));
        }
        let name = format!("CAM_{}", char::from(b'A' + letter));
        cameras.push((number, camera(name, data, options)?));
    }
    // The camera at the end of the first one's links.
    let world = cameras
        .first()
        .map(|(first, _)| last_from(&links, *first).0);
    for (socket, camera) in &mut cameras {
        let (last, last_from_cam) = last_from(&links, *socket);
        camera.pose = (Some(last) == world).then(|| Pose::world_from_cam(last_from_cam));
    }
    Ok(Draft {
        cameras: cameras.into_iter().map(|(_, camera)| camera).collect(),
        metres: Some(1e-2),
        posing: "give its `extrinsics`",
        notes: vec![
            "of images of the sizes that the file states, neither scaled nor cropped".into(),
        ],
    })
}

fn camera(id: String, data: &Node, options: &Options) -> Checked<DraftCamera> {
    unread::refuse(data, &KNOWN, options)?;
    let of = |problem: String| format!("{}: {problem}", data.place);
    let kind = data.get(&["cameraType"])?;
    let params = data.get(&["distortionCoeff"])?.numbers()?;
    let lens = match kind.number()? {
        0.0 => Lens::brown_conrady(&params),
        1.0 => match params.split_at_checked(FISHEYE) {
            Some((params, rest)) if rest.iter().all(|&rest| rest == 0.0) => {
                Lens::kannala_brandt(params)
            }
            _ => {
                return Err(data
                    .get(&["distortionCoeff"])?
                    .wrong("4 coefficients of a fisheye"));
            }
        },
        _ => return Err(kind.wrong("0 (pinhole) or 1 (fisheye)")),
    };
    Ok(DraftCamera {
        id,
        size: Some([
            data.get(&["width"])?.pixels()?,
            data.get(&["height"])?.pixels()?,
        ]),
        plane: Plane::from_matrix(data.get(&["intrinsicMatrix"])?.vector()?).map_err(of)?,
        lens: lens.map_err(of)?,
        pose: None,
    })
}

fn link(data: &Node, options: &Options) -> Checked<Option<Link>> {
    let extrinsics = data.get(&["extrinsics"])?;
    unread::refuse(&extrinsics, &OF_EXTRINSICS, options)?;
    if let Some(translation) = extrinsics.find(&["translation"]) {
        unread::refuse(&translation, &["x", "y", "z"], options)?;
    }
    let to = extrinsics.get(&["toCameraSocket"])?;
    let socket = to
        .value
        .as_i64()
        .ok_or_else(|| to.wrong("a socket's number"))?;
    if socket < 0 {
        return Ok(None);
    }
    let translation = extrinsics.get(&["translation"])?;
    let along = |key: &str| translation.get(&[key])?.number();
    let rotation = extrinsics.get(&["rotationMatrix"])?.vector()?;
    let translation = [along("x")?, along("y")?, along("z")?];
    let there = draft::rotation_and_translation(&extrinsics.place, &rotation, translation)?;
    Ok(Some((socket, there)))
}

/// The socket at the end of a camera's links, and the camera's coordinates in those of that one.
fn last_from(links: &BTreeMap<i64, Option<Link>>, socket: i64) -> Link {
    let mut last = (socket, Isometry3::identity());
    // No more steps than cameras, as links may form a ring.
    for _ in links {
        match links.get(&last.0) {
            Some(Some((next, there))) => last = (*next, there * last.1),
            _ => break,
        }
    }
    last
}
