//! The pose annotations of a split in BOP layout: `scene_gt.json` of its scenes.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use mvtop_core::pose::rotation_error_deg;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use crate::bop::{Inexact, load_annotations, of_sensor, sensors};
use crate::statistics::median;
use crate::{Error, Result};

/// One annotation of one object: its pose `cam_from_obj`, and where it stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseRecord {
    /// Index into [`Split::scenes`].
    pub scene: u32,
    /// Image id.
    pub image: u32,
    /// Place in the image's list of annotations.
    pub annotation: u32,
    /// Of `cam_from_obj`.
    pub rotation: Matrix3<f64>,
    /// Of `cam_from_obj`, millimetres.
    pub translation_mm: Vector3<f64>,
}

impl PoseRecord {
    /// Angle between two poses' rotations, degrees.
    pub fn rotation_error_deg(&self, other: &Self) -> f64 {
        let [a, b] = [self, other].map(|pose| {
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(pose.rotation))
        });
        rotation_error_deg(&a, &b)
    }

    /// Distance of two poses' translations, millimetres.
    pub fn translation_error_mm(&self, other: &Self) -> f64 {
        (self.translation_mm - other.translation_mm).norm()
    }
}

/// All poses of a split.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Split {
    /// Names of the scene folders; `folder/sensor` where each sensor has its own annotations.
    pub scenes: Vec<String>,
    /// By object id, in the order of scenes, images and annotations.
    pub objects: BTreeMap<u32, Vec<PoseRecord>>,
    /// Of rotations of few digits, which were made exact.
    pub inexact: Inexact,
}

impl Split {
    /// Of one object; none where the split does not hold it.
    pub(super) fn poses_of(&self, object_id: u32) -> &[PoseRecord] {
        self.objects.get(&object_id).map_or(&[], Vec::as_slice)
    }

    /// Median distance of the objects from the camera, millimetres; `None` where there is none.
    pub fn median_distance_mm(&self) -> Option<f64> {
        let poses = self.objects.values().flatten();
        median(
            &poses
                .map(|pose| pose.translation_mm.norm())
                .collect::<Vec<_>>(),
        )
    }

    /// Number of poses, of all objects.
    pub fn poses(&self) -> usize {
        self.objects.values().map(Vec::len).sum()
    }
}

/// The files that a split's annotations are in.
#[derive(Debug, Clone)]
pub struct Files {
    scenes: Vec<(String, PathBuf)>,
    /// Size of all files together.
    pub bytes: u64,
}

impl Files {
    /// `scene_gt.json`, or `scene_gt_<sensor>.json`, of each scene in a split's folder, or of the
    /// folder itself where it is a scene.
    ///
    /// # Errors
    /// [`Error::Geometry`] where a folder cannot be read, [`Error::Data`] where there is no such file.
    pub fn find(folder: &Path) -> Result<Self> {
        // Canonical, so that a file which two splits share is recognised.
        let folder = fs::canonicalize(folder).map_err(Error::read(folder))?;
        let mut scenes = annotations(&folder);
        if scenes.is_empty() {
            for path in listed(&folder)? {
                scenes.extend(annotations(&path));
            }
        }
        if scenes.is_empty() {
            return Err(Error::Data(format!(
                "{}: expected a split, that is a folder of scene folders with scene_gt.json, or \
                 one such scene, got a folder with none; give the folder of the split, such as \
                 DATASET/test",
                folder.display()
            )));
        }
        let size = |path: &Path| Ok(fs::metadata(path).map_err(Error::read(path))?.len());
        let bytes = scenes
            .iter()
            .map(|(_, path)| size(path))
            .sum::<Result<u64>>()?;
        Ok(Self { scenes, bytes })
    }

    /// A file that both have.
    pub fn shared_with(&self, other: &Self) -> Option<&Path> {
        let shared = |path: &&PathBuf| other.scenes.iter().any(|(_, theirs)| theirs == *path);
        let mut paths = self.scenes.iter().map(|(_, path)| path);
        paths.find(shared).map(PathBuf::as_path)
    }

    /// Reads all files; `done` is told the size of each one read.
    ///
    /// # Errors
    /// [`Error::Geometry`] where a file cannot be read, [`Error::Data`] where it does not hold poses.
    pub fn read(&self, done: impl Fn(u64) + Sync) -> Result<Split> {
        let read = |(scene, (_, path)): (usize, &(String, PathBuf))| {
            let poses = poses(path, scene as u32)?;
            done(fs::metadata(path).map_or(0, |about| about.len()));
            Ok(poses)
        };
        let read = self.scenes.par_iter().enumerate().map(read);
        let read: Vec<(Vec<(u32, PoseRecord)>, Inexact)> = read.collect::<Result<_>>()?;
        let mut split = Split {
            scenes: self.scenes.iter().map(|(name, _)| name.clone()).collect(),
            ..Split::default()
        };
        for (poses, inexact) in read {
            split.inexact.extend(inexact);
            for (object, pose) in poses {
                split.objects.entry(object).or_default().push(pose);
            }
        }
        Ok(split)
    }
}

/// The files with annotations of one scene, each with its name.
fn annotations(scene: &Path) -> Vec<(String, PathBuf)> {
    let folder = scene.file_name().unwrap_or_default().to_string_lossy();
    let mut sensors = sensors(scene, "scene_gt");
    // `scene_gt_info.json` and `scene_gt_info_<sensor>.json` hold boxes.
    sensors.retain(|sensor| sensor.split('_').next() != Some("info"));
    let file = |sensor: String| {
        let name = match &sensor[..] {
            "" => folder.to_string(),
            _ => format!("{folder}/{sensor}"),
        };
        (name, of_sensor(scene, "scene_gt", &sensor, ".json"))
    };
    sensors.into_iter().map(file).collect()
}

/// What is in a folder, sorted.
fn listed(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).map_err(Error::read(folder))?;
    let paths = entries.map(|entry| Ok(entry?.path()));
    let mut paths: Vec<_> = paths
        .collect::<io::Result<_>>()
        .map_err(Error::read(folder))?;
    paths.sort();
    Ok(paths)
}

/// Object and pose of each annotation in a file.
fn poses(path: &Path, scene: u32) -> Result<(Vec<(u32, PoseRecord)>, Inexact)> {
    let (mut poses, mut inexact) = (Vec::new(), Inexact::default());
    for (image, annotations) in load_annotations(path)? {
        for (i, annotation) in annotations.iter().enumerate() {
            let (rotation, translation_mm) = annotation.pose((path, image, i), &mut inexact)?;
            let pose = PoseRecord {
                scene,
                image,
                annotation: i as u32,
                rotation: rotation.into_inner(),
                translation_mm,
            };
            poses.push((annotation.obj_id, pose));
        }
    }
    Ok((poses, inexact))
}
