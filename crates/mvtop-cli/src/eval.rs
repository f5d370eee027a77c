//! `eval`: errors of the poses over many samples whose truth is known.

use std::path::{Path, PathBuf};

use image::RgbImage;
use indicatif::{ProgressBar, ProgressStyle};
use mvtop_core::known::{self, KnownPose};
use mvtop_core::pose::{add, rotation_error_deg, translation_error};
use mvtop_core::report::Report;
use mvtop_core::{Estimator, PredictOptions, Prediction, Rig};
use nalgebra::Point3;
use serde::Serialize;

use crate::args::Eval;
use crate::failure::{Failure, Result, may_write, print};
use crate::{model_dir, table};

/// A rotation that is off by more is taken for a wrong one rather than an inexact one.
const WRONG_DEG: f64 = 30.0;

/// The last line of stdout. Means are over the found objects, null where there is none.
#[derive(Serialize)]
struct Summary {
    views: usize,
    /// Samples.
    pairs: usize,
    /// Objects of the truth for which there is a predicted pose of their class.
    found: usize,
    rot_mean_deg: Option<f64>,
    rot_median_deg: Option<f64>,
    share_over_30_deg: Option<f64>,
    add_mean_m: Option<f64>,
    trans_mean_m: Option<f64>,
    sigma_rot_mean_deg: Option<f64>,
    sigma_t_mean_m: Option<f64>,
}

/// How far one predicted pose is off, and what the network expected.
#[derive(Clone, Serialize)]
struct Errors {
    class: String,
    rot_deg: f64,
    t_m: f64,
    add_m: Option<f64>,
    sigma_rot_deg: f64,
    sigma_t_m: f64,
}

/// One element of `--out`.
#[derive(Serialize)]
struct Outcome {
    sample: String,
    /// For each object of the truth, null where it was not found.
    errors: Vec<Option<Errors>>,
    prediction: Report,
}

struct Sample {
    rig: Rig,
    images: Vec<(usize, RgbImage)>,
    truth: Vec<KnownPose>,
}

pub fn run(args: &Eval) -> Result<()> {
    let folders = sample_folders(&args.samples)?;
    if let Some(out) = &args.out {
        may_write(out, args.force)?;
    }
    let estimator = Estimator::load(
        &model_dir::find(args.network.model.as_deref())?,
        &args.network.options(),
    )?;

    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} samples, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(folders.len() as u64).with_style(style);
    let mut views = None;
    let mut outcomes = Vec::new();
    for folder in &folders {
        let sample = Sample::load(folder, args.views)?;
        let count = sample.images.len();
        if *views.get_or_insert(count) != count {
            return Err(Failure(format!(
                "sample {}: expected as many views as the samples before, got {count}; give \
                 --views to use as many of each",
                folder.display()
            )));
        }
        let prediction = sample.predict(&estimator, args.true_boxes)?;
        outcomes.push(Outcome {
            sample: folder
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            errors: sample
                .truth
                .iter()
                .map(|known| errors(known, &prediction, &estimator))
                .collect(),
            prediction: Report::new(&prediction, &sample.rig),
        });
        bar.inc(1);
    }
    bar.finish_and_clear();

    let json_error = |cause| Failure(format!("cannot write JSON: {cause}"));
    if let Some(out) = &args.out {
        let text = serde_json::to_string_pretty(&outcomes).map_err(json_error)?;
        std::fs::write(out, text + "\n")
            .map_err(|cause| Failure(format!("cannot write {}: {cause}", out.display())))?;
    }
    let found: Vec<&Errors> = outcomes
        .iter()
        .flat_map(|o| o.errors.iter().flatten())
        .collect();
    let summary = summary(views.unwrap_or(0), folders.len(), &found);
    print(&serde_json::to_string(&summary).map_err(json_error)?)
}

/// Folders with a rig in them, sorted by name.
fn sample_folders(dir: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(dir)
        .map_err(|cause| Failure(format!("cannot read {}: {cause}", dir.display())))?;
    let mut folders: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.join("rig.json").is_file())
        .collect();
    folders.sort();
    if folders.is_empty() {
        return Err(Failure(format!(
            "no sample in {}: expected folders with rig.json, truth.json and one image per camera",
            dir.display()
        )));
    }
    Ok(folders)
}

impl Sample {
    fn load(folder: &Path, views: Option<u32>) -> Result<Self> {
        let rig = Rig::load(&folder.join("rig.json"))?;
        let truth = known::load_poses(&folder.join("truth.json"))?;
        let cameras = rig.cameras.len();
        let views = views.map_or(cameras, |views| views as usize);
        if views > cameras {
            return Err(Failure(format!(
                "sample {}: expected at least {views} cameras, as --views asks for, got {cameras}",
                folder.display()
            )));
        }
        let mut images = Vec::new();
        for index in (0..cameras)
            .map(|i| (rig.reference + i) % cameras)
            .take(views)
        {
            let camera = &rig.cameras[index];
            let files = ["png", "jpg", "jpeg"].map(|e| folder.join(format!("{}.{e}", camera.id)));
            let file = files.iter().find(|file| file.is_file()).ok_or_else(|| {
                let missing = files[0].display();
                Failure(format!(
                    "no image of camera `{}`: expected {missing} or .jpg",
                    camera.id
                ))
            })?;
            images.push((index, mvtop_core::image::load(file, camera)?));
        }
        Ok(Self { rig, images, truth })
    }

    fn predict(&self, estimator: &Estimator, true_boxes: bool) -> Result<Prediction> {
        let in_images = |known: &&KnownPose| {
            let id = |(index, _): &(usize, RgbImage)| &self.rig.cameras[*index].id;
            self.images
                .iter()
                .any(|image| known.seen.boxes.contains_key(id(image)))
        };
        // An object that no image shows cannot be predicted: it counts as not found.
        let boxes = || {
            self.truth
                .iter()
                .filter(in_images)
                .map(|known| known.seen.clone())
                .collect()
        };
        let options = PredictOptions {
            reference: None,
            boxes: true_boxes.then(boxes),
        };
        Ok(estimator.predict(&self.rig, &self.images, &options)?)
    }
}

/// `None` where no object of the class was predicted.
fn errors(known: &KnownPose, prediction: &Prediction, estimator: &Estimator) -> Option<Errors> {
    let object = table::nearest(known, prediction)?;
    let (truth, estimate) = (&known.world_from_obj, &object.world_from_obj);
    let class = estimator
        .bundle()
        .classes
        .iter()
        .find(|class| class.name == object.class)?;
    let points: Vec<Point3<f64>> = class.points.iter().map(|p| p.position.into()).collect();
    Some(Errors {
        class: object.class.clone(),
        rot_deg: rotation_error_deg(&truth.rotation, &estimate.rotation),
        t_m: translation_error(truth, estimate),
        add_m: add(&points, truth, estimate),
        sigma_rot_deg: object.sigma.rot_deg,
        sigma_t_m: object.sigma.t_m,
    })
}

fn summary(views: usize, pairs: usize, found: &[&Errors]) -> Summary {
    let mean = |value: fn(&Errors) -> f64| {
        let sum: f64 = found.iter().map(|errors| value(errors)).sum();
        (!found.is_empty()).then(|| sum / found.len() as f64)
    };
    let mut rotations: Vec<f64> = found.iter().map(|errors| errors.rot_deg).collect();
    rotations.sort_by(f64::total_cmp);
    Summary {
        views,
        pairs,
        found: found.len(),
        rot_mean_deg: mean(|e| e.rot_deg),
        rot_median_deg: median(&rotations),
        share_over_30_deg: mean(|e| f64::from(u8::from(e.rot_deg > WRONG_DEG))),
        add_mean_m: mean(|e| e.add_m.unwrap_or(f64::NAN)).filter(|mean| mean.is_finite()),
        trans_mean_m: mean(|e| e.t_m),
        sigma_rot_mean_deg: mean(|e| e.sigma_rot_deg),
        sigma_t_mean_m: mean(|e| e.sigma_t_m),
    }
}

/// Middle of sorted values, the mean of the two middle ones where their number is even.
fn median(sorted: &[f64]) -> Option<f64> {
    let upper = sorted.get(sorted.len() / 2)?;
    let lower = sorted.get(sorted.len().saturating_sub(1) / 2)?;
    Some((lower + upper) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn off_by(rot_deg: f64, t_m: f64) -> Errors {
        let class = "ball".to_owned();
        Errors {
            class,
            rot_deg,
            t_m,
            add_m: Some(t_m / 2.0),
            sigma_rot_deg: 3.0,
            sigma_t_m: 0.5,
        }
    }

    #[test]
    fn summary_of_four_objects() {
        let errors = [
            off_by(10.0, 0.1),
            off_by(50.0, 0.3),
            off_by(2.0, 0.2),
            off_by(30.0, 0.2),
        ];
        let found: Vec<&Errors> = errors.iter().collect();
        let summary = summary(2, 5, &found);
        assert_eq!((summary.views, summary.pairs, summary.found), (2, 5, 4));
        assert_eq!(summary.rot_mean_deg, Some(23.0));
        assert_eq!(summary.rot_median_deg, Some(20.0));
        assert_eq!(summary.share_over_30_deg, Some(0.25));
        assert!((summary.trans_mean_m.unwrap() - 0.2).abs() < 1e-12);
        assert!((summary.add_mean_m.unwrap() - 0.1).abs() < 1e-12);
        assert_eq!(summary.sigma_rot_mean_deg, Some(3.0));
        assert_eq!(summary.sigma_t_mean_m, Some(0.5));
    }

    #[test]
    fn summary_of_nothing_is_null() {
        let json = serde_json::to_value(summary(2, 1, &[])).unwrap();
        assert_eq!(json["found"], 0);
        for key in [
            "rot_mean_deg",
            "rot_median_deg",
            "share_over_30_deg",
            "add_mean_m",
        ] {
            assert!(json[key].is_null(), "{key}");
        }
    }

    #[test]
    fn median_of_an_odd_number_is_the_middle() {
        assert_eq!(median(&[1.0, 2.0, 9.0]), Some(2.0));
        assert_eq!(median(&[4.0]), Some(4.0));
        assert_eq!(median(&[]), None);
    }
}
