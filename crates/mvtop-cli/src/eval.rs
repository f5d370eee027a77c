//! `eval`: errors of the poses over many samples whose truth is known.

mod noise;
mod outcome;
mod sample;
mod summary;

use std::collections::HashSet;
use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use mvtop_core::{Estimator, Prediction};

use self::noise::Noise;
use self::outcome::{Outcome, outcomes};
use self::sample::{Sample, folders};
use self::summary::Summary;
use crate::args::Eval;
use crate::failure::{Failure, Result, may_write, print};
use crate::{model_dir, table};

pub fn run(args: &Eval) -> Result<()> {
    let folders = folders(&args.samples)?;
    if let Some(out) = &args.out {
        may_write(out, args.force)?;
    }
    let estimator = Estimator::load(
        &model_dir::find(args.network.model.as_deref())?,
        &args.network.options(),
    )?;
    let noise = Noise {
        seed: args.noise_seed,
        rig_deg: args.rig_noise_deg,
        rig_mm: args.rig_noise_mm,
        boxes: args.box_noise,
    };

    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} samples, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(folders.len() as u64).with_style(style);
    let mut views = None;
    let mut all = Vec::new();
    let mut extra = 0;
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
        let prediction = sample.predict(&estimator, args.true_boxes, &noise)?;
        extra += unmatched(&sample, &prediction);
        let Sample {
            name, rig, truth, ..
        } = &sample;
        all.extend(outcomes(name, rig, truth, count, &prediction, &estimator));
        bar.inc(1);
    }
    bar.finish_and_clear();

    if let Some(out) = &args.out {
        write_lines(out, &all)?;
    }
    let views = views.unwrap_or(0);
    let summary = Summary::new(views, folders.len(), extra, &all, args.resolved_deg);
    print(&serde_json::to_string(&summary).map_err(json_error)?)
}

/// Predicted objects that are no true object's nearest.
fn unmatched(sample: &Sample, prediction: &Prediction) -> usize {
    let matched: HashSet<*const _> = sample
        .truth
        .iter()
        .filter_map(|known| Some(std::ptr::from_ref(table::nearest(known, prediction)?)))
        .collect();
    prediction.objects.len() - matched.len()
}

/// JSON Lines. The file appears when it is whole: who finds it need not ask whether it is.
fn write_lines(path: &Path, outcomes: &[Outcome]) -> Result<()> {
    let lines: Vec<String> = outcomes
        .iter()
        .map(|outcome| Ok(serde_json::to_string(outcome).map_err(json_error)? + "\n"))
        .collect::<Result<_>>()?;
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    std::fs::write(&partial, lines.concat())
        .and_then(|()| std::fs::rename(&partial, path))
        .map_err(|cause| Failure(format!("cannot write {}: {cause}", path.display())))
}

fn json_error(cause: serde_json::Error) -> Failure {
    Failure(format!("cannot write JSON: {cause}"))
}
