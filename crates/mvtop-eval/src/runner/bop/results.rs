//! What all objects of a split amount to: `summary.json`, and tables for people.

use std::collections::BTreeMap;

use crate::statistics::mean;
use serde::Serialize;

use super::detection::Detections;
use super::in_sight::{self, InSight};
use super::journal::Line;
use super::score::{Scored, Scores};
use super::tally::Tally;
use crate::runner::bounds::Bounds;
use crate::runner::outcome::Outcome;
use crate::runner::right::percent;
use crate::runner::summary::Summary;

/// What `eval samples` says, and BOP's metrics.
#[derive(Serialize)]
pub struct Results {
    /// Errors and confidences.
    #[serde(flatten)]
    pub summary: Summary,
    /// Of all objects.
    pub all: Scores,
    /// By obj_id.
    pub objects: BTreeMap<u32, Scores>,
    /// By the number of views that have an object in sight; empty where the data set does not say.
    pub by_views_in_sight: Vec<InSight>,
    /// Mean time of an image, seconds, where results of a file say it of all; measured times differ
    /// from run to run, and are in the CSV.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_mean_s: Option<f64>,
}

/// A column of the tables.
pub struct Column {
    /// Its heading.
    pub name: &'static str,
    /// What stands in it.
    pub cell: fn(&Scores) -> String,
    /// Whether it is one of the few that a terminal has room for.
    pub main: bool,
}

/// All columns.
pub const COLUMNS: [Column; 19] = [
    main("true", |s| s.objects.to_string()),
    main("found", |s| s.found.to_string()),
    main("rotation, median °", |s| number(s.rot_median_deg, 1.0)),
    main("translation, mm", |s| number(s.trans_median_m, 1e3)),
    other("ADD recall", |s| percent(s.add.recall_01d)),
    other("ADD-S recall", |s| percent(s.add_s.recall_01d)),
    main("ADD-(S) recall", |s| percent(s.add_or_add_s.recall_01d)),
    other("ADD AUC", |s| percent(s.add.auc_posecnn)),
    other("ADD-S AUC", |s| percent(s.add_s.auc_posecnn)),
    other("ADD-(S) AUC", |s| percent(s.add_or_add_s.auc_posecnn)),
    other("AR MSSD", |s| percent(s.ar_mssd)),
    other("AR MSPD", |s| percent(s.ar_mspd)),
    other("AR VSD", |s| percent(s.ar_vsd)),
    main("AR", average_recall),
    other("AP MSSD", |s| percent(s.ap_mssd)),
    other("AP MSPD", |s| percent(s.ap_mspd)),
    main("AP-mm", |s| percent(s.ap_mm)),
    other("precision", |s| percent(s.right.precision)),
    main("recall", |s| percent(s.right.recall)),
];

/// BOP's average recall; without depth, and so without VSD, the mean of the other two, which is marked.
fn average_recall(scores: &Scores) -> String {
    match (scores.ar, scores.ar_mssd.zip(scores.ar_mspd)) {
        (None, Some((mssd, mspd))) => {
            format!("{}*", percent(Some((mssd + mspd) / 2.0)))
        }
        (ar, _) => percent(ar),
    }
}

/// What [`average_recall`] marks.
const WITHOUT_VSD: &str = "* AR without VSD, as there is no depth";

fn is_without_vsd(scores: &Scores) -> bool {
    scores.ar.is_none() && scores.ar_mssd.is_some()
}

const fn main(name: &'static str, cell: fn(&Scores) -> String) -> Column {
    let main = true;
    Column { name, cell, main }
}

const fn other(name: &'static str, cell: fn(&Scores) -> String) -> Column {
    let main = false;
    Column { name, cell, main }
}

fn number(x: Option<f64>, unit: f64) -> String {
    x.map_or("–".into(), |x| format!("{:.2}", x * unit))
}

impl Results {
    /// What all groups amount to.
    ///
    /// - `measured`: whether times were measured here, rather than read
    pub fn new(lines: &[Line], bounds: Bounds, measured: bool) -> Self {
        let scored: Vec<&Scored> = lines.iter().flat_map(|line| &line.objects).collect();
        let tallies: Vec<&Tally> = lines.iter().flat_map(|line| &line.tallies).collect();
        let detections: Vec<&Detections> = lines.iter().flat_map(|line| &line.detections).collect();
        let outcomes: Vec<Outcome> = scored.iter().map(|s| s.outcome.clone()).collect();
        let views = outcomes.iter().map(|outcome| outcome.views).max();
        let extra = lines.iter().flat_map(|line| &line.extra_confidences);
        let extra: Vec<Option<f64>> = extra.copied().collect();
        let mut by_object: BTreeMap<u32, Vec<&Scored>> = BTreeMap::new();
        for &scored in &scored {
            by_object.entry(scored.obj_id).or_default().push(scored);
        }
        // Objects that are nowhere have no row.
        let scores = |(id, scored): (u32, Vec<&Scored>)| {
            let tallies: Vec<&Tally> = tallies.iter().copied().filter(|t| t.obj_id == id).collect();
            let detections = detections.iter().copied().filter(|d| d.obj_id == id);
            let detections: Vec<&Detections> = detections.collect();
            (id, Scores::new(&scored, &tallies, &detections, &bounds))
        };
        let with_poses = lines.iter().filter(|line| !line.estimates.is_empty());
        let times: Option<Vec<f64>> = with_poses.map(|line| line.time_s).collect();
        Self {
            summary: Summary::new(views.unwrap_or(0), lines.len(), &extra, &outcomes, bounds),
            all: Scores::new(&scored, &tallies, &detections, &bounds),
            objects: by_object.into_iter().map(scores).collect(),
            by_views_in_sight: in_sight::by_views(&scored, &bounds),
            time_mean_s: times.filter(|_| !measured).and_then(|times| mean(&times)),
        }
    }

    /// Names and scores of each object and of all.
    ///
    /// - `classes`: names by obj_id
    pub fn rows(&self, classes: &BTreeMap<u32, String>) -> Vec<(String, &Scores)> {
        let name = |id| format!("{id} {}", classes.get(id).map_or("", |name| name));
        let rows = self.objects.iter().map(|(id, scores)| (name(id), scores));
        rows.chain([("all".to_owned(), &self.all)]).collect()
    }

    /// Tables for a terminal.
    pub fn text(&self, classes: &BTreeMap<u32, String>) -> String {
        let summary = self.summary.text("groups", self.all.objects);
        let in_sight = in_sight::text(&self.by_views_in_sight);
        let table = table("object", &self.rows(classes));
        format!("{summary}{in_sight}\n\n{table}")
    }
}

/// Scores of several results, a row each.
pub fn side_by_side<'a>(results: impl Iterator<Item = (&'a String, &'a Results)>) -> String {
    let rows = results.map(|(name, results)| (name.clone(), &results.all));
    table("results", &rows.collect::<Vec<_>>())
}

/// - `what`: the rows are of
fn table(what: &str, rows: &[(String, &Scores)]) -> String {
    let columns = || COLUMNS.iter().filter(|column| column.main);
    let names = rows.iter().map(|(name, _)| name.chars().count());
    let width = names.max().unwrap_or(0).max(what.len());
    let cells_of = |column: &Column| {
        let cells = rows.iter().map(|(_, scores)| (column.cell)(scores));
        let mut cells: Vec<String> = [column.name.to_owned()].into_iter().chain(cells).collect();
        let width = cells.iter().map(|cell| cell.chars().count()).max();
        let width = width.unwrap_or(0) + 2;
        for cell in &mut cells {
            *cell = format!("{cell:>width$}");
        }
        cells
    };
    let columns: Vec<Vec<String>> = columns().map(cells_of).collect();
    let names = [what]
        .into_iter()
        .chain(rows.iter().map(|(name, _)| name.as_str()));
    let line = |(row, name): (usize, &str)| {
        let cells: String = columns.iter().map(|cells| cells[row].as_str()).collect();
        format!("{name:width$}{cells}")
    };
    let mut lines: Vec<String> = names.enumerate().map(line).collect();
    if rows.iter().any(|(_, scores)| is_without_vsd(scores)) {
        lines.push(WITHOUT_VSD.to_owned());
    }
    lines.join("\n")
}
