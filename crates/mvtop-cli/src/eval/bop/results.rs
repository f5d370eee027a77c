//! What all objects of a split amount to: `summary.json`, and tables for people.

use std::collections::BTreeMap;

use serde::Serialize;

use super::journal::Line;
use super::score::{Scored, Scores};
use crate::eval::outcome::Outcome;
use crate::eval::summary::{Bounds, Summary};

/// What `eval samples` says, and BOP's metrics.
#[derive(Serialize)]
pub struct Results {
    #[serde(flatten)]
    pub summary: Summary,
    pub all: Scores,
    /// By obj_id.
    pub objects: BTreeMap<u32, Scores>,
}

/// A column of the tables.
pub struct Column {
    pub name: &'static str,
    pub cell: fn(&Scores) -> String,
    /// Whether it is one of the few that a terminal has room for.
    pub main: bool,
}

pub const COLUMNS: [Column; 16] = [
    main("of truth", |s| s.objects.to_string()),
    main("found", |s| s.found.to_string()),
    main("rotation, median °", |s| number(s.rot_median_deg, 1.0)),
    main("translation, median mm", |s| number(s.trans_median_m, 1e3)),
    other("ADD recall", |s| percent(s.add.recall_01d)),
    other("ADD-S recall", |s| percent(s.add_s.recall_01d)),
    main("ADD-(S) recall", |s| percent(s.add_or_add_s.recall_01d)),
    other("ADD AUC", |s| percent(s.add.auc_posecnn)),
    other("ADD-S AUC", |s| percent(s.add_s.auc_posecnn)),
    other("ADD-(S) AUC", |s| percent(s.add_or_add_s.auc_posecnn)),
    other("AR MSSD", |s| percent(s.ar_mssd)),
    other("AR MSPD", |s| percent(s.ar_mspd)),
    other("AR VSD", |s| percent(s.ar_vsd)),
    main("AR", |s| percent(s.ar)),
    other("precision", |s| percent(s.right.precision)),
    main("recall", |s| percent(s.right.recall)),
];

const fn main(name: &'static str, cell: fn(&Scores) -> String) -> Column {
    let main = true;
    Column { name, cell, main }
}

const fn other(name: &'static str, cell: fn(&Scores) -> String) -> Column {
    let main = false;
    Column { name, cell, main }
}

fn percent(x: Option<f64>) -> String {
    x.map_or("–".into(), |x| format!("{:.1} %", 100.0 * x))
}

fn number(x: Option<f64>, unit: f64) -> String {
    x.map_or("–".into(), |x| format!("{:.2}", x * unit))
}

impl Results {
    pub fn new(lines: &[Line], bounds: Bounds) -> Self {
        let scored: Vec<&Scored> = lines.iter().flat_map(|line| &line.objects).collect();
        let outcomes: Vec<Outcome> = scored.iter().map(|s| s.outcome.clone()).collect();
        let views = outcomes.iter().map(|outcome| outcome.views).max();
        let extra = lines.iter().map(|line| line.extra).sum();
        let mut by_object: BTreeMap<u32, Vec<&Scored>> = BTreeMap::new();
        for &scored in &scored {
            by_object.entry(scored.obj_id).or_default().push(scored);
        }
        let predicted = |id: Option<u32>| {
            let estimates = lines.iter().flat_map(|line| &line.estimates);
            estimates
                .filter(|e| id.is_none_or(|id| e.obj_id == id))
                .count()
        };
        let scores = |(id, scored): (u32, Vec<&Scored>)| {
            (id, Scores::new(&scored, predicted(Some(id)), &bounds))
        };
        Self {
            summary: Summary::new(views.unwrap_or(0), lines.len(), extra, &outcomes, bounds),
            all: Scores::new(&scored, predicted(None), &bounds),
            objects: by_object.into_iter().map(scores).collect(),
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

    pub fn text(&self, classes: &BTreeMap<u32, String>) -> String {
        let columns = || COLUMNS.iter().filter(|column| column.main);
        let rows = self.rows(classes);
        let names = rows.iter().map(|(name, _)| name.chars().count());
        let width = names.max().unwrap_or(0).max("object".len());
        let mut lines = vec![self.summary.text("groups", self.all.objects), String::new()];
        let header = columns().map(|column| format!("  {}", column.name));
        lines.push(format!("{:width$}{}", "object", header.collect::<String>()));
        for (name, scores) in &rows {
            let cells = columns().map(|column| {
                let width = column.name.chars().count() + 2;
                format!("{:>width$}", (column.cell)(scores))
            });
            lines.push(format!("{name:width$}{}", cells.collect::<String>()));
        }
        lines.join("\n")
    }
}
