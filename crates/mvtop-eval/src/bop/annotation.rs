//! `scene_gt.json`: the objects' poses in each image.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Rotation3, Vector3};
use serde::Deserialize;

use super::doubts::Inexact;
use super::json::{read_numbered, rotation};
use crate::{Error, Result};

/// Translations beyond this, 100 km, are taken for broken.
const FARTHEST_MM: f64 = 1e8;

/// An object in an image, as the file has it: `cam_from_obj`, not checked.
#[derive(Deserialize)]
pub(crate) struct Annotation {
    pub obj_id: u32,
    #[serde(rename = "cam_R_m2c")]
    rotation: [f64; 9],
    #[serde(rename = "cam_t_m2c")]
    translation_mm: [f64; 3],
}

/// By image, in the file's order.
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read or holds something else.
pub(crate) fn load_annotations(path: &Path) -> Result<BTreeMap<u32, Vec<Annotation>>> {
    read_numbered(
        path,
        "{IMAGE: [{\"obj_id\": N, \"cam_R_m2c\": [9 numbers], \"cam_t_m2c\": [3 numbers]}]}",
    )
}

impl Annotation {
    /// The pose, checked: a rotation that is exact, and a translation in millimetres.
    ///
    /// - `place`: file, image, and row of the image's list, for the error
    /// - `inexact`: takes note of how far the rotation was off
    ///
    /// # Errors
    /// [`Error::Data`] where the two are no pose.
    pub fn pose(
        &self,
        (path, image, row): (&Path, u32, usize),
        inexact: &mut Inexact,
    ) -> Result<(Rotation3<f64>, Vector3<f64>)> {
        let place = || format!("{}: image {image}, row {row}", path.display());
        let refuse = |problem| Error::Data(format!("{}: {problem}", place()));
        let translation_mm = Vector3::from(self.translation_mm);
        if translation_mm.amax() > FARTHEST_MM {
            return Err(refuse(format!(
                "cam_t_m2c: expected millimetres of at most {FARTHEST_MM:e}, got {:?}",
                self.translation_mm
            )));
        }
        let rotation = rotation(&self.rotation);
        let (rotation, off) =
            rotation.map_err(|problem| refuse(format!("cam_R_m2c: {problem}")))?;
        inexact.note(off, place);
        Ok((rotation, translation_mm))
    }
}
