//! `eval bop`: a split of a data set in BOP's layout.

mod journal;
mod page;
mod plan;
mod provenance;
mod results;
mod score;

use std::collections::HashSet;
use std::time::Instant;

use indicatif::ProgressBar;
use mvtop_core::Estimator;
use mvtop_core::annotations::TruePose;
use mvtop_core::prediction::ObjectPose;
use mvtop_eval::bop::{Estimate, FrameId, Group, RESULTS_HEADER, load_depth};

use self::journal::{Journal, Line};
use self::plan::{Plan, name};
use self::provenance::{about, folder_name};
use self::results::Results;
use self::score::Scored;
use super::args::BopArgs;
use super::outcome::Outcome;
use crate::failure::{Failure, Result};
use crate::matching::{diameter, matches, unmatched};
use crate::{progress, write};

pub fn run(args: &BopArgs) -> Result<()> {
    let (folder, page) = match (&args.out, &args.report) {
        (Some(folder), _) => (folder, false),
        (None, Some(folder)) => (folder, true),
        (None, None) => return Err(Failure("give --out DIR or --report DIR".into())),
    };
    let bundle = args.trial.network.bundle()?;
    let estimator = args.trial.network.load(&bundle)?;
    let plan = Plan::new(args, &estimator)?;
    let about = about(args, &bundle, &plan)?;
    let split = &args.split;
    let poses = format!("mvtop_{}-{}.csv", folder_name(&split.dataset), split.split);
    let files = [poses.as_str(), "summary.json", "report.html"];
    let (mut journal, mut lines) = Journal::open(folder, &about, &files, args.force)?;

    let done: HashSet<String> = lines.iter().map(|line| line.group.clone()).collect();
    let bar = progress::bar(plan.groups.len() as u64, "{pos}/{len} groups");
    bar.inc(done.len() as u64);
    bar.reset_eta();
    for group in &plan.groups {
        if done.contains(&name(group)) {
            continue;
        }
        let line = evaluate(&plan, group, args, &estimator, &bar)?;
        journal.append(&line)?;
        lines.push(line);
        bar.inc(1);
    }
    bar.finish_and_clear();

    let results = Results::new(&lines, args.trial.bounds());
    let summary = write::json(&results)?;
    write::whole(&folder.join(&poses), csv(&lines).as_bytes())?;
    write::whole(
        &folder.join("summary.json"),
        format!("{summary}\n").as_bytes(),
    )?;
    if page {
        let html = page::page(&about, &results, &lines, &plan)?;
        write::whole(&folder.join("report.html"), html.as_bytes())?;
    }
    if args.json {
        return write::print(&summary);
    }
    let files = [
        poses.as_str(),
        "summary.json",
        "groups.jsonl",
        "report.html",
    ];
    let written = &files[..if page { 4 } else { 3 }];
    let (table, folder) = (results.text(&plan.classes), folder.display());
    write::print(&format!("{table}\n\nin {folder}: {}", written.join(", ")))
}

/// What a group gives.
fn evaluate(
    plan: &Plan,
    group: &Group,
    args: &BopArgs,
    estimator: &Estimator,
    bar: &ProgressBar,
) -> Result<Line> {
    let sample = plan.load(group)?;
    let start = Instant::now();
    let mut prediction = sample.predict(estimator, &args.trial)?;
    let time_s = start.elapsed().as_secs_f64();
    bar.suspend(|| write::warn(&prediction, Some(&sample.name)));
    // Objects that are not asked for are neither right nor wrong.
    let wanted = |class: &str| plan.object(class).is_some_and(|id| plan.wanted(group, id));
    prediction.objects.retain(|found| wanted(&found.class));
    let matched = matches(
        &sample.truth,
        &prediction,
        diameter(&estimator.bundle().classes),
    );
    let depth = load_depth(&plan.scenes[&group.scene].frames[&group.views[0]])?;
    let view = score::View {
        camera: &sample.rig.cameras()[sample.rig.reference()],
        depth: depth.as_ref(),
        vsd_delta: args.vsd_delta_mm * 1e-3,
    };
    let scored = |(object, (known, &found)): (usize, (&TruePose, &Option<&ObjectPose>))| {
        let model = &plan.models[&plan.object(&known.seen.class)?];
        let truth = &known.world_from_obj;
        let errors = found.map(|found| score::errors(truth, &found.world_from_obj, model));
        let outcome = Outcome::new(&sample, object, &prediction, found, errors);
        let scored = Scored::new(outcome, known, found, model, &view);
        Some(scored.map_err(|problem| Failure(format!("{}: {problem}", sample.name))))
    };
    let estimate = |found: &ObjectPose| {
        let obj_id = plan.object(&found.class)?;
        Some(Estimate::new(obj_id, found.score, &found.ref_from_obj))
    };
    let known = sample.truth.iter().zip(&matched);
    let FrameId { sensor, image } = group.views[0].clone();
    Ok(Line {
        group: sample.name.clone(),
        scene: group.scene,
        sensor,
        image,
        time_s,
        extra: unmatched(&matched, &prediction),
        estimates: prediction.objects.iter().filter_map(estimate).collect(),
        objects: known
            .enumerate()
            .filter_map(scored)
            .collect::<Result<_>>()?,
    })
}

/// Results in BOP's format, for the reference images.
fn csv(lines: &[Line]) -> String {
    let of_line = |line: &Line| -> String {
        let estimates = line.estimates.iter();
        estimates
            .map(|e| e.csv_line(line.scene, line.image, line.time_s))
            .collect()
    };
    RESULTS_HEADER.to_owned() + &lines.iter().map(of_line).collect::<String>()
}
