//! The outcome as a table, as JSON and as CSV.

use std::error::Error;

use mvtop_eval::leakage::{Counts, Histogram, ObjectLeakage, PoseRecord, Split};
use serde::Serialize;

use super::{Audited, Measure};
use crate::failure::{Failure, Result};
use crate::write::pretty_json;

impl Measure {
    /// `0.5 % of the diameter (ADD)`
    pub fn of(self, limit: f64) -> String {
        match self {
            Self::AddPercent => format!("{limit} % of the diameter (ADD)"),
            Self::RotDeg => format!("{limit} deg of rotation"),
        }
    }

    fn key(self) -> &'static str {
        match self {
            Self::AddPercent => "add_percent",
            Self::RotDeg => "rot_deg",
        }
    }
}

/// Names and sizes of both splits.
pub fn splits(result: &Audited) -> [String; 2] {
    let split = |letter, name: &str, split: &Split| {
        let (poses, scenes) = (split.poses(), split.scenes.len());
        format!("{letter}  {name}: {poses} poses, scenes: {scenes}")
    };
    let [a, b] = &result.names;
    [split("a", a, &result.a), split("b", b, &result.b)]
}

/// What the columns count.
pub fn criteria(result: &Audited) -> String {
    format!(
        "recurring: same translation within {} mm, and a difference of at most {}; repeated: recurs \
         in its own split",
        result.within_mm,
        result.measure.of(result.limit)
    )
}

/// Counts per object and in total, for people.
pub fn table(result: &Audited) -> String {
    let mut lines = splits(result).to_vec();
    lines.push(criteria(result));
    lines.push(String::new());
    let columns = "poses   same translation         recurring    repeated";
    lines.push(format!("object  a: {columns}   b: {columns}"));
    let row = |name: &str, object: &ObjectLeakage| {
        format!("{name:>6}  {}  {}", cells(&object.a), cells(&object.b))
    };
    for object in &result.leakage.objects {
        lines.push(row(&object.object_id.to_string(), object));
    }
    let total = result.leakage.total();
    lines.push(row("total", &total));
    lines.push(String::new());
    lines.push(nearest(result.measure, &total.histogram, total.a.poses));
    lines.join("\n")
}

fn cells(counts: &Counts) -> String {
    let (poses, same, recurring) = (counts.poses, counts.same_translation, counts.recurring);
    format!(
        "{poses:>8} {same:>9} {:>6.2} % {recurring:>9} {:>6.2} % {:>11}",
        percent(same, poses),
        percent(recurring, poses),
        counts.repeated
    )
}

/// What the first bin of the histogram says.
pub fn nearest(measure: Measure, histogram: &Histogram, poses: u64) -> String {
    let first = histogram.bins[0];
    let whose = match measure {
        Measure::AddPercent => "have any pose of b at most 1 % of the diameter away (ADD)",
        Measure::RotDeg => "have the same translation and differ by at most 1 deg of rotation",
    };
    let share = percent(first, poses);
    format!("{first} of the {poses} poses of a ({share:.2} %) {whose}")
}

pub fn percent(part: u64, whole: u64) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}

/// `docs/how-to/audit-leakage.md` describes it.
pub fn json(result: &Audited) -> Result<String> {
    #[derive(Serialize)]
    struct Source<'a> {
        path: &'a str,
        scenes: usize,
        poses: usize,
    }
    #[derive(Serialize)]
    struct Report<'a> {
        schema_version: u32,
        a: Source<'a>,
        b: Source<'a>,
        within_mm: f64,
        measure: &'static str,
        limit: f64,
        total: Total,
        objects: &'a [ObjectLeakage],
    }
    #[derive(Serialize)]
    struct Total {
        a: Counts,
        b: Counts,
        histogram: Histogram,
    }
    let source = |path, split: &Split| Source {
        path,
        scenes: split.scenes.len(),
        poses: split.poses(),
    };
    let total = result.leakage.total();
    let report = Report {
        schema_version: 1,
        a: source(&result.names[0], &result.a),
        b: source(&result.names[1], &result.b),
        within_mm: result.within_mm,
        measure: result.measure.key(),
        limit: result.limit,
        total: Total {
            a: total.a,
            b: total.b,
            histogram: total.histogram,
        },
        objects: &result.leakage.objects,
    };
    Ok(pretty_json(&report)? + "\n")
}

/// One line for each recurring pose of split a.
pub fn csv(result: &Audited) -> Result<String> {
    records(result).map_err(|cause| Failure(format!("cannot write CSV: {cause}")))
}

fn records(result: &Audited) -> std::result::Result<String, Box<dyn Error>> {
    let by_add = result.measure == Measure::AddPercent;
    let mut csv = csv::Writer::from_writer(Vec::new());
    let mut header = vec![
        "object_id",
        "a_scene",
        "a_image",
        "a_annotation",
        "b_scene",
        "b_image",
        "b_annotation",
        "translation_mm",
        "rotation_deg",
    ];
    header.extend(by_add.then_some("add_percent"));
    csv.write_record(&header)?;
    let place = |split: &Split, pose: &PoseRecord| {
        let scene = split.scenes[pose.scene as usize].clone();
        [scene, pose.image.to_string(), pose.annotation.to_string()]
    };
    for pair in &result.leakage.pairs {
        let a = &result.a.objects[&pair.object_id][pair.a];
        let b = &result.b.objects[&pair.object_id][pair.b];
        let apart = a.translation_error_mm(b);
        let mut record = vec![pair.object_id.to_string()];
        record.extend(place(&result.a, a).into_iter().chain(place(&result.b, b)));
        record.extend([apart, a.rotation_error_deg(b)].map(|x| x.to_string()));
        record.extend(by_add.then(|| pair.difference.to_string()));
        csv.write_record(&record)?;
    }
    Ok(String::from_utf8(csv.into_inner()?)?)
}
