//! Recall by the number of views that have an object in sight: what is hidden from all cameras but
//! one says little of a network.

use std::collections::BTreeMap;

use serde::Serialize;

use super::score::Scored;
use crate::runner::bounds::Bounds;
use crate::runner::outcome::Outcome;
use crate::runner::right::{Right, percent};

/// Objects that as many views have in sight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InSight {
    /// Views in which at least half of the object is visible.
    pub views: usize,
    /// Objects of the truth.
    pub objects: usize,
    /// Of these, those whose pose is right.
    pub right: usize,
    /// Their share.
    pub recall: Option<f64>,
}

/// Fewest views first; empty where the data set does not say what is visible.
pub fn by_views(scored: &[&Scored], bounds: &Bounds) -> Vec<InSight> {
    let mut by_views: BTreeMap<usize, Vec<&Outcome>> = BTreeMap::new();
    for one in scored {
        if let Some(views) = one.views_in_sight {
            by_views.entry(views).or_default().push(&one.outcome);
        }
    }
    let row = |(views, outcomes): (usize, Vec<&Outcome>)| {
        let errors = outcomes.iter().map(|outcome| outcome.errors());
        let Right { right, recall, .. } = Right::new(errors, 0, bounds);
        InSight {
            views,
            objects: outcomes.len(),
            right,
            recall,
        }
    };
    by_views.into_iter().map(row).collect()
}

impl InSight {
    /// Headings of [`Self::cells`].
    pub const COLUMNS: [&str; 4] = ["half visible in", "objects", "right", "recall"];

    /// For people.
    pub fn cells(&self) -> [String; 4] {
        let plural = if self.views == 1 { "" } else { "s" };
        [
            format!("{} view{plural}", self.views),
            self.objects.to_string(),
            self.right.to_string(),
            percent(self.recall),
        ]
    }
}

/// A table for a terminal, after two line breaks; empty without rows.
pub fn text(rows: &[InSight]) -> String {
    let line = |[views, objects, right, recall]: [&str; 4]| {
        format!("\n{views:<16}{objects:>11}{right:>8}{recall:>9}")
    };
    let cells: Vec<[String; 4]> = rows.iter().map(InSight::cells).collect();
    let lines = cells
        .iter()
        .map(|cells| line(cells.each_ref().map(String::as_str)));
    match rows {
        [] => String::new(),
        _ => format!("\n{}{}", line(InSight::COLUMNS), lines.collect::<String>()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runner::bop::score::tests::scored;
    use crate::runner::summary::tests::bounds;

    #[test]
    fn recall_is_told_by_views_in_sight() {
        let of = |views, shift: Option<[f64; 3]>| Scored {
            views_in_sight: views,
            ..scored(shift, None).0
        };
        let (right, off) = (Some([0.001, 0.0, 0.0]), Some([0.02, 0.0, 0.0]));
        let all = [
            of(Some(2), right),
            of(Some(1), None),
            of(Some(2), off),
            of(Some(2), right),
            of(None, right),
            of(Some(2), None),
        ];
        let rows = by_views(&all.iter().collect::<Vec<_>>(), &bounds(15.0));
        let of_row = |row: &InSight| (row.views, row.objects, row.right, row.recall);
        let told: Vec<_> = rows.iter().map(of_row).collect();
        assert_eq!(told, [(1, 1, 0, Some(0.0)), (2, 4, 2, Some(0.5))]);
        let text = text(&rows);
        let words: Vec<Vec<&str>> = text
            .lines()
            .map(|l| l.split_whitespace().collect())
            .collect();
        assert_eq!(words[3], ["1", "view", "1", "0", "0.0", "%"]);
        assert_eq!(words[4], ["2", "views", "4", "2", "50.0", "%"]);
        assert!(super::text(&by_views(&[&all[4]], &bounds(15.0))).is_empty());
    }
}
