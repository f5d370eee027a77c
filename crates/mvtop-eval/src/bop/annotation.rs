//! `scene_gt.json`: the objects' poses in each image.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use super::json::read;
use crate::Result;

/// An object in an image, as the file has it: `cam_from_obj`, millimetres, not checked.
#[derive(Deserialize)]
pub(crate) struct Annotation {
    pub obj_id: u32,
    /// Row by row.
    #[serde(rename = "cam_R_m2c")]
    pub rotation: [f64; 9],
    #[serde(rename = "cam_t_m2c")]
    pub translation_mm: [f64; 3],
}

/// By image.
///
/// # Errors
/// [`crate::Error::Read`] where the file cannot be read, [`crate::Error::Input`] where it holds
/// something else.
pub(crate) fn load_annotations(path: &Path) -> Result<BTreeMap<u32, Vec<Annotation>>> {
    read(
        path,
        "{IMAGE: [{\"obj_id\": N, \"cam_R_m2c\": [9 numbers], \"cam_t_m2c\": [3 numbers]}]}",
    )
}
