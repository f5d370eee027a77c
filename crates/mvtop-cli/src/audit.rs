//! `audit leakage`: how many poses of one split recur in another.

pub mod args;
mod page;
mod report;

use std::path::Path;

use mvtop_eval::bop::load_models;
use mvtop_eval::leakage::{Files, Leakage, Settings, Split, common_objects, leakage};

use self::args::Audit;
use crate::failure::{Failure, Result};
use crate::{progress, write};

/// Splits whose distances differ by more are in different units, of which metres and millimetres
/// differ least.
const UNITS: f64 = 300.0;

pub fn run(command: &Audit) -> Result<()> {
    let Audit::Leakage(args) = command;
    let data = ["leakage.json", "pairs.csv"];
    let page = ["report.html", "histogram.svg"];
    let folder = args.out.as_ref().or(args.report.as_ref());
    for (folder, names) in [(folder, data), (args.report.as_ref(), page)] {
        for path in folder
            .iter()
            .flat_map(|folder| names.map(|name| folder.join(name)))
        {
            write::may_write(&path, args.force)?;
        }
    }
    let (a, b) = read(&args.a, &args.b)?;
    let mut models = None;
    if let Some(folder) = &args.meshes {
        let common = common_objects(&a, &b)?;
        models = Some(load_models(folder, |id| common.contains(&id))?);
    }
    let (measure, limit) = match models {
        Some(_) => (Measure::AddPercent, args.add_percent),
        None => (Measure::RotDeg, args.rot_deg),
    };
    let settings = Settings {
        within_mm: args.within_mm,
        limit,
        models: models.as_ref(),
    };
    let leakage = leakage(&a, &b, &settings)?;
    for sentence in doubts(&a, &b) {
        write::complain(&format!("warning: {sentence}"));
    }
    let result = Audited {
        leakage,
        names: [&args.a, &args.b].map(|path| path.display().to_string()),
        a,
        b,
        measure,
        within_mm: args.within_mm,
        limit,
    };
    let json = report::json(&result)?;
    if let Some(folder) = folder {
        write::folder(folder)?;
        for (name, text) in data.into_iter().zip([&json, &report::csv(&result)?]) {
            write::whole(&folder.join(name), text.as_bytes())?;
        }
    }
    if let Some(folder) = &args.report {
        let histogram = page::histogram(&result)?;
        let html = page::page(&result, &histogram)?;
        for (name, text) in page.into_iter().zip([&html, &histogram]) {
            write::whole(&folder.join(name), text.as_bytes())?;
        }
    }
    if args.json {
        return write::print(json.trim_end());
    }
    write::print(&report::table(&result))
}

/// What makes the outcome doubtful.
fn doubts(a: &Split, b: &Split) -> Vec<String> {
    let inexact = [("a", a), ("b", b)].map(|(letter, split)| {
        let sentence = split.inexact.sentence("the ground truth");
        sentence.map(|sentence| format!("split {letter}: {sentence}"))
    });
    let units = a.median_distance_mm().zip(b.median_distance_mm());
    let units = units.and_then(|(of_a, of_b)| {
        let another = of_a > UNITS * of_b || of_b > UNITS * of_a;
        another.then(|| {
            format!(
                "objects are {of_a:.4} mm from the camera in split a, {of_b:.4} mm in split b \
                 (medians): expected millimetres in both, so one looks like metres, and no pose of \
                 it recurs"
            )
        })
    });
    inexact.into_iter().flatten().chain(units).collect()
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
    let bar = progress::bar(files_a.bytes + files_b.bytes, "{bytes}/{total_bytes} read");
    let splits = files_a
        .read(|bytes| bar.inc(bytes))
        .and_then(|a| Ok((a, files_b.read(|bytes| bar.inc(bytes))?)));
    bar.finish_and_clear();
    Ok(splits?)
}
