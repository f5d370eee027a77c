//! A rig: calibrated cameras in one world frame. `docs/rig.md` describes its file format.

use crate::camera::Camera;

/// The cameras that look at a scene together.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// At least one; ids are unique.
    pub cameras: Vec<Camera>,
    /// Index of the reference camera, in whose frame poses are given.
    pub reference: usize,
}

impl Rig {
    /// Index of the camera of that id.
    pub fn index_of(&self, id: &str) -> Option<usize> {
        self.cameras.iter().position(|camera| camera.id == id)
    }
}
