//! `report.html`, and the histogram that the paper's figure of YCB-V shows.

use askama::Template;
use mvtop_eval::leakage::{BINS, Counts};

use super::report::{criteria, nearest, percent, splits};
use super::{Audited, Measure};
use crate::failure::Result;
use crate::plot::Bars;
use crate::write;

#[derive(Template)]
#[template(path = "leakage.html")]
struct Page<'a> {
    splits: [String; 2],
    criteria: String,
    histogram: &'a str,
    /// Of each object: counts of a and b.
    rows: Vec<(String, [Counts; 2])>,
}

impl Page<'_> {
    /// `12 (3.40 %)`
    fn share(&self, part: &u64, whole: &u64) -> String {
        format!("{part} ({:.2} %)", percent(*part, *whole))
    }
}

/// - `histogram`: SVG
pub fn page(result: &Audited, histogram: &str) -> Result<String> {
    let total = result.leakage.total();
    let objects = result.leakage.objects.iter();
    let rows = objects.map(|object| (object.object_id.to_string(), [object.a, object.b]));
    write::template(&Page {
        splits: splits(result),
        criteria: criteria(result),
        histogram,
        rows: rows.chain([("total".into(), [total.a, total.b])]).collect(),
    })
}

/// Poses of split a over their difference to the most alike pose of b; the last bar is the rest.
pub fn histogram(result: &Audited) -> Result<String> {
    let total = result.leakage.total();
    let counts = [&total.histogram.bins[..], &[total.histogram.beyond]].concat();
    let label = match result.measure {
        Measure::AddPercent => "ADD to the nearest pose of b, percent of the object's diameter",
        Measure::RotDeg => "angle to the pose of b with the same translation, degrees",
    };
    Bars {
        size: (740, 400),
        title: &nearest(result.measure, &total.histogram, total.a.poses),
        x_label: &format!("{label} (last bar: more than {BINS})"),
        y_label: "poses of a",
        width: 1.0,
        counts: &counts,
        above: &|count| format!("{:.1} %", percent(count, total.a.poses)),
    }
    .svg()
}
