//! `eval`: errors of the poses over many samples whose truth is known.

mod dataset;
mod html;
mod journal;
mod noise;
mod outcome;
mod plan;
mod plot;
mod sample;
mod score;
mod summary;

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use mvtop_core::Estimator;

use self::noise::Noise;
use self::outcome::{Outcome, outcomes};
use self::sample::{Sample, folders};
use self::summary::Summary;
use crate::args::Eval;
use crate::failure::{Failure, Result, may_write, print};
use crate::matching::{matches, unmatched};
use crate::model_dir;

pub fn run(args: &Eval) -> Result<()> {
    match (&args.samples, &args.split.dataset, &args.split.report) {
        (Some(samples), ..) => of_samples(args, samples),
        (None, Some(root), Some(report)) => dataset::run(args, root, report),
        _ => Err(Failure(
            "expected --samples DIR, or --dataset DIR and --report DIR".into(),
        )),
    }
}

fn of_samples(args: &Eval, samples: &Path) -> Result<()> {
    let folders = folders(samples)?;
    if let Some(out) = &args.out {
        may_write(out, args.force)?;
    }
    let estimator = Estimator::load(
        &model_dir::find(args.network.model.as_deref())?,
        &args.network.options(),
    )?;
    let noise = noise(args);
    let bar = progress(folders.len(), "samples");
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
        let prediction = sample.predict(&estimator, args, &noise)?;
        let matched = matches(&sample.truth, &prediction);
        extra += unmatched(&matched, &prediction);
        all.extend(outcomes(&sample, count, &prediction, &matched, &estimator));
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

fn noise(args: &Eval) -> Noise {
    Noise {
        seed: args.noise_seed,
        rig_deg: args.rig_noise_deg,
        rig_mm: args.rig_noise_mm,
        boxes: args.box_noise,
    }
}

fn progress(length: usize, of: &str) -> ProgressBar {
    let style =
        ProgressStyle::with_template(&format!("{{bar:40}} {{pos}}/{{len}} {of}, {{eta}} left"))
            .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length as u64).with_style(style)
}

/// JSON Lines. The file appears when it is whole: who finds it need not ask whether it is.
fn write_lines(path: &Path, outcomes: &[Outcome]) -> Result<()> {
    let lines: Vec<String> = outcomes
        .iter()
        .map(|outcome| Ok(serde_json::to_string(outcome).map_err(json_error)? + "\n"))
        .collect::<Result<_>>()?;
    journal::write_whole(path, &lines.concat())
}

fn json_error(cause: serde_json::Error) -> Failure {
    Failure(format!("cannot write JSON: {cause}"))
}
