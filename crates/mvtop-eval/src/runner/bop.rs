//! Evaluates a split of a data set in BOP's layout: of a network, or of results in BOP's format.
//! `docs/how-to/evaluate-on-bop.md` says what is written.

mod detection;
mod in_sight;
mod journal;
mod loading;
mod options;
mod plan;
mod predictions;
mod provenance;
mod results;
mod score;
mod tally;
mod view;

use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};
use std::time::Instant;

use mvtop_core::annotations::TruePose;
use mvtop_core::bundle::Class;
use mvtop_core::prediction::ObjectPose;
use mvtop_core::{Estimator, Prediction};
use nalgebra::Isometry3;
use serde_json::Value;

pub use self::detection::Detections;
pub use self::in_sight::InSight;
use self::journal::Journal;
pub use self::journal::Line;
pub use self::options::{Options, Split};
pub use self::plan::Plan;
use self::plan::name;
use self::predictions::Predictions;
use self::provenance::folder_name;
pub use self::results::{COLUMNS, Column, Results, side_by_side};
pub use self::score::{Areas, Scored, Scores};
pub use self::tally::Tally;
use self::view::View;
use super::{Observer, Outcome, Sample, observer};
use crate::bop::{Estimate, FrameId, Group, Instance, Model, RESULTS_HEADER, Rules, load_depth};
use crate::matching::{matches, unmatched};
use crate::{Error, Result, files};

/// Name of the page that the caller may write beside the results.
pub const REPORT: &str = "report.html";

/// A split that is read and checked, ready to be evaluated.
pub struct Evaluation<'a> {
    options: &'a Options,
    plan: Plan,
}

/// What came of all groups.
///
/// The folder of the results stays locked until it is dropped.
#[non_exhaustive]
pub struct Evaluated {
    /// What results depend on, as run.json says.
    pub about: Value,
    /// The scores.
    pub results: Results,
    /// Of each group.
    pub lines: Vec<Line>,
    /// Names of the files that hold the results.
    pub written: Vec<String>,
    _journal: Option<Journal>,
}

impl<'a> Evaluation<'a> {
    /// Reads the split.
    ///
    /// - `known`: the network's classes; without, results in BOP's format are evaluated
    ///
    /// # Errors
    /// As [`Plan::new`], and [`Error::Input`] as [`Options::check`].
    pub fn new(options: &'a Options, known: Option<&[Class]>) -> Result<Self> {
        options.check()?;
        let plan = Plan::new(options, known)?;
        Ok(Self { options, plan })
    }

    /// What is evaluated.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What results depend on, without what poses come from.
    ///
    /// # Errors
    /// [`Error::Geometry`] where a file cannot be read.
    pub fn about(&self) -> Result<Value> {
        provenance::about(self.options, &[], &self.plan)
    }

    /// Scores of a network's poses, which are predicted here.
    ///
    /// - `folder`: where results are written to; what is there is gone on with
    ///
    /// # Errors
    /// Where a group cannot be read or predicted, or results cannot be written.
    pub fn predict(
        &self,
        estimator: &Estimator,
        folder: &Path,
        observer: &mut dyn Observer,
    ) -> Result<Evaluated> {
        let model = estimator.bundle().dir.join("model.json");
        let about = provenance::about(self.options, &[("model_sha256", model)], &self.plan)?;
        self.evaluate(&Source::Network(estimator), about, Some(folder), observer)
    }

    /// Scores of the poses in a file in BOP's format.
    ///
    /// - `folder`: where results are written to, if anywhere; what is there is gone on with
    ///
    /// # Errors
    /// Where a file cannot be read, has no pose that is asked for, or results cannot be written.
    pub fn score(
        &self,
        path: &Path,
        folder: Option<&Path>,
        observer: &mut dyn Observer,
    ) -> Result<Evaluated> {
        let predictions = Predictions::load(path, self.options, &self.plan)?;
        for sentence in &predictions.warnings {
            observer.warn(sentence);
        }
        let sources = [("predictions_sha256", path.to_owned())];
        let about = provenance::about(self.options, &sources, &self.plan)?;
        self.evaluate(&Source::File(&predictions), about, folder, observer)
    }

    /// - `folder`: where results are written to, if anywhere
    fn evaluate(
        &self,
        source: &Source,
        about: Value,
        folder: Option<&Path>,
        observer: &mut dyn Observer,
    ) -> Result<Evaluated> {
        let (options, plan) = (self.options, &self.plan);
        let poses = poses_name(&options.split);
        let files = [poses.as_str(), "summary.json", REPORT];
        // Poses that are read from there stay there.
        let is_read = |folder: &Path| {
            let mut read = options.predictions.iter();
            read.any(|read| files::same_file(read, &folder.join(&poses)))
        };
        let files = match folder.is_some_and(is_read) {
            true => &files[1..],
            false => &files[..],
        };
        let read = options.predictions.iter().chain(&options.split.targets);
        let read: Vec<&Path> = read.map(PathBuf::as_path).collect();
        let journal = folder.map(|dir| Journal::open(dir, &about, files, &read, options.force));
        let (mut journal, mut lines) = match journal.transpose()? {
            Some((journal, lines)) => (Some(journal), lines),
            None => (None, Vec::new()),
        };
        let done: HashSet<String> = lines.iter().map(|line| line.group.clone()).collect();
        observer.begin(plan.groups.len(), done.len());
        for group in &plan.groups {
            if done.contains(&name(group)) {
                continue;
            }
            let line = evaluate_group(plan, group, options, source, observer)?;
            if let Some(journal) = &mut journal {
                journal.append(&line)?;
            }
            lines.push(line);
            observer.advance();
        }
        observer.end();

        let results = Results::new(&lines, options.conditions.bounds, source.expects());
        let mut written = Vec::new();
        if let Some(folder) = folder {
            if let Source::Network(_) = source {
                files::whole(&folder.join(&poses), csv(&lines).as_bytes())?;
                written.push(poses);
            }
            let summary = files::json(&results)? + "\n";
            files::whole(&folder.join("summary.json"), summary.as_bytes())?;
            written.extend(["summary.json".to_owned(), "groups.jsonl".to_owned()]);
        }
        Ok(Evaluated {
            about,
            results,
            lines,
            written,
            _journal: journal,
        })
    }
}

/// Where poses come from.
enum Source<'a> {
    Network(&'a Estimator),
    File(&'a Predictions),
}

/// File name of the poses, as BOP has it: no `_` in the name of the split.
fn poses_name(split: &Split) -> String {
    let parts = Path::new(&split.split).components();
    let names = parts.filter_map(|part| match part {
        Component::Normal(name) => Some(name.to_string_lossy()),
        _ => None,
    });
    let split_name = names.collect::<Vec<_>>().join("-").replace('_', "-");
    format!("mvtop_{}-{split_name}.csv", folder_name(&split.dataset))
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
        options: &Options,
        observer: &mut dyn Observer,
    ) -> Result<(Sample, Prediction, Option<f64>)> {
        match self {
            Self::Network(estimator) => {
                let sample = plan.load(group)?;
                let start = Instant::now();
                let prediction = sample.predict(estimator, &options.conditions)?;
                let time_s = start.elapsed().as_secs_f64();
                observer::warn(observer, &prediction, &sample.name);
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
    options: &Options,
    source: &Source,
    observer: &mut dyn Observer,
) -> Result<Line> {
    let (sample, mut prediction, time_s) = source.predict(plan, group, options, observer)?;
    // Objects that are not asked for are neither right nor wrong.
    let wanted = |class: &str| plan.object(class).is_some_and(|id| plan.wanted(group, id));
    prediction.objects.retain(|found| wanted(&found.class));
    let estimate = |found: &ObjectPose| {
        let obj_id = plan.object(&found.class)?;
        Some(Estimate::new(obj_id, found.score, &found.ref_from_obj))
    };
    let estimates: Vec<Estimate> = prediction.objects.iter().filter_map(estimate).collect();
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
        vsd_delta: options.vsd_delta_mm * 1e-3,
    };
    let of_sample = |problem| Error::Input(format!("{}: {problem}", sample.name));
    let scored = |(object, (known, &found)): (usize, (&TruePose, &Option<&ObjectPose>))| {
        let id = plan.object(&known.seen.class)?;
        let (model, truth) = (&plan.models[&id], &known.world_from_obj);
        let in_sight = plan.views_in_sight(group, id, truth, &sample.rig);
        let errors = found.map(|found| score::errors(truth, &found.world_from_obj, model));
        let mut outcome = Outcome::new(&sample, object, &prediction, found, errors);
        outcome.views = group.views.len();
        outcome.sigma = outcome.sigma.filter(|_| source.expects());
        let scored = Scored::new(outcome, known, in_sight, found, model, &view);
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
        detections: detections(plan, group, &estimates, &view, options).map_err(of_sample)?,
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

/// Of each object that the reference image shows, visible enough or not.
///
/// - `estimates`: in the reference image
fn detections(
    plan: &Plan,
    group: &Group,
    estimates: &[Estimate],
    view: &View,
    options: &Options,
) -> Result<Vec<Detections>> {
    let mut surest: Vec<&Estimate> = estimates.iter().collect();
    surest.sort_by(|a, b| b.score.total_cmp(&a.score));
    surest.truncate(Rules::of(&folder_name(&options.split.dataset)).most_estimates);
    let annotated = &plan.scenes[&group.scene].frames[&group.views[0]].objects;
    let of_object = |(&id, model): (&u32, &Model)| {
        let truth = annotated.iter().filter(|object| object.object == id);
        let truth: Vec<&Instance> = truth.filter(|_| plan.wanted(group, id)).collect();
        let found = surest.iter().filter(|estimate| estimate.obj_id == id);
        let found: Vec<&Estimate> = found.copied().collect();
        (!truth.is_empty()).then(|| Detections::new(&truth, &found, model, view))
    };
    plan.models.iter().filter_map(of_object).collect()
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
