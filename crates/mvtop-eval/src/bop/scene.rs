//! A scene: images, cameras and annotations.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, UnitQuaternion};
use serde::Deserialize;
use serde_json::{Map, Value};

use super::annotation::{Annotation, load_annotations};
use super::doubts::{Doubts, Inexact};
use super::json::{MM, motion, read_numbered};
use crate::statistics::median;
use crate::{Error, Result};
use mvtop_core::BBox;
use mvtop_core::camera::{Intrinsics, Projection};

/// Which image of a scene.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FrameId {
    /// What the camera's files end in, as `cam1` in `scene_camera_cam1.json`; empty for files
    /// without an ending.
    pub sensor: String,
    /// Number of the image.
    pub image: u32,
}

/// An image, its camera and what is annotated in it.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Which one it is.
    pub id: FrameId,
    /// File of the color or grey image.
    pub path: PathBuf,
    /// File of the depth image that belongs to it.
    pub depth: Option<PathBuf>,
    /// Of its camera.
    pub intrinsics: Intrinsics,
    /// Millimetres per unit of the depth image.
    pub depth_scale: f64,
    /// Camera frame to world frame, metres; `None` where the data set does not say where its camera
    /// stood.
    pub world_from_cam: Option<Isometry3<f64>>,
    /// In the file's order; empty where the annotations are kept back, as of most test splits.
    pub objects: Vec<Instance>,
    /// What else `scene_camera.json` says of it.
    pub more: Map<String, Value>,
}

/// An annotated object.
#[derive(Debug, Clone, PartialEq)]
pub struct Instance {
    /// Number of the object.
    pub object: u32,
    /// Object frame to camera frame, metres.
    pub cam_from_obj: Isometry3<f64>,
    /// Of the whole object also where it is hidden; `None` where it is not known.
    pub bbox: Option<BBox>,
    /// The same of what is visible of it.
    pub visible_bbox: Option<BBox>,
    /// Visible share of the object's pixels.
    pub visible: Option<f64>,
    /// What else `scene_gt_info.json` says of it.
    pub more: Map<String, Value>,
}

/// All images of a scene.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Its number in the split.
    pub id: u32,
    /// Where its files lie.
    pub folder: PathBuf,
    /// In the order of sensors and images.
    pub frames: BTreeMap<FrameId, Frame>,
    /// What of it is doubtful.
    pub doubts: Doubts,
}

#[derive(Deserialize)]
struct Camera {
    #[serde(rename = "cam_K")]
    k: Option<[f64; 9]>,
    cam_dist: Option<Vec<f64>>,
    #[serde(default = "one")]
    depth_scale: f64,
    // XYZ-IBD has the shorter names in some files.
    #[serde(rename = "cam_R_w2c", alias = "R_w2c")]
    r: Option<[f64; 9]>,
    #[serde(rename = "cam_t_w2c", alias = "t_w2c")]
    t: Option<[f64; 3]>,
    #[serde(flatten)]
    more: Map<String, Value>,
}

#[derive(Default, Deserialize)]
struct Info {
    bbox_obj: Option<[f64; 4]>,
    bbox_visib: Option<[f64; 4]>,
    visib_fract: Option<f64>,
    #[serde(flatten)]
    more: Map<String, Value>,
}

fn one() -> f64 {
    1.0
}

impl FrameId {
    /// The name of its camera in a rig: `cam1_000012`, or `000012` without a sensor.
    pub fn camera_id(&self) -> String {
        let usable = |c: char| c.is_alphanumeric() || "._-".contains(c);
        self.to_string().replace(|c| !usable(c), "_")
    }
}

impl fmt::Display for FrameId {
    /// `cam1/000012`, or `000012` without a sensor.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.sensor.is_empty() {
            write!(f, "{}/", self.sensor)?;
        }
        write!(f, "{:06}", self.image)
    }
}

/// Numbers of a split's scenes.
///
/// # Errors
/// [`Error::Geometry`] where the folder cannot be read, [`Error::Data`] where it has no scenes.
pub fn scene_ids(split: &Path) -> Result<Vec<u32>> {
    let entries = std::fs::read_dir(split).map_err(Error::read(split))?;
    let mut ids: Vec<u32> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            (!sensors(&path, "scene_camera").is_empty()).then_some(())?;
            path.file_name()?.to_str()?.parse().ok()
        })
        .collect();
    ids.sort_unstable();
    if ids.is_empty() {
        return Err(Error::Data(format!(
            "{}: expected scenes (000001/scene_camera.json, ...), got none; give the folder of the \
             data set with --dataset and the name of a split in it with --split",
            split.display()
        )));
    }
    Ok(ids)
}

/// Endings of a folder's files of some kind: of `scene_camera`, empty for `scene_camera.json` and
/// `cam1` for `scene_camera_cam1.json`.
pub(crate) fn sensors(folder: &Path, kind: &str) -> Vec<String> {
    let ending = |name: &str| match name.strip_prefix(kind)?.strip_suffix(".json")? {
        "" => Some(String::new()),
        ending => Some(ending.strip_prefix('_')?.to_owned()),
    };
    let names = std::fs::read_dir(folder).into_iter().flatten();
    let names = names.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut sensors: Vec<String> = names.filter_map(|name| ending(&name)).collect();
    sensors.sort();
    sensors
}

/// A sensor's file or folder of some kind, as [`sensors`] finds it.
pub(crate) fn of_sensor(folder: &Path, kind: &str, sensor: &str, end: &str) -> PathBuf {
    match sensor {
        "" => folder.join(format!("{kind}{end}")),
        _ => folder.join(format!("{kind}_{sensor}{end}")),
    }
}

impl Scene {
    /// Reads what is known of the images that are unpacked; see [`load_frames`].
    ///
    /// # Errors
    /// As [`load_frames`].
    pub fn load(split: &Path, id: u32) -> Result<Self> {
        let folder = split.join(format!("{id:06}"));
        let (frames, doubts) = load_frames(&folder, false)?;
        Ok(Self {
            id,
            folder,
            frames,
            doubts,
        })
    }
}

/// Reads what is known of a scene's images, in the order of sensors and images, and what of it is
/// doubtful; the images themselves are not opened.
///
/// Sensors without color or grey images, as of depth only, are left out.
///
/// - `folder`: of the scene
/// - `whole`: whether what is incomplete is refused, images that are listed but not unpacked and
///   annotations without a camera, or left out
///
/// # Errors
/// [`Error::Geometry`] where a file cannot be read, and another where it is
/// not BOP's.
pub fn load_frames(folder: &Path, whole: bool) -> Result<(BTreeMap<FrameId, Frame>, Doubts)> {
    let (mut frames, mut doubts) = (BTreeMap::new(), Doubts::default());
    for sensor in sensors(folder, "scene_camera") {
        load_sensor(folder, &sensor, whole, &mut frames, &mut doubts)?;
    }
    if frames.is_empty() {
        return Err(Error::Data(format!(
            "{}: expected scene_camera.json and images in rgb/ or gray/, got none; unpack the \
             data set's images there",
            folder.display()
        )));
    }
    if look_like_metres(frames.values()) {
        doubts.in_metres.push(folder.to_owned());
    }
    Ok((frames, doubts))
}

/// Whether the cameras stand a thousand times nearer to each other than they should, by a rule of
/// thumb: all of them within a hundredth of the objects' median distance from the world's origin.
fn look_like_metres<'a>(frames: impl Iterator<Item = &'a Frame> + Clone) -> bool {
    let poses = frames.clone().filter_map(|frame| frame.world_from_cam);
    // Of a camera that is the world there is nothing to tell.
    let farthest = poses
        .map(|pose| pose.translation.vector.norm())
        .fold(0.0, f64::max);
    let objects = frames.flat_map(|frame| &frame.objects);
    let distances = objects.map(|object| object.cam_from_obj.translation.vector.norm());
    let distance = median(&distances.collect::<Vec<_>>());
    distance.is_some_and(|distance| farthest > 0.0 && farthest < distance / 100.0)
}

fn load_sensor(
    folder: &Path,
    sensor: &str,
    whole: bool,
    frames: &mut BTreeMap<FrameId, Frame>,
    doubts: &mut Doubts,
) -> Result<()> {
    let named = |kind, end| of_sensor(folder, kind, sensor, end);
    let image_folders = ["rgb", "gray"].map(|kind| named(kind, ""));
    let Some(image_folder) = image_folders.iter().find(|dir| dir.is_dir()) else {
        return Ok(());
    };
    let depth_folder = [named("depth", "")];
    let camera_file = named("scene_camera", ".json");
    let cameras: BTreeMap<u32, Camera> =
        read_numbered(&camera_file, "{IMAGE: {\"cam_K\": [9 numbers], ...}}")?;
    let pose_file = named("scene_gt", ".json");
    let mut poses = optional(&pose_file, load_annotations)?;
    let mut infos: BTreeMap<u32, Vec<Info>> = optional(&named("scene_gt_info", ".json"), |path| {
        read_numbered(path, "{IMAGE: [{\"bbox_obj\": [x, y, w, h], ...}]}")
    })?;
    for (image, camera) in cameras {
        let place = format!("{}: image {image}", camera_file.display());
        let poses = poses.remove(&image).unwrap_or_default();
        let mut infos = infos.remove(&image).unwrap_or_default();
        infos.resize_with(poses.len(), Info::default);
        let Some(path) = find_image(&image_folders, image) else {
            if whole {
                let folder = image_folder.display();
                return Err(Error::Data(format!(
                    "{folder}: image {image}: expected a PNG, JPEG or TIFF file, got none; unpack \
                     the data set's images there"
                )));
            }
            if doubts.missing.count == 0 {
                doubts.missing.first = image_folder.join(format!("{image:06}"));
            }
            doubts.missing.count += 1;
            continue;
        };
        let id = FrameId {
            sensor: sensor.to_owned(),
            image,
        };
        let objects = poses.iter().zip(infos).enumerate();
        let inexact = &mut doubts.inexact;
        let objects = objects
            .map(|(row, (pose, info))| instance(pose, (&pose_file, image, row), info, inexact));
        let frame = Frame {
            path,
            depth: find_image(&depth_folder, image),
            intrinsics: camera.intrinsics(&place)?,
            depth_scale: camera.depth_scale,
            world_from_cam: camera.world_from_cam(&place)?,
            objects: objects.collect::<Result<_>>()?,
            more: camera.more,
            id: id.clone(),
        };
        frames.insert(id, frame);
    }
    match poses.keys().next() {
        Some(image) if whole => Err(Error::Data(format!(
            "{}: image {image}: expected its camera in {}, got none; add it, or delete its \
             annotations",
            pose_file.display(),
            camera_file.display()
        ))),
        _ => Ok(()),
    }
}

/// An empty map where there is no such file.
fn optional<T>(
    path: &Path,
    load: impl Fn(&Path) -> Result<BTreeMap<u32, T>>,
) -> Result<BTreeMap<u32, T>> {
    match path.is_file() {
        true => load(path),
        false => Ok(BTreeMap::new()),
    }
}

fn find_image(folders: &[PathBuf], image: u32) -> Option<PathBuf> {
    let ends = ["png", "jpg", "jpeg", "tif", "tiff"];
    let named = |folder: &PathBuf| ends.map(|end| folder.join(format!("{image:06}.{end}")));
    folders.iter().flat_map(named).find(|path| path.is_file())
}

impl Camera {
    fn intrinsics(&self, place: &str) -> Result<Intrinsics> {
        let by_model = self.more.contains_key("cam_model");
        let Some(k) = self.k.filter(|_| !by_model) else {
            let got = if by_model { "cam_model" } else { "none" };
            return Err(Error::Data(format!(
                "{place}: expected cam_K, got {got}; cameras described by cam_model are not \
                 supported, undistort their images to pinholes"
            )));
        };
        let [fx, skew, cx, zero_a, fy, cy, zero_b, zero_c, last] = k;
        let upper = [zero_a, zero_b, zero_c] == [0.0; 3] && last == 1.0;
        if !(upper && fx > 0.0 && fy > 0.0 && k.iter().all(|x| x.is_finite())) {
            return Err(Error::Data(format!(
                "{place}: expected cam_K as [fx, skew, cx, 0, fy, cy, 0, 0, 1], got {k:?}"
            )));
        }
        let params = self.cam_dist.as_deref().unwrap_or_default();
        if !(self.depth_scale.is_finite() && self.depth_scale > 0.0) {
            return Err(Error::Data(format!(
                "{place}: expected depth_scale above 0, got {}",
                self.depth_scale
            )));
        }
        let projection = Projection::from_params("pinhole", None, params)
            .map_err(|error| Error::Data(format!("{place}: cam_dist: {error}")))?;
        Intrinsics::new(fx, fy, cx, cy, projection)
            .and_then(|lens| lens.with_skew(skew))
            .map_err(|error| Error::Data(format!("{place}: cam_K: {error}")))
    }

    fn world_from_cam(&self, place: &str) -> Result<Option<Isometry3<f64>>> {
        match (&self.r, &self.t) {
            (Some(r), Some(t)) => {
                let place = format!("{place}: cam_R_w2c, cam_t_w2c");
                Ok(Some(motion(&place, r, t)?.inverse()))
            }
            (None, None) => Ok(None),
            _ => Err(Error::Data(format!(
                "{place}: expected the camera's pose as both cam_R_w2c and cam_t_w2c, got one of them"
            ))),
        }
    }
}

/// - `place`: as [`Annotation::pose`] wants it
fn instance(
    pose: &Annotation,
    place: (&Path, u32, usize),
    info: Info,
    inexact: &mut Inexact,
) -> Result<Instance> {
    let (rotation, translation_mm) = pose.pose(place, inexact)?;
    let corners = |[x, y, w, h]: [f64; 4]| BBox::from([x, y, x + w, y + h]);
    Ok(Instance {
        object: pose.obj_id,
        cam_from_obj: Isometry3::from_parts(
            (translation_mm * MM).into(),
            UnitQuaternion::from_rotation_matrix(&rotation),
        ),
        // BOP writes -1 where nothing of the object is in the image, or visible. One pixel that is
        // visible has width 0: boxes of what is visible reach from pixel center to pixel center.
        bbox: info
            .bbox_obj
            .filter(|&[_, _, w, h]| w > 0.0 && h > 0.0)
            .map(corners),
        visible_bbox: info
            .bbox_visib
            .filter(|&[_, _, w, h]| w >= 0.0 && h >= 0.0)
            .map(corners),
        visible: info.visib_fract,
        more: info.more,
    })
}
