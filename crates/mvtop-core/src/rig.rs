//! A rig: calibrated cameras in one world frame. `docs/rig.md` describes its file format.

mod fields;
mod parse;
pub mod transform;
mod unit;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde_json::{Value, json};

use crate::camera::{Camera, Distortion};
use crate::{Error, Result, pose};

const FORMAT: &str = "mvtop-rig";
const VERSION: u64 = 1;
/// Largest rig file that is read.
const MAX_FILE_BYTES: u64 = 1 << 24;

/// The cameras that look at a scene together.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// At least one; ids are unique.
    pub cameras: Vec<Camera>,
    /// Index of the reference camera, in whose frame poses are given.
    pub reference: usize,
}

impl Rig {
    /// Reads a rig file.
    ///
    /// # Errors
    /// [`Error::Read`] where the file cannot be read, [`Error::Rig`] where it is refused.
    pub fn load(path: &Path) -> Result<Self> {
        let mut text = String::new();
        File::open(path)
            .and_then(|file| file.take(MAX_FILE_BYTES + 1).read_to_string(&mut text))
            .map_err(|cause| Error::Read {
                path: path.to_owned(),
                cause,
            })?;
        let origin = path.display().to_string();
        if text.len() as u64 > MAX_FILE_BYTES {
            let problem = format!("larger than {} MiB, so no rig", MAX_FILE_BYTES >> 20);
            return Err(Error::Rig { origin, problem });
        }
        parse::rig(&text).map_err(|problem| Error::Rig { origin, problem })
    }

    /// Reads the text of a rig file.
    ///
    /// # Errors
    /// [`Error::Rig`] for anything that is no rig, or that hints at a mistake: every value is
    /// checked, and nothing is guessed.
    pub fn from_json(text: &str) -> Result<Self> {
        parse::rig(text).map_err(|problem| Error::Rig {
            origin: "rig".into(),
            problem,
        })
    }

    /// The text of a rig file, in metres; [`Rig::from_json`] reads the same rig from it.
    pub fn to_json(&self) -> String {
        let reference = self.cameras.get(self.reference).map(|camera| &camera.id);
        let rig = json!({
            "format": FORMAT,
            "version": VERSION,
            "unit": unit::Unit::Metre.name(),
            "reference": reference,
            "cameras": self.cameras.iter().map(camera_json).collect::<Vec<_>>(),
        });
        format!("{rig:#}\n")
    }

    /// Index of the camera of that id.
    pub fn index_of(&self, id: &str) -> Option<usize> {
        self.cameras.iter().position(|camera| camera.id == id)
    }
}

fn camera_json(camera: &Camera) -> Value {
    let lens = &camera.lens;
    let (model, distortion) = match &lens.distortion {
        Distortion::None => ("pinhole", None),
        Distortion::BrownConrady(d) => ("pinhole", Some(("brown_conrady", &d.params()[..]))),
        Distortion::KannalaBrandt(d) => ("fisheye", Some(("kannala_brandt", &d.params()[..]))),
    };
    let mut value = json!({
        "id": camera.id,
        "width": camera.width,
        "height": camera.height,
        "model": model,
        "fx": lens.fx,
        "fy": lens.fy,
        "cx": lens.cx,
        "cy": lens.cy,
        "T_world_cam": {
            "t": camera.world_from_cam.translation.vector.as_slice(),
            "q_wxyz": pose::wxyz(&camera.world_from_cam.rotation),
        },
    });
    if let Some((model, params)) = distortion {
        value["distortion"] = json!({ "model": model, "params": params });
    }
    value
}
