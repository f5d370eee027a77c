//! `eval bop`: a split of a data set in BOP's layout.

mod compared;
mod page;

use std::collections::BTreeSet;
use std::path::Path;

use mvtop_eval::runner::Observer;
use mvtop_eval::runner::bop::{Evaluated, Evaluation, Options, Plan, REPORT, side_by_side};
use serde_json::{Map, Value};

use super::args::BopArgs;
use crate::failure::{Failure, Result};
use crate::progress::Progress;
use crate::write;

/// What an evaluation answers.
pub struct Answer {
    /// One line of JSON.
    pub json: String,
    /// For people.
    pub text: String,
}

pub fn run(args: &BopArgs) -> Result<()> {
    let answer = match args.predictions.is_empty() {
        true => of_network(args),
        false => {
            let report = args.report.as_deref();
            of_files(&args.options(), args.out.as_deref().or(report), report)
        }
    }?;
    write::print(if args.json {
        &answer.json
    } else {
        &answer.text
    })
}

fn of_network(args: &BopArgs) -> Result<Answer> {
    let Some(folder) = args.out.as_deref().or(args.report.as_deref()) else {
        return Err(Failure("give --out DIR or --report DIR for what comes of it, or --predictions FILE.csv to score".into()));
    };
    let estimator = args.trial.load()?;
    let (options, mut progress) = (args.options(), Progress::new("groups"));
    let evaluation = Evaluation::new(&options, Some(&estimator.bundle().classes))?;
    warn(&evaluation, &mut progress);
    let mut done = evaluation.predict(&estimator, folder, &mut progress)?;
    if args.report.is_some() {
        report_in(folder, &mut done, evaluation.plan())?;
    }
    let (table, folder) = (
        done.results.text(&evaluation.plan().classes),
        folder.display(),
    );
    Ok(Answer {
        json: write::json(&done.results)?,
        text: format!("{table}\n\nin {folder}: {}", done.written.join(", ")),
    })
}

/// Scores of files in BOP's format. Of one file, what is written lies in the folder asked for; of
/// several, in folders within it that are named as the files are.
///
/// - `folder`: where results are written to, if anywhere
/// - `report`: the same folder, where pages are wanted
pub fn of_files(options: &Options, folder: Option<&Path>, report: Option<&Path>) -> Result<Answer> {
    let mut progress = Progress::new("groups");
    let evaluation = Evaluation::new(options, None)?;
    let plan = evaluation.plan();
    warn(&evaluation, &mut progress);
    let several = options.predictions.len() > 1;
    let stem = |path: &Path| {
        path.file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let stems: BTreeSet<String> = options.predictions.iter().map(|path| stem(path)).collect();
    if let Some(path) = several
        .then(|| {
            options
                .predictions
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
    if stems.len() < options.predictions.len() {
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
    let compared = report.filter(|_| several);
    let compared = compared.map(|folder| folder.join("compared.html"));
    if let Some(file) = &compared {
        write::may_write(file, options.force)?;
    }
    let (mut rows, mut json, mut texts) = (Vec::new(), Map::new(), Vec::new());
    for path in &options.predictions {
        let folder = folder.map(|folder| match several {
            true => folder.join(stem(path)),
            false => folder.to_owned(),
        });
        let mut done = evaluation.score(path, folder.as_deref(), &mut progress)?;
        if let Some(folder) = folder.as_deref().filter(|_| report.is_some()) {
            report_in(folder, &mut done, plan)?;
        }
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
        let about = evaluation.about()?;
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

fn warn(evaluation: &Evaluation, progress: &mut Progress) {
    for sentence in &evaluation.plan().warnings {
        progress.warn(sentence);
    }
}

/// Writes the page of what came of an evaluation beside its results.
fn report_in(folder: &Path, done: &mut Evaluated, plan: &Plan) -> Result<()> {
    let html = page::page(&done.about, &done.results, &done.lines, plan)?;
    write::whole(&folder.join(REPORT), html.as_bytes())?;
    done.written.push(REPORT.into());
    Ok(())
}
