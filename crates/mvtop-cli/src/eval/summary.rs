//! What many outcomes amount to.

use mvtop_core::prediction::Sigma;
use serde::Serialize;

use super::outcome::Outcome;

/// A rotation that is off by more is taken for a wrong one rather than an inexact one.
const WRONG_DEG: f64 = 30.0;

/// Bins of the calibration, and the fewest poses in one whose means say something.
const BINS: usize = 5;
const LEAST_IN_BIN: usize = 10;

/// Means are over the found objects, null where there is none.
#[derive(Debug, Serialize)]
pub struct Summary {
    views: usize,
    /// Samples.
    pairs: usize,
    /// Objects of the truth for which there is a predicted pose of their class.
    found: usize,
    rot_mean_deg: Option<f64>,
    rot_median_deg: Option<f64>,
    share_over_30_deg: Option<f64>,
    add_mean_m: Option<f64>,
    trans_mean_m: Option<f64>,
    sigma_rot_mean_deg: Option<f64>,
    sigma_t_mean_m: Option<f64>,
    /// Predicted objects that are no true object's prediction.
    extra: usize,
    resolved_deg: f64,
    /// Share of the found objects whose rotation is off by at most `resolved_deg`.
    resolved_share: Option<f64>,
    /// How well the expected rotation error tells resolved poses from others, see [`auroc`].
    sigma_rot_auroc: Option<f64>,
    /// Pearson's, between expected and actual rotation error.
    sigma_rot_correlation: Option<f64>,
    /// Poses in bins of equal count, least expected rotation error first; null for few poses.
    calibration: Option<Vec<Bin>>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bin {
    count: usize,
    sigma_rot_mean_deg: f64,
    rot_mean_deg: f64,
}

/// A found object.
struct Found<'a> {
    rot_deg: f64,
    trans_m: f64,
    add_m: Option<f64>,
    sigma: &'a Sigma,
}

impl Summary {
    /// - `pairs`: number of samples
    /// - `extra`: predicted objects that no outcome is about
    /// - `resolved_deg`: largest rotation error of a pose that counts as resolved
    pub fn new(
        views: usize,
        pairs: usize,
        extra: usize,
        outcomes: &[Outcome],
        resolved_deg: f64,
    ) -> Self {
        let found: Vec<Found> = outcomes
            .iter()
            .filter_map(|outcome| {
                Some(Found {
                    rot_deg: outcome.rot_deg?,
                    trans_m: outcome.trans_m?,
                    add_m: outcome.add_m,
                    sigma: outcome.sigma.as_ref()?,
                })
            })
            .collect();
        let mean_of =
            |value: &dyn Fn(&Found) -> f64| mean(&found.iter().map(value).collect::<Vec<f64>>());
        let mut rotations: Vec<f64> = found.iter().map(|f| f.rot_deg).collect();
        rotations.sort_by(f64::total_cmp);
        let expected: Vec<(f64, f64)> =
            found.iter().map(|f| (f.sigma.rot_deg, f.rot_deg)).collect();
        let (resolved, open): (Vec<&Found>, Vec<&Found>) =
            found.iter().partition(|f| f.rot_deg <= resolved_deg);
        let sigmas = |group: &[&Found]| group.iter().map(|f| f.sigma.rot_deg).collect::<Vec<_>>();
        Self {
            views,
            pairs,
            found: found.len(),
            rot_mean_deg: mean_of(&|f| f.rot_deg),
            rot_median_deg: median(&rotations),
            share_over_30_deg: mean_of(&|f| f64::from(u8::from(f.rot_deg > WRONG_DEG))),
            add_mean_m: mean_of(&|f| f.add_m.unwrap_or(f64::NAN)).filter(|mean| mean.is_finite()),
            trans_mean_m: mean_of(&|f| f.trans_m),
            sigma_rot_mean_deg: mean_of(&|f| f.sigma.rot_deg),
            sigma_t_mean_m: mean_of(&|f| f.sigma.t_m),
            extra,
            resolved_deg,
            resolved_share: mean_of(&|f| f64::from(u8::from(f.rot_deg <= resolved_deg))),
            sigma_rot_auroc: auroc(&sigmas(&resolved), &sigmas(&open)),
            sigma_rot_correlation: correlation(&expected),
            calibration: calibration(expected),
        }
    }
}

impl Summary {
    /// For people.
    ///
    /// - `of`: what was predicted at once, `samples`
    /// - `objects`: number of objects of the truth
    pub fn text(&self, of: &str, objects: usize) -> String {
        let number = |x: Option<f64>, unit: f64, digits: usize| {
            x.map_or("–".into(), |x| format!("{:.digits$}", x * unit))
        };
        let (deg, mm) = (|x| number(x, 1.0, 2), |x| number(x, 1e3, 1));
        let percent = |x| number(x, 100.0, 1);
        let row = |name, mean: &str, median: &str, expected: &str| {
            let row = format!("{name:18}{mean:>8}{median:>10}{expected:>12}");
            row.trim_end().to_owned()
        };
        let found = format!("found: {} of {objects} objects", self.found);
        [
            format!(
                "{of}: {}, views: {}, {found}, false positives: {}\n",
                self.pairs, self.views, self.extra
            ),
            row("error", "mean", "median", "expected"),
            row(
                "rotation, °",
                &deg(self.rot_mean_deg),
                &deg(self.rot_median_deg),
                &deg(self.sigma_rot_mean_deg),
            ),
            row(
                "translation, mm",
                &mm(self.trans_mean_m),
                "",
                &mm(self.sigma_t_mean_m),
            ),
            row("ADD, mm", &mm(self.add_mean_m), "", ""),
            format!(
                "\nrotation within {}°: {} % of the found, over {WRONG_DEG}°: {} %",
                self.resolved_deg,
                percent(self.resolved_share),
                percent(self.share_over_30_deg)
            ),
            format!(
                "expected and actual rotation error: AUROC {}, correlation {}",
                number(self.sigma_rot_auroc, 1.0, 3),
                number(self.sigma_rot_correlation, 1.0, 2)
            ),
        ]
        .join("\n")
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Middle of sorted values, the mean of the two middle ones where their number is even.
pub fn median(sorted: &[f64]) -> Option<f64> {
    let upper = sorted.get(sorted.len() / 2)?;
    let lower = sorted.get(sorted.len().saturating_sub(1) / 2)?;
    Some((lower + upper) / 2.0)
}

/// Area under the receiver operating characteristic: the probability that of a low and a high
/// sample the high one is greater, where equal ones count half. `None` where either is empty.
///
/// Source: Hanley and McNeil, "The Meaning and Use of the Area under a ROC Curve", 1982.
fn auroc(low: &[f64], high: &[f64]) -> Option<f64> {
    let wins = |h: f64| {
        let win = |&l: &f64| {
            if h > l {
                1.0
            } else {
                f64::from(u8::from(h == l)) / 2.0
            }
        };
        low.iter().map(win).sum::<f64>()
    };
    let pairs = low.len() * high.len();
    (pairs > 0).then(|| high.iter().map(|&h| wins(h)).sum::<f64>() / pairs as f64)
}

/// Pearson's; `None` where either side does not vary.
fn correlation(pairs: &[(f64, f64)]) -> Option<f64> {
    let (xs, ys): (Vec<f64>, Vec<f64>) = pairs.iter().copied().unzip();
    let (x_mean, y_mean) = (mean(&xs)?, mean(&ys)?);
    let sum = |of: fn(f64, f64) -> f64| -> f64 {
        pairs.iter().map(|(x, y)| of(x - x_mean, y - y_mean)).sum()
    };
    let spread = (sum(|x, _| x * x) * sum(|_, y| y * y)).sqrt();
    (spread > 0.0).then(|| sum(|x, y| x * y) / spread)
}

/// - `pairs`: expected and actual rotation error, degrees
fn calibration(mut pairs: Vec<(f64, f64)>) -> Option<Vec<Bin>> {
    if pairs.len() < BINS * LEAST_IN_BIN {
        return None;
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let cut = |bin: usize| pairs.len() * bin / BINS;
    (0..BINS)
        .map(|bin| {
            let (expected, actual): (Vec<f64>, Vec<f64>) =
                pairs[cut(bin)..cut(bin + 1)].iter().copied().unzip();
            Some(Bin {
                count: expected.len(),
                sigma_rot_mean_deg: mean(&expected)?,
                rot_mean_deg: mean(&actual)?,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvtop_core::prediction::Timings;

    fn off_by(rot_deg: f64, trans_m: f64, sigma_rot_deg: f64) -> Outcome {
        Outcome {
            sample: "a".into(),
            object: 0,
            class: "ball".into(),
            views: 2,
            found: true,
            rot_deg: Some(rot_deg),
            trans_m: Some(trans_m),
            add_m: Some(trans_m / 2.0),
            score: Some(0.9),
            sigma: Some(Sigma {
                rot_deg: sigma_rot_deg,
                t_m: 0.5,
            }),
            cameras: vec![],
            t_world_obj: None,
            timings_ms: Timings::default(),
        }
    }

    fn missed() -> Outcome {
        Outcome {
            found: false,
            rot_deg: None,
            trans_m: None,
            add_m: None,
            score: None,
            sigma: None,
            ..off_by(0.0, 0.0, 0.0)
        }
    }

    #[test]
    fn summary_of_five_objects_of_which_one_is_missed() {
        let outcomes = [
            off_by(10.0, 0.1, 3.0),
            off_by(50.0, 0.3, 9.0),
            missed(),
            off_by(2.0, 0.2, 7.0),
            off_by(30.0, 0.2, 5.0),
        ];
        let summary = Summary::new(2, 5, 3, &outcomes, 10.0);
        assert_eq!((summary.views, summary.pairs, summary.found), (2, 5, 4));
        assert_eq!(summary.extra, 3);
        assert_eq!(summary.rot_mean_deg, Some(23.0));
        assert_eq!(summary.rot_median_deg, Some(20.0));
        assert_eq!(summary.share_over_30_deg, Some(0.25));
        assert!((summary.trans_mean_m.unwrap() - 0.2).abs() < 1e-12);
        assert!((summary.add_mean_m.unwrap() - 0.1).abs() < 1e-12);
        assert_eq!(summary.sigma_rot_mean_deg, Some(6.0));
        assert_eq!(summary.sigma_t_mean_m, Some(0.5));
        // Resolved: 10 and 2 degrees, expected 3 and 7; others expected 9 and 5. Three of the
        // four pairs are in order.
        assert_eq!(summary.resolved_share, Some(0.5));
        assert_eq!(summary.sigma_rot_auroc, Some(0.75));
        assert!(summary.calibration.is_none());
    }

    #[test]
    fn summary_of_nothing_is_null() {
        let json = serde_json::to_value(Summary::new(2, 1, 0, &[missed()], 15.0)).unwrap();
        assert_eq!(json["found"], 0);
        for key in [
            "rot_mean_deg",
            "rot_median_deg",
            "share_over_30_deg",
            "add_mean_m",
            "resolved_share",
            "sigma_rot_auroc",
            "sigma_rot_correlation",
            "calibration",
        ] {
            assert!(json[key].is_null(), "{key}");
        }
    }

    #[test]
    fn median_of_an_odd_number_is_the_middle() {
        assert_eq!(median(&[1.0, 2.0, 9.0]), Some(2.0));
        assert_eq!(median(&[4.0]), Some(4.0));
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn auroc_counts_pairs_in_order() {
        assert_eq!(auroc(&[1.0, 2.0], &[3.0, 4.0]), Some(1.0));
        assert_eq!(auroc(&[3.0, 4.0], &[1.0, 2.0]), Some(0.0));
        assert_eq!(auroc(&[5.0, 5.0], &[5.0]), Some(0.5));
        // Of (1,2) (3,2) (1,3) (3,3): in order, not, in order, equal.
        assert_eq!(auroc(&[1.0, 3.0], &[2.0, 3.0]), Some(2.5 / 4.0));
        assert_eq!(auroc(&[], &[1.0]), None);
    }

    #[test]
    fn correlation_is_one_on_a_line_and_none_for_a_constant() {
        let line = [(1.0, 5.0), (2.0, 7.0), (4.0, 11.0)];
        assert!((correlation(&line).unwrap() - 1.0).abs() < 1e-12);
        let falling = line.map(|(x, y)| (x, -y));
        assert!((correlation(&falling).unwrap() + 1.0).abs() < 1e-12);
        assert_eq!(correlation(&[(1.0, 2.0), (1.0, 3.0)]), None);
    }

    #[test]
    fn calibration_has_equal_bins_in_the_order_of_what_was_expected() {
        // Expected 0 to 52 in a shuffled order, actual twice that: no bin may mix.
        let pairs: Vec<(f64, f64)> = (0..53)
            .map(|i| f64::from(i * 20 % 53))
            .map(|x| (x, 2.0 * x))
            .collect();
        let bins = calibration(pairs).unwrap();
        let counts: Vec<usize> = bins.iter().map(|bin| bin.count).collect();
        assert_eq!(counts, [10, 11, 10, 11, 11]);
        let first = Bin {
            count: 10,
            sigma_rot_mean_deg: 4.5,
            rot_mean_deg: 9.0,
        };
        assert_eq!(bins[0], first);
        assert_eq!(calibration(vec![(1.0, 1.0); 49]), None);
    }
}
