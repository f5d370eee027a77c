//! `eval bop`: a split of a data set in BOP's layout.

mod compared;
mod journal;
mod loading;
mod page;
mod plan;
mod predictions;
mod provenance;
mod results;
mod score;
mod tally;
mod view;

use std::collections::{BTreeSet, HashSet};
use std::path::{Component, Path, PathBuf};
use std::time::Instant;

use indicatif::ProgressBar;
use mvtop_core::annotations::TruePose;
use mvtop_core::error::printable;
use mvtop_core::prediction::ObjectPose;
use mvtop_core::{Estimator, Prediction};
use mvtop_eval::bop::{Estimate, FrameId, Group, RESULTS_HEADER, load_depth};
use nalgebra::Isometry3;
use serde_json::{Map, Value};

use self::journal::{Journal, Line};
use self::plan::{Plan, name};
use self::predictions::Predictions;
use self::provenance::{about, folder_name};
use self::results::{Results, side_by_side};
use self::score::Scored;
use self::tally::Tally;
use self::view::View;
use super::args::{BopArgs, SplitArgs};
use super::outcome::Outcome;
use super::sample::Sample;
use crate::failure::{Failure, Result};
use crate::matching::{matches, unmatched};
use crate::{progress, write};

/// Where poses come from.
enum Source<'a> {
    Network(&'a Estimator),
    File(&'a Predictions),
}

/// What an evaluation answers.
pub struct Answer {
    /// One line of JSON.
    pub json: String,
    /// For people.
    pub text: String,
}

pub fn run(args: &BopArgs) -> Result<()> {
    let answer = evaluate(args)?;
    write::print(if args.json {
        &answer.json
    } else {
        &answer.text
    })
}

/// Everything but printing what came of it.
pub fn evaluate(args: &BopArgs) -> Result<Answer> {
    match args.predictions.is_empty() {
        true => of_network(args),
        false => of_files(args),
    }
}

fn of_network(args: &BopArgs) -> Result<Answer> {
    let Some(folder) = args.out.as_ref().or(args.report.as_ref()) else {
        return Err(Failure("give --out DIR or --report DIR for what comes of it, or --predictions FILE.csv to score".into()));
    };
    let (bundle, estimator) = args.trial.load()?;
    let plan = Plan::new(args, Some(&estimator.bundle().classes))?;
    warn(&plan.warnings);
    let model = [("model_sha256", bundle.join("model.json"))];
    let about = about(args, &model, &plan)?;
    let source = Source::Network(&estimator);
    let done = evaluate_all(args, &plan, &source, &about, Some(folder))?;
    let (table, folder) = (done.results.text(&plan.classes), folder.display());
    Ok(Answer {
        json: write::json(&done.results)?,
        text: format!("{table}\n\nin {folder}: {}", done.written.join(", ")),
    })
}

/// Scores of files in BOP's format. Of one file, what is written lies in the folder asked for; of
/// several, in folders within it that are named as the files are.
fn of_files(args: &BopArgs) -> Result<Answer> {
    let plan = Plan::new(args, None)?;
    warn(&plan.warnings);
    let folder = args.out.as_ref().or(args.report.as_ref());
    let several = args.predictions.len() > 1;
    let stem = |path: &Path| {
        path.file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let stems: BTreeSet<String> = args.predictions.iter().map(|path| stem(path)).collect();
    if let Some(path) = several
        .then(|| {
            args.predictions
                .iter()
                .find(|path| stem(path).starts_with('.'))
        })
        .flatten()
    {
        return Err(Failure(format!(
            "--predictions: expected files with a name before their ending, which their results' folders have, \
             got `{}`; rename it",
            path.display()
        )));
    }
    if stems.len() < args.predictions.len() {
        return Err(Failure(
            "--predictions: expected files of different names, got one twice; rename one".into(),
        ));
    }
    // A folder that was named may be a link, but not one of those inside it.
    let inside = folder.filter(|_| several).into_iter();
    let inside = inside.flat_map(|folder| stems.iter().map(|stem| folder.join(stem)));
    if let Some(link) = inside.into_iter().find(|path| path.is_symlink()) {
        return Err(Failure(format!(
            "{} is a link, expected a folder or nothing there; remove it or name another folder",
            link.display()
        )));
    }
    let compared = args.report.as_ref().filter(|_| several);
    let compared = compared.map(|folder| folder.join("compared.html"));
    if let Some(file) = &compared {
        write::may_write(file, args.force)?;
    }
    let (mut rows, mut json, mut texts) = (Vec::new(), Map::new(), Vec::new());
    for path in &args.predictions {
        let predictions = Predictions::load(path, args, &plan)?;
        warn(&predictions.warnings);
        let about = about(args, &[("predictions_sha256", path.clone())], &plan)?;
        let folder = folder.map(|folder| match several {
            true => folder.join(stem(path)),
            false => folder.clone(),
        });
        let source = Source::File(&predictions);
        let done = evaluate_all(args, &plan, &source, &about, folder.as_deref())?;
        let results = serde_json::to_value(&done.results)
            .map_err(|cause| Failure(format!("cannot write JSON: {cause}")))?;
        json.insert(stem(path), results);
        texts.push(done.results.text(&plan.classes));
        if let Some(folder) = folder {
            texts.push(format!(
                "in {}: {}",
                folder.display(),
                done.written.join(", ")
            ));
        }
        rows.push((stem(path), done));
    }
    if let (false, Some((_, done))) = (several, rows.first()) {
        return Ok(Answer {
            json: write::json(&done.results)?,
            text: texts.join("\n\n"),
        });
    }
    let mut text = side_by_side(rows.iter().map(|(name, done)| (name, &done.results)));
    if let Some(file) = &compared {
        let about = about(args, &[], &plan)?;
        let name = |id| format!("{id} {}", plan.classes.get(&id).map_or("", |name| name));
        let scored = rows.iter().map(|(name, done)| compared::Scored {
            name,
            results: &done.results,
            lines: &done.lines,
        });
        let scored: Vec<compared::Scored> = scored.collect();
        write::whole(file, compared::page(&about, &scored, name)?.as_bytes())?;
        text += &format!("\n\n{}: written", file.display());
    }
    Ok(Answer {
        json: write::json(&Value::Object(json))?,
        text,
    })
}

fn warn(sentences: &[String]) {
    for sentence in sentences {
        write::complain(&format!("warning: {}", printable(sentence)));
    }
}

/// What came of all groups, and the files that hold it.
struct Done {
    results: Results,
    lines: Vec<Line>,
    written: Vec<String>,
}

/// File name of the poses, as BOP has it.
fn poses_name(split: &SplitArgs) -> String {
    let parts = Path::new(&split.split).components();
    let names = parts.filter_map(|part| match part {
        Component::Normal(name) => Some(name.to_string_lossy()),
        _ => None,
    });
    let split_name = names.collect::<Vec<_>>().join("-");
    format!("mvtop_{}-{split_name}.csv", folder_name(&split.dataset))
}

/// - `folder`: where results are written to, if anywhere
fn evaluate_all(
    args: &BopArgs,
    plan: &Plan,
    source: &Source,
    about: &Value,
    folder: Option<&Path>,
) -> Result<Done> {
    let poses = poses_name(&args.split);
    let files = [poses.as_str(), "summary.json", "report.html"];
    // Poses that are read from there stay there.
    let is_read = |folder: &Path| {
        let mut read = args.predictions.iter();
        read.any(|read| write::same_file(read, &folder.join(&poses)))
    };
    let files = match folder.is_some_and(is_read) {
        true => &files[1..],
        false => &files[..],
    };
    let read = args.predictions.iter().chain(&args.split.targets);
    let read: Vec<&Path> = read.map(PathBuf::as_path).collect();
    let journal = folder.map(|folder| Journal::open(folder, about, files, &read, args.force));
    let (mut journal, mut lines) = match journal.transpose()? {
        Some((journal, lines)) => (Some(journal), lines),
        None => (None, Vec::new()),
    };
    let done: HashSet<String> = lines.iter().map(|line| line.group.clone()).collect();
    let bar = progress::bar(plan.groups.len() as u64, "{pos}/{len} groups");
    bar.inc(done.len() as u64);
    bar.reset_eta();
    for group in &plan.groups {
        if done.contains(&name(group)) {
            continue;
        }
        let line = evaluate_group(plan, group, args, source, &bar)?;
        if let Some(journal) = &mut journal {
            journal.append(&line)?;
        }
        lines.push(line);
        bar.inc(1);
    }
    bar.finish_and_clear();

    let results = Results::new(&lines, args.trial.bounds(), source.expects());
    let Some(folder) = folder else {
        let written = Vec::new();
        return Ok(Done {
            results,
            lines,
            written,
        });
    };
    let mut written = vec!["summary.json".to_owned(), "groups.jsonl".to_owned()];
    if let Source::Network(_) = source {
        write::whole(&folder.join(&poses), csv(&lines).as_bytes())?;
        written.insert(0, poses);
    }
    let summary = write::json(&results)? + "\n";
    write::whole(&folder.join("summary.json"), summary.as_bytes())?;
    if args.report.is_some() {
        let html = page::page(about, &results, &lines, plan)?;
        write::whole(&folder.join("report.html"), html.as_bytes())?;
        written.push("report.html".into());
    }
    Ok(Done {
        results,
        lines,
        written,
    })
}

impl Source<'_> {
    /// Whether it says how far it expects to be off.
    fn expects(&self) -> bool {
        matches!(self, Self::Network(_))
    }

    /// What it says of a group, with the group's sample and the seconds it took.
    fn predict(
        &self,
        plan: &Plan,
        group: &Group,
        args: &BopArgs,
        bar: &ProgressBar,
    ) -> Result<(Sample, Prediction, Option<f64>)> {
        match self {
            Self::Network(estimator) => {
                let sample = plan.load(group)?;
                let start = Instant::now();
                let prediction = sample.predict(estimator, &args.trial)?;
                let time_s = start.elapsed().as_secs_f64();
                bar.suspend(|| write::warn(&prediction, Some(&sample.name)));
                Ok((sample, prediction, Some(time_s)))
            }
            Self::File(predictions) => {
                let sample = plan.known(group)?;
                let (prediction, time_s) = predictions.of(plan, group, &sample)?;
                Ok((sample, prediction, time_s))
            }
        }
    }
}

/// What a group gives.
fn evaluate_group(
    plan: &Plan,
    group: &Group,
    args: &BopArgs,
    source: &Source,
    bar: &ProgressBar,
) -> Result<Line> {
    let (sample, mut prediction, time_s) = source.predict(plan, group, args, bar)?;
    // Objects that are not asked for are neither right nor wrong.
    let wanted = |class: &str| plan.object(class).is_some_and(|id| plan.wanted(group, id));
    prediction.objects.retain(|found| wanted(&found.class));
    let estimate = |found: &ObjectPose| {
        let obj_id = plan.object(&found.class)?;
        Some(Estimate::new(obj_id, found.score, &found.ref_from_obj))
    };
    let estimates = prediction.objects.iter().filter_map(estimate).collect();
    // Nor are poses beyond the number of instances that a target asks for.
    let object = |found: &ObjectPose| plan.object(&found.class).unwrap_or_default();
    prediction.objects = plan.first(group, prediction.objects, object, |found| found.score);
    let reach = |class: &str| {
        let model = plan.object(class).and_then(|id| plan.models.get(&id));
        model.map_or(0.0, |model| model.diameter_m)
    };
    // What lies beside the reference image and another view shows is neither right nor wrong.
    let mut all = sample.truth.clone();
    all.extend(plan.beside(group, &sample));
    let matched = matches(&all, &prediction, reach);
    let depth = load_depth(&plan.scenes[&group.scene].frames[&group.views[0]])?;
    let view = View {
        camera: &sample.rig.cameras()[sample.rig.reference()],
        depth: depth.as_ref(),
        vsd_delta: args.vsd_delta_mm * 1e-3,
    };
    let of_sample = |problem| Failure(format!("{}: {problem}", sample.name));
    let scored = |(object, (known, &found)): (usize, (&TruePose, &Option<&ObjectPose>))| {
        let model = &plan.models[&plan.object(&known.seen.class)?];
        let truth = &known.world_from_obj;
        let errors = found.map(|found| score::errors(truth, &found.world_from_obj, model));
        let mut outcome = Outcome::new(&sample, object, &prediction, found, errors);
        outcome.views = group.views.len();
        outcome.sigma = outcome.sigma.filter(|_| source.expects());
        let scored = Scored::new(outcome, known, found, model, &view);
        Some(scored.map_err(of_sample))
    };
    let known = sample.truth.iter().zip(&matched);
    let extra = unmatched(&matched, &prediction);
    let FrameId { sensor, image } = group.views[0].clone();
    Ok(Line {
        group: sample.name.clone(),
        scene: group.scene,
        sensor,
        image,
        time_s,
        extra: extra.len(),
        extra_confidences: extra.iter().map(|found| found.confidence).collect(),
        estimates,
        tallies: tallies(plan, &sample, &prediction, &view).map_err(of_sample)?,
        objects: known
            .enumerate()
            .filter_map(scored)
            .collect::<Result<_>>()?,
    })
}

/// Of each object that is a target or was found.
fn tallies(
    plan: &Plan,
    sample: &Sample,
    prediction: &Prediction,
    view: &View,
) -> Result<Vec<Tally>> {
    let mut surest: Vec<&ObjectPose> = prediction.objects.iter().collect();
    surest.sort_by(|a, b| b.score.total_cmp(&a.score));
    let tally = |(id, class): (&u32, &String)| {
        let truth = sample
            .truth
            .iter()
            .filter(|known| known.seen.class == *class);
        let truth: Vec<Isometry3<f64>> = truth.map(|known| known.world_from_obj).collect();
        let found = surest.iter().filter(|found| found.class == *class);
        let found: Vec<Isometry3<f64>> = found.map(|found| found.world_from_obj).collect();
        let any = !(truth.is_empty() && found.is_empty());
        any.then(|| Tally::new(&truth, &found, &plan.models[id], view))
    };
    plan.classes.iter().filter_map(tally).collect()
}

/// Results in BOP's format, for the reference images.
fn csv(lines: &[Line]) -> String {
    let of_line = |line: &Line| -> String {
        let time_s = line.time_s.unwrap_or(-1.0);
        let estimates = line.estimates.iter();
        estimates
            .map(|e| e.csv_line(line.scene, line.image, time_s))
            .collect()
    };
    RESULTS_HEADER.to_owned() + &lines.iter().map(of_line).collect::<String>()
}
