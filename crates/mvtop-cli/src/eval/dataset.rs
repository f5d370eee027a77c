//! `eval --dataset`: a split of a data set in BOP's layout.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::time::Instant;

use mvtop_core::Estimator;
use mvtop_eval::bop::{Estimate, FrameId, Group, RESULTS_HEADER, load_depth};
use serde::Serialize;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::journal::{Journal, Line, write_whole};
use super::outcome::{Outcome, outcomes};
use super::plan::{Plan, name};
use super::score::{self, Scored, Scores};
use super::summary::Summary;
use super::{html, json_error, noise, progress};
use crate::args::Eval;
use crate::failure::{Failure, Result, print};
use crate::matching::{matches, unmatched};
use crate::model_dir;

/// `summary.json`: what `eval --samples` says, and BOP's metrics.
#[derive(Serialize)]
pub struct Results {
    #[serde(flatten)]
    pub summary: Summary,
    pub all: Scores,
    /// By obj_id.
    pub objects: BTreeMap<u32, Scores>,
}

pub fn run(args: &Eval, root: &Path, report: &Path) -> Result<()> {
    let bundle = model_dir::find(args.network.model.as_deref())?;
    let estimator = Estimator::load(&bundle, &args.network.options())?;
    let plan = Plan::new(args, root, &estimator)?;
    let about = about(args, root, &bundle)?;
    let (mut journal, mut lines) = Journal::open(report, &about, args.force)?;

    let done: HashSet<String> = lines.iter().map(|line| line.group.clone()).collect();
    let bar = progress(plan.groups.len(), "groups");
    bar.inc(done.len() as u64);
    bar.reset_eta();
    for group in &plan.groups {
        if done.contains(&name(group)) {
            continue;
        }
        let line = evaluate(&plan, group, args, &estimator)?;
        journal.append(&line)?;
        lines.push(line);
        bar.inc(1);
    }
    bar.finish_and_clear();

    let results = Results::new(&lines, args.resolved_deg);
    let dataset = folder_name(root);
    let results_csv = format!("mvtop_{dataset}-{}.csv", args.split.split);
    write_whole(&report.join(results_csv), &csv(&lines))?;
    let summary = serde_json::to_string(&results).map_err(json_error)?;
    write_whole(&report.join("summary.json"), &format!("{summary}\n"))?;
    let page = html::page(&about, &results, &lines, &plan)?;
    write_whole(&report.join("report.html"), &page)?;
    print(&summary)
}

/// What results depend on. Where files lie is no part of it, but for the names of the data set.
fn about(args: &Eval, root: &Path, bundle: &Path) -> Result<Value> {
    let hash = |path: &Path| {
        let bytes = std::fs::read(path)
            .map_err(|cause| Failure(format!("cannot read {}: {cause}", path.display())))?;
        Ok::<_, Failure>(format!("{:x}", Sha256::digest(bytes)))
    };
    let split = &args.split;
    Ok(json!({
        "dataset": folder_name(root),
        "split": split.split,
        "grouping": split.grouping.to_string(),
        "sensor": split.sensor,
        "views": args.views,
        "objects": split.objects,
        "targets_sha256": split.targets.as_deref().map(hash).transpose()?,
        // It holds the hashes of all other files of the bundle.
        "model_sha256": hash(&bundle.join("model.json"))?,
        "true_boxes": args.true_boxes,
        "min_views": args.detection.min_views,
        "box_noise": args.box_noise,
        "rig_noise_deg": args.rig_noise_deg,
        "rig_noise_mm": args.rig_noise_mm,
        "noise_seed": args.noise_seed,
        "vsd_delta_mm": split.vsd_delta_mm,
    }))
}

fn folder_name(path: &Path) -> String {
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// What a group gives.
fn evaluate(plan: &Plan, group: &Group, args: &Eval, estimator: &Estimator) -> Result<Line> {
    let sample = plan.load(group)?;
    let start = Instant::now();
    let mut prediction = sample.predict(estimator, args, &noise(args))?;
    let time_s = start.elapsed().as_secs_f64();
    // Objects that are not asked for are neither right nor wrong.
    prediction.objects.retain(|found| {
        plan.object(&found.class)
            .is_some_and(|id| plan.wanted(group, id))
    });
    let matched = matches(&sample.truth, &prediction);
    let outcomes = outcomes(&sample, group.views.len(), &prediction, &matched, estimator);
    let depth = load_depth(&plan.scenes[&group.scene].frames[&group.views[0]])?;
    let view = score::View {
        camera: &sample.rig.cameras()[sample.rig.reference()],
        depth: depth.as_ref(),
        vsd_delta: args.split.vsd_delta_mm * 1e-3,
    };
    let scored = |(i, outcome): (usize, Outcome)| {
        let known = &sample.truth[i];
        let model = &plan.models[&plan.object(&known.seen.class)?];
        let scored = Scored::new(outcome, known, matched[i], model, &view);
        Some(scored.map_err(|problem| Failure(format!("{}: {problem}", sample.name))))
    };
    let FrameId { sensor, image } = group.views[0].clone();
    Ok(Line {
        group: sample.name.clone(),
        scene: group.scene,
        sensor,
        image,
        time_s,
        extra: unmatched(&matched, &prediction),
        estimates: prediction
            .objects
            .iter()
            .filter_map(|found| {
                let obj_id = plan.object(&found.class)?;
                Some(Estimate::new(obj_id, found.score, &found.ref_from_obj))
            })
            .collect(),
        objects: outcomes
            .into_iter()
            .enumerate()
            .filter_map(scored)
            .collect::<Result<_>>()?,
    })
}

/// Results in BOP's format, for the reference images.
fn csv(lines: &[Line]) -> String {
    let mut text = String::from(RESULTS_HEADER);
    for line in lines {
        for estimate in &line.estimates {
            text += &estimate.csv_line(line.scene, line.image, line.time_s);
        }
    }
    text
}

impl Results {
    fn new(lines: &[Line], resolved_deg: f64) -> Self {
        let scored: Vec<&Scored> = lines.iter().flat_map(|line| &line.objects).collect();
        let outcomes: Vec<Outcome> = scored.iter().map(|s| s.outcome.clone()).collect();
        let views = outcomes
            .iter()
            .map(|outcome| outcome.views)
            .max()
            .unwrap_or(0);
        let extra = lines.iter().map(|line| line.extra).sum();
        let mut by_object: BTreeMap<u32, Vec<&Scored>> = BTreeMap::new();
        for &scored in &scored {
            by_object.entry(scored.obj_id).or_default().push(scored);
        }
        Self {
            summary: Summary::new(views, lines.len(), extra, &outcomes, resolved_deg),
            all: Scores::new(&scored),
            objects: by_object
                .into_iter()
                .map(|(id, scored)| (id, Scores::new(&scored)))
                .collect(),
        }
    }
}
