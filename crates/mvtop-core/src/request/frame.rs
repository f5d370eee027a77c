//! The frame that poses are asked in.

use nalgebra::Isometry3;

use super::refuse;
use crate::{Result, Rig};

/// Name of the rig's world frame.
pub const WORLD: &str = "world";
/// Name of the robot's base frame.
pub const BASE: &str = "base";

/// World frame to the named one.
///
/// - `base`: world frame to the robot's base frame, where it is known
pub fn from_world(
    name: Option<&str>,
    base: Option<Isometry3<f64>>,
    rig: &Rig,
) -> Result<Isometry3<f64>> {
    match name {
        None | Some(WORLD) => Ok(Isometry3::identity()),
        Some(BASE) => base.ok_or_else(|| {
            refuse(
                "frame `base`: expected the transform from the world to the robot's base, got none; \
                 give T_base_world",
            )
        }),
        Some(id) => {
            let camera = rig.find("frame (`world`, `base` or a camera)", id)?;
            Ok(rig.cameras()[camera].world_from_cam().inverse())
        }
    }
}
