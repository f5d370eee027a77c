//! A rig file as it is written. What is read may say some of it in other ways, see [`super::parse`].

use serde::Serialize;

use super::{FORMAT, Rig, VERSION, unit};
use crate::camera::Camera;
use crate::pose;

/// Cameras in one world frame.
#[derive(Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "Rig", deny_unknown_fields)
)]
pub(super) struct Document<'a> {
    /// `"mvtop-rig"`.
    format: &'static str,
    /// 1.
    version: u64,
    /// Unit of all translations: `"m"`, `"cm"` or `"mm"`.
    unit: &'static str,
    /// Cameras, each with `T_world_cam` or `T_cam_world`.
    cameras: Vec<CameraEntry<'a>>,
    /// Camera in whose frame poses are reported; the first by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    reference: Option<&'a str>,
    /// Accepts distances between cameras that hint at a wrong unit; `false` by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    trust_unit: Option<bool>,
}

#[derive(Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(rename = "Camera", deny_unknown_fields)
)]
struct CameraEntry<'a> {
    /// Unique; letters, digits, `_`, `-`, `.`.
    id: &'a str,
    /// Width of the images, px.
    width: u32,
    /// Height of the images, px.
    height: u32,
    /// `"pinhole"`, the default, or `"fisheye"`.
    #[serde(skip_serializing_if = "Option::is_none")]
    model: Option<&'static str>,
    /// Focal length along the rows, px.
    fx: f64,
    /// Focal length along the columns, px.
    fy: f64,
    /// Column of the principal point, px.
    cx: f64,
    /// Row of the principal point, px.
    cy: f64,
    /// Of the camera matrix `[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]`; at most a tenth of `fx`, 0 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    skew: Option<f64>,
    /// Distortion of the lens; none by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    distortion: Option<Distortion<'a>>,
    /// Largest angle from the optical axis with an image, degrees; beyond it, pixels have no ray.
    #[serde(skip_serializing_if = "Option::is_none")]
    max_angle_deg: Option<f64>,
    /// Camera to world: the camera's pose.
    #[serde(rename = "T_world_cam", skip_serializing_if = "Option::is_none")]
    world_from_cam: Option<Transform>,
    /// World to camera, instead.
    #[serde(rename = "T_cam_world", skip_serializing_if = "Option::is_none")]
    cam_from_world: Option<Transform>,
}

#[derive(Serialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(deny_unknown_fields)
)]
struct Distortion<'a> {
    /// `brown_conrady` of a pinhole, `kannala_brandt` of a fisheye.
    model: &'static str,
    /// In OpenCV's order: the first 0, 4, 5, 8, 12 or 14 of k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty; k1 k2 k3 k4 of a fisheye.
    params: &'a [f64],
}

/// A 4x4 matrix in rows, or `t` with a unit quaternion, `q_wxyz` or `q_xyzw`.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged)]
#[expect(dead_code, reason = "only read, by hand; the schema has them")]
enum Transform {
    Matrix([[f64; 4]; 4]),
    Wxyz { t: [f64; 3], q_wxyz: [f64; 4] },
    Xyzw { t: [f64; 3], q_xyzw: [f64; 4] },
}

impl<'a> Document<'a> {
    pub fn of(rig: &'a Rig) -> Self {
        Self {
            format: FORMAT,
            version: VERSION,
            unit: unit::METRE.name,
            cameras: rig.cameras.iter().map(CameraEntry::of).collect(),
            reference: Some(rig.reference_camera().id()),
            trust_unit: unit::implausible(&rig.cameras).is_some().then_some(true),
        }
    }
}

impl<'a> CameraEntry<'a> {
    fn of(camera: &'a Camera) -> Self {
        let (lens, pose) = (camera.intrinsics(), camera.world_from_cam());
        let projection = lens.projection();
        Self {
            id: camera.id(),
            width: camera.width(),
            height: camera.height(),
            model: Some(projection.family()),
            fx: lens.fx(),
            fy: lens.fy(),
            cx: lens.cx(),
            cy: lens.cy(),
            skew: Some(lens.skew()).filter(|skew| *skew != 0.0),
            distortion: projection.distortion().map(|model| Distortion {
                model,
                params: projection.params(),
            }),
            max_angle_deg: lens.max_angle_deg(),
            world_from_cam: Some(Transform::Wxyz {
                t: pose.translation.vector.into(),
                q_wxyz: pose::wxyz(&pose.rotation),
            }),
            cam_from_world: None,
        }
    }
}
