//! How many poses are right: of all, and of those that are as sure as is asked for.

use serde::Serialize;

use super::bounds::Bounds;
use super::outcome::{Errors, Outcome};

/// Least confidences that it is told for what they would leave.
const LEAST_CONFIDENCES: [f64; 5] = [0.1, 0.2, 0.5, 0.8, 0.95];

/// How many of the poses are right, and how many of the objects have one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Right {
    /// Objects whose pose is right.
    pub right: usize,
    /// Share of the predicted objects; null where there is none.
    pub precision: Option<f64>,
    /// Share of the true objects; null where there is none.
    pub recall: Option<f64>,
}

impl Right {
    /// - `errors`: of each true object; `None` where it was not found
    /// - `predicted`: how many objects there were said to be
    pub fn new(
        errors: impl Iterator<Item = Option<Errors>>,
        predicted: usize,
        bounds: &Bounds,
    ) -> Self {
        let (mut objects, mut right) = (0, 0);
        for errors in errors {
            objects += 1;
            right += usize::from(errors.is_some_and(|e| e.within(bounds)));
        }
        let share = |of: usize| (of > 0).then(|| right as f64 / of as f64);
        Self {
            right,
            precision: share(predicted),
            recall: share(objects),
        }
    }
}

/// The poses of at least some confidence. Those that come without any are not among them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ByConfidence {
    least: f64,
    /// Poses that are left, of true objects or of none.
    predicted: usize,
    #[serde(flatten)]
    right: Right,
}

/// What these least confidences would leave; `None` where no pose has a confidence.
///
/// - `extra`: confidences of predicted objects that no outcome is about
pub fn by_confidence(
    outcomes: &[Outcome],
    extra: &[Option<f64>],
    bounds: &Bounds,
) -> Option<Vec<ByConfidence>> {
    let confidences = outcomes.iter().map(|outcome| outcome.confidence);
    let any = confidences
        .chain(extra.iter().copied())
        .any(|one| one.is_some());
    let rows = LEAST_CONFIDENCES.map(|least| at_least(least, outcomes, extra, bounds));
    any.then(|| rows.into())
}

/// What is left of the outcomes and of what they are not about, where this is the least confidence.
fn at_least(
    least: f64,
    outcomes: &[Outcome],
    extra: &[Option<f64>],
    bounds: &Bounds,
) -> ByConfidence {
    let is_left = |confidence: Option<f64>| confidence.is_some_and(|p| p >= least);
    let left = |outcome: &Outcome| outcome.errors().filter(|_| is_left(outcome.confidence));
    let found = outcomes.iter().filter_map(left).count();
    let predicted = found + extra.iter().filter(|one| is_left(**one)).count();
    ByConfidence {
        least,
        predicted,
        right: Right::new(outcomes.iter().map(left), predicted, bounds),
    }
}

/// Columns of [`Summary::by_confidence`](super::Summary::by_confidence).
pub const COLUMNS: [&str; 5] = [
    "--min-confidence",
    "predicted",
    "right",
    "precision",
    "recall",
];

/// For people; empty without rows.
///
/// - `all`: of all `predicted`
pub fn table(all: &Right, predicted: usize, rows: Option<&[ByConfidence]>) -> Vec<[String; 5]> {
    let line = |least: String, predicted: usize, right: &Right| {
        let [predicted, count] = [predicted, right.right].map(|count| count.to_string());
        let [precision, recall] = [right.precision, right.recall].map(percent);
        [least, predicted, count, precision, recall]
    };
    let Some(rows) = rows else {
        return Vec::new();
    };
    let rows = rows
        .iter()
        .map(|row| line(row.least.to_string(), row.predicted, &row.right));
    std::iter::once(line("all".into(), predicted, all))
        .chain(rows)
        .collect()
}

/// A share, for people.
pub fn percent(x: Option<f64>) -> String {
    x.map_or("–".into(), |x| format!("{:.1} %", 100.0 * x))
}

/// [`table`] for a terminal, after an empty line.
pub fn text(table: &[[String; 5]]) -> String {
    let line = |[least, predicted, right, precision, recall]: [&str; 5]| {
        format!("\n{least:<16}{predicted:>11}{right:>8}{precision:>11}{recall:>9}")
    };
    let rows = table
        .iter()
        .map(|row| line(row.each_ref().map(String::as_str)));
    match table {
        [] => String::new(),
        _ => format!("\n{}{}", line(COLUMNS), rows.collect::<String>()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runner::summary::Summary;
    use crate::runner::summary::tests::{bounds, missed, off_by};

    #[test]
    fn right_is_what_is_within_both_bounds() {
        // Of five true objects and six predicted.
        let outcomes = [
            off_by(4.9, 0.0049, 1.0),
            off_by(0.0, 0.0051, 1.0),
            off_by(5.1, 0.0, 1.0),
            off_by(5.0, 0.0, 1.0),
            missed(),
        ];
        let right = Right::new(outcomes.iter().map(Outcome::errors), 6, &bounds(15.0));
        assert_eq!(right.right, 2);
        assert_eq!(right.precision, Some(2.0 / 6.0));
        assert_eq!(right.recall, Some(2.0 / 5.0));
        let nothing = Right::new([].into_iter(), 0, &bounds(15.0));
        assert_eq!((nothing.precision, nothing.recall), (None, None));
    }

    #[test]
    fn a_least_confidence_leaves_what_is_as_sure() {
        let sure = |confidence: f64, rot_deg: f64| Outcome {
            confidence: Some(confidence),
            ..off_by(rot_deg, 0.001, 3.0)
        };
        let outcomes = [
            sure(0.99, 1.0),
            sure(0.5, 1.0),
            sure(0.3, 60.0),
            off_by(1.0, 0.001, 3.0), // says nothing of itself
            missed(),
        ];
        let extra = [Some(0.15), Some(0.85), None];
        let summary = Summary::new(2, 1, &extra, &outcomes, bounds(15.0));
        let rows = by_confidence(&outcomes, &extra, &bounds(15.0)).unwrap();
        let told = rows
            .iter()
            .map(|row| (row.least, row.predicted, row.right.right));
        assert_eq!(
            told.collect::<Vec<_>>(),
            [
                (0.1, 5, 2),
                (0.2, 4, 2),
                (0.5, 3, 2),
                (0.8, 2, 1),
                (0.95, 1, 1)
            ]
        );
        assert_eq!(rows[1].right.precision, Some(2.0 / 4.0));
        assert_eq!(rows[1].right.recall, Some(2.0 / 5.0));
        let text = summary.text("samples", 5);
        let last: Vec<&str> = text.lines().last().unwrap().split_whitespace().collect();
        assert_eq!(last, ["0.95", "1", "1", "100.0", "%", "20.0", "%"]);

        let silent = Summary::new(2, 1, &[None], &outcomes[3..], bounds(15.0));
        assert!(by_confidence(&outcomes[3..], &[None], &bounds(15.0)).is_none());
        assert!(!silent.text("samples", 2).contains("--min-confidence"));
    }
}
