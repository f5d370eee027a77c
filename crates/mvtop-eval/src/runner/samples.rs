//! Evaluates a folder of samples.

use std::path::{Path, PathBuf};

use mvtop_core::Estimator;
use mvtop_core::annotations::TruePose;
use mvtop_core::pose::{rotation_error_deg, translation_error};
use mvtop_core::prediction::ObjectPose;
use nalgebra::Point3;

use super::observer;
use super::outcome::{Errors, Outcome};
pub use super::sample::folders;
use super::{Conditions, Observer, Sample, Summary};
use crate::matching::{diameter, matches, unmatched};
use crate::metrics::Surface;
use crate::{Error, Result};

/// What came of all samples.
#[derive(Debug)]
pub struct Evaluated {
    /// Of each object of the truth.
    pub outcomes: Vec<Outcome>,
    /// What they amount to.
    pub summary: Summary,
}

/// Predicts each sample and compares with its truth.
///
/// - `folders`: from [`folders`]
///
/// # Errors
/// Where a sample cannot be read, or has another number of views than those before it, or the
/// estimator refuses it.
pub fn evaluate(
    folders: &[PathBuf],
    estimator: &Estimator,
    conditions: &Conditions,
    observer: &mut dyn Observer,
) -> Result<Evaluated> {
    observer.begin(folders.len(), 0);
    let mut views = None;
    let mut outcomes = Vec::new();
    let mut extra = Vec::new();
    let mut left_out = 0;
    for folder in folders {
        let sample = Sample::load(folder, conditions.views)?;
        same_views(&mut views, &sample, folder)?;
        if conditions.true_boxes {
            left_out += sample.boxes_left_out(&conditions.noise);
        }
        let prediction = sample.predict(estimator, conditions)?;
        observer::warn(observer, &prediction, &sample.name);
        let matched = matches(
            &sample.truth,
            &prediction,
            diameter(&estimator.bundle().classes),
        );
        let unmatched = unmatched(&matched, &prediction);
        extra.extend(unmatched.iter().map(|found| found.confidence));
        for (object, (known, &found)) in sample.truth.iter().zip(&matched).enumerate() {
            let errors = found.map(|found| errors(known, found, estimator));
            outcomes.push(Outcome::new(&sample, object, &prediction, found, errors));
        }
        observer.advance();
    }
    observer.end();
    if left_out > 0 {
        observer.warn(&format!(
            "--true-boxes: {left_out} of the boxes lie beside their image or its lens' field of \
             view, or are thinner than a pixel there: these cameras count as not seeing the object"
        ));
    }
    let views = views.unwrap_or(0);
    let summary = Summary::new(views, folders.len(), &extra, &outcomes, conditions.bounds);
    Ok(Evaluated { outcomes, summary })
}

fn same_views(views: &mut Option<usize>, sample: &Sample, folder: &Path) -> Result<()> {
    let count = sample.images.len();
    match *views.get_or_insert(count) == count {
        true => Ok(()),
        false => Err(Error::Input(format!(
            "sample {}: expected as many views as the samples before, got {count}; give \
             --views to use as many of each",
            folder.display()
        ))),
    }
}

/// Of the poses that look like the predicted one, the nearest to the truth counts. ADD is over the
/// points of the model bundle.
fn errors(known: &TruePose, found: &ObjectPose, estimator: &Estimator) -> Errors {
    let bundle = estimator.bundle();
    let class = bundle.class_index(&found.class).map(|c| &bundle.classes[c]);
    let truth = &known.world_from_obj;
    let pose = class.map_or(found.world_from_obj, |class| {
        let symmetry = &class.symmetry;
        symmetry.nearest(&found.world_from_obj, truth, class.diameter_m)
    });
    Errors {
        rot_deg: rotation_error_deg(&truth.rotation, &pose.rotation),
        trans_m: translation_error(truth, &pose),
        by_symmetry: Vec::new(),
        add_m: class.and_then(|class| {
            let points = class.points.iter();
            let points: Vec<Point3<f64>> = points.map(|p| p.position.into()).collect();
            // There may be no points.
            Some(Surface::new(&points).ok()?.add(truth, &pose))
        }),
    }
}
