//! A sample: images of one scene, the rig, and the truth.

use std::path::{Path, PathBuf};

use mvtop_core::annotations::{self, GivenBoxes, TruePose};
use mvtop_core::image::load_views;
use mvtop_core::{Estimator, PredictOptions, Prediction, Rig, ViewImage};

use super::Conditions;
use super::noise::Noise;
use crate::{Error, Result};

/// Images of one scene, the rig, and the truth.
pub struct Sample {
    /// Name of its folder.
    pub name: String,
    /// The cameras, also those without an image.
    pub rig: Rig,
    /// Of the cameras that are used.
    pub images: Vec<ViewImage>,
    /// The objects, and where they are.
    pub truth: Vec<TruePose>,
}

/// Folders with a rig in them, sorted by name.
///
/// # Errors
/// [`Error::Geometry`] where the folder cannot be read, [`Error::Input`] where there is none in it.
pub fn folders(dir: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(dir).map_err(Error::read(dir))?;
    let mut folders: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.join("rig.json").is_file())
        .collect();
    folders.sort();
    if folders.is_empty() {
        return Err(Error::Input(format!(
            "no sample in {}: expected folders with rig.json, truth.json and one image per camera",
            dir.display()
        )));
    }
    Ok(folders)
}

impl Sample {
    /// Reads a folder.
    ///
    /// - `views`: as many images, from the reference camera on; all without it
    ///
    /// # Errors
    /// Where a file is missing or refused, or the rig has fewer cameras.
    pub fn load(folder: &Path, views: Option<u32>) -> Result<Self> {
        let rig = Rig::load(&folder.join("rig.json"))?;
        let truth = annotations::load_truth(&folder.join("truth.json"))?;
        let cameras = rig.cameras().len();
        let views = views.map_or(cameras, |views| views as usize);
        if views > cameras {
            return Err(Error::Input(format!(
                "sample {}: expected at least {views} cameras, as --views asks for, got {cameras}",
                folder.display()
            )));
        }
        let mut of_cameras = Vec::new();
        for index in (0..views).map(|i| (rig.reference() + i) % cameras) {
            let camera = &rig.cameras()[index];
            let files = ["png", "jpg", "jpeg", "tif", "tiff", "bmp"]
                .map(|end| folder.join(format!("{}.{end}", camera.id())));
            let file = files.iter().find(|file| file.is_file()).ok_or_else(|| {
                let missing = files[0].display();
                Error::Input(format!(
                    "no image of camera `{}`: expected {missing} (or .jpg, .tif, .bmp)",
                    camera.id()
                ))
            })?;
            of_cameras.push((index, file.clone()));
        }
        let images = load_views(&rig, &of_cameras)?;
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        Ok(Self {
            name: name.into_owned(),
            rig,
            images,
            truth,
        })
    }

    /// What the estimator says of it under these conditions.
    ///
    /// # Errors
    /// As [`Estimator::predict`], and for noise that moves a camera too far.
    pub fn predict(&self, estimator: &Estimator, conditions: &Conditions) -> Result<Prediction> {
        let noise = &conditions.noise;
        let mut options = PredictOptions::default();
        options.boxes = conditions.true_boxes.then(|| self.boxes(noise));
        options.min_views = conditions.min_views as usize;
        options.refine = conditions.refine;
        let rig = noise.disturb_rig(&self.rig, &self.name)?;
        let mut prediction = estimator.predict(&rig, &self.images, &options)?;
        if let Some(least) = conditions.min_confidence {
            let objects = &mut prediction.objects;
            objects.retain(|object| object.confidence.is_some_and(|p| p >= least));
        }
        Ok(prediction)
    }

    /// Boxes of the objects that some image shows: others cannot be predicted, and count as not
    /// found.
    fn boxes(&self, noise: &Noise) -> Vec<GivenBoxes> {
        let disturbed = self.disturbed(noise);
        disturbed.filter(|seen| self.shown(seen) > 0).collect()
    }

    /// How many of the true boxes in its images are not used, as nothing of them lies within these, or
    /// the lens has no rays there.
    pub fn boxes_left_out(&self, noise: &Noise) -> usize {
        let all = self.truth.iter().map(|known| self.shown(&known.seen));
        let left = self.disturbed(noise).map(|seen| self.shown(&seen));
        all.sum::<usize>() - left.sum::<usize>()
    }

    /// The true boxes of each object, after noise.
    fn disturbed(&self, noise: &Noise) -> impl Iterator<Item = GivenBoxes> {
        self.truth.iter().enumerate().map(|(object, known)| {
            let mut seen = known.seen.clone();
            noise.disturb_boxes(&mut seen, &self.rig, &self.name, object);
            seen
        })
    }

    /// How many boxes are in its images.
    fn shown(&self, seen: &GivenBoxes) -> usize {
        let ids = self
            .images
            .iter()
            .map(|view| self.rig.cameras()[view.camera].id());
        ids.filter(|id| seen.boxes.contains_key(*id)).count()
    }
}
