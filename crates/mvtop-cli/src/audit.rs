//! `audit leakage`: how many poses of one split recur in another.

pub mod args;
mod picture;
mod report;

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use mvtop_eval::bop::load_models;
use mvtop_eval::leakage::{Files, Leakage, Settings, Split, common_objects, leakage};

use self::args::Audit;
use crate::failure::{Failure, Result, may_write, print};

pub fn run(audit: &Audit) -> Result<()> {
    let Audit::Leakage(args) = audit;
    let outputs = [&args.json, &args.picture, &args.pairs];
    for path in outputs.into_iter().flatten() {
        may_write(path, args.force)?;
    }
    let (a, b) = read(&args.a, &args.b)?;
    let models = match &args.models {
        Some(folder) => {
            let common = common_objects(&a, &b)?;
            Some(load_models(folder, |id| common.contains(&id))?)
        }
        None => None,
    };
    let (measure, limit) = match models {
        Some(_) => (Measure::AddPercent, args.add_percent),
        None => (Measure::RotDeg, args.rot_deg),
    };
    let settings = Settings {
        within_mm: args.within_mm,
        limit,
        models: models.as_ref(),
    };
    let result = Audited {
        leakage: leakage(&a, &b, &settings)?,
        names: [&args.a, &args.b].map(|path| path.display().to_string()),
        a,
        b,
        measure,
        within_mm: args.within_mm,
        limit,
    };
    if let Some(path) = &args.json {
        write(path, &report::json(&result)?)?;
    }
    if let Some(path) = &args.picture {
        write(path, &picture::svg(&result))?;
    }
    if let Some(path) = &args.pairs {
        write(path, &report::csv(&result))?;
    }
    print(&report::table(&result))
}

/// What poses with the same translation are compared by.
#[derive(Clone, Copy, PartialEq)]
enum Measure {
    AddPercent,
    RotDeg,
}

/// All that the reports are made of.
struct Audited {
    names: [String; 2],
    a: Split,
    b: Split,
    measure: Measure,
    within_mm: f64,
    limit: f64,
    leakage: Leakage,
}

/// Reads both splits, with a progress bar.
fn read(a: &Path, b: &Path) -> Result<(Split, Split)> {
    let (files_a, files_b) = (Files::find(a)?, Files::find(b)?);
    if let Some(path) = files_a.shared_with(&files_b) {
        return Err(Failure(format!(
            "{} is in both splits: expected two splits with no scene in common, or all of its \
             poses recur",
            path.display()
        )));
    }
    let style = ProgressStyle::with_template("{bar:40} {bytes}/{total_bytes} read, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(files_a.bytes + files_b.bytes).with_style(style);
    let splits = files_a
        .read(|bytes| bar.inc(bytes))
        .and_then(|a| Ok((a, files_b.read(|bytes| bar.inc(bytes))?)));
    bar.finish_and_clear();
    Ok(splits?)
}

/// The file appears when it is whole.
fn write(path: &Path, text: &str) -> Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    std::fs::write(&partial, text)
        .and_then(|()| std::fs::rename(&partial, path))
        .map_err(|cause| Failure(format!("cannot write {}: {cause}", path.display())))
}
