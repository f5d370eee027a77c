//! `compared.html`: several results side by side.

use askama::Template;
use mvtop_eval::runner::bop::{COLUMNS, Line, Results};
use serde_json::Value;

use crate::failure::Result;
use crate::plot::recall_curves;
use crate::write;

/// Columns of the scores that are compared object by object.
const BY_OBJECT: [&str; 3] = ["AR", "ADD-(S) AUC", "rotation, median °"];
/// Largest threshold of the curves, diameters.
const WIDEST: f64 = 0.5;

#[derive(Template)]
#[template(path = "compared.html")]
struct Page<'a> {
    dataset: &'a str,
    split: &'a str,
    columns: Vec<&'static str>,
    /// Of each file, all its scores.
    rows: Vec<(&'a str, Vec<String>)>,
    /// SVG.
    plot: String,
    objects: Vec<Table>,
}

/// One score of each object, a column for each file.
struct Table {
    score: &'static str,
    rows: Vec<(String, Vec<String>)>,
}

/// What one file gave.
pub struct Scored<'a> {
    pub name: &'a str,
    pub results: &'a Results,
    pub lines: &'a [Line],
}

/// - `about`: what was evaluated
/// - `name_of`: what an object is called
pub fn page(about: &Value, all: &[Scored], name_of: impl Fn(u32) -> String) -> Result<String> {
    let ids: Vec<u32> = all.first().map_or(Vec::new(), |one| {
        one.results.objects.keys().copied().collect()
    });
    let table = |score: &'static str| {
        let column = COLUMNS.iter().find(|column| column.name == score)?;
        let cells = |id: &u32| {
            let of = |one: &Scored| one.results.objects.get(id).map(column.cell);
            all.iter().map(|one| of(one).unwrap_or_default()).collect()
        };
        let rows = ids.iter().map(|id| (name_of(*id), cells(id))).collect();
        Some(Table { score, rows })
    };
    let row = |one: &Scored| COLUMNS.iter().map(|c| (c.cell)(&one.results.all)).collect();
    write::template(&Page {
        dataset: about["dataset"].as_str().unwrap_or_default(),
        split: about["split"].as_str().unwrap_or_default(),
        columns: COLUMNS.iter().map(|column| column.name).collect(),
        rows: all.iter().map(|one| (one.name, row(one))).collect(),
        plot: plot(all)?,
        objects: BY_OBJECT.into_iter().filter_map(table).collect(),
    })
}

/// Recall of ADD-(S) of all objects, a curve for each file.
fn plot(all: &[Scored]) -> Result<String> {
    let errors = |one: &Scored| -> Vec<f64> {
        let scored = one.lines.iter().flat_map(|line| &line.objects);
        // Objects that were not found are infinitely wrong.
        let error = scored.map(|s| s.add_or_add_s().unwrap_or(f64::INFINITY) / s.diameter_m);
        error.collect()
    };
    let curves: Vec<(&str, Vec<f64>)> = all.iter().map(|one| (one.name, errors(one))).collect();
    recall_curves("Recall, ADD-(S)", "threshold, diameters", WIDEST, &curves)
}
