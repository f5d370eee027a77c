//! `eval samples`: a folder of samples.

use mvtop_core::Estimator;
use mvtop_core::annotations::TruePose;
use mvtop_core::pose::{rotation_error_deg, translation_error};
use mvtop_core::prediction::ObjectPose;
use mvtop_eval::metrics::Surface;
use nalgebra::Point3;

use super::args::SamplesArgs;
use super::outcome::{Errors, Outcome};
use super::sample::{Sample, folders};
use super::summary::Summary;
use crate::failure::{Failure, Result};
use crate::matching::{diameter, matches, unmatched};
use crate::{progress, write};

pub fn run(args: &SamplesArgs) -> Result<()> {
    let trial = &args.trial;
    let folders = folders(&args.folder)?;
    if let Some(out) = &args.out {
        write::may_write(out, args.force)?;
        // It may be what a sample is read of: its rig, its truth, an image.
        let name = out.file_name().unwrap_or_default();
        let read = folders.iter().map(|folder| folder.join(name));
        write::spare(out, read, "name another file")?;
    }
    let (_, estimator) = trial.load()?;
    let bar = progress::bar(folders.len() as u64, "{pos}/{len} samples");
    let mut views = None;
    let mut outcomes = Vec::new();
    let mut extra = Vec::new();
    let mut left_out = 0;
    for folder in &folders {
        let sample = Sample::load(folder, trial.views)?;
        let count = sample.images.len();
        if *views.get_or_insert(count) != count {
            return Err(Failure(format!(
                "sample {}: expected as many views as the samples before, got {count}; give \
                 --views to use as many of each",
                folder.display()
            )));
        }
        if trial.true_boxes {
            left_out += sample.boxes_left_out(&trial.noise);
        }
        let prediction = sample.predict(&estimator, trial)?;
        bar.suspend(|| write::warn(&prediction, Some(&sample.name)));
        let matched = matches(
            &sample.truth,
            &prediction,
            diameter(&estimator.bundle().classes),
        );
        let unmatched = unmatched(&matched, &prediction);
        extra.extend(unmatched.iter().map(|found| found.confidence));
        for (object, (known, &found)) in sample.truth.iter().zip(&matched).enumerate() {
            let errors = found.map(|found| errors(known, found, &estimator));
            outcomes.push(Outcome::new(&sample, object, &prediction, found, errors));
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if left_out > 0 {
        write::complain(&format!(
            "warning: --true-boxes: {left_out} of the boxes lie beside their image or its lens' field of \
             view, or are thinner than a pixel there: these cameras count as not seeing the object"
        ));
    }

    if let Some(out) = &args.out {
        let lines: Result<Vec<String>> = outcomes.iter().map(write::json).collect();
        write::whole(out, (lines?.join("\n") + "\n").as_bytes())?;
    }
    let views = views.unwrap_or(0);
    let summary = Summary::new(views, folders.len(), &extra, &outcomes, trial.bounds());
    if args.json {
        return write::print(&write::json(&summary)?);
    }
    write::print(&summary.text("samples", outcomes.len()))
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
