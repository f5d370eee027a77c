//! What many outcomes amount to.

use crate::statistics::{
    self, CALIBRATION_BINS, RELIABILITY_BINS, auroc, correlation, mean, median,
};
use mvtop_core::prediction::Sigma;
use serde::Serialize;

use super::bounds::Bounds;
use super::outcome::{Errors, Outcome};
use super::right::{self, ByConfidence, Right};

/// A rotation that is off by more is taken for a wrong one rather than an inexact one.
const WRONG_DEG: f64 = 30.0;

/// The fewest poses in a bin of the calibration whose means say something.
const LEAST_IN_BIN: usize = 10;

/// What many outcomes amount to. Means are over the found objects, null where there is none.
#[derive(Debug, Serialize)]
pub struct Summary {
    views: usize,
    /// Samples.
    pairs: usize,
    /// Objects of the truth for which there is a predicted pose of their class within a diameter.
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
    /// What counts as right.
    #[serde(flatten)]
    pub bounds: Bounds,
    #[serde(flatten)]
    right: Right,
    /// Share of the found objects whose rotation is off by at most `resolved_deg`.
    resolved_share: Option<f64>,
    /// How well the expected rotation error tells resolved poses from others, see [`auroc`].
    sigma_rot_auroc: Option<f64>,
    /// Pearson's, between expected and actual rotation error.
    sigma_rot_correlation: Option<f64>,
    /// Poses in bins of equal count, least expected rotation error first; null for few poses.
    calibration: Option<Vec<Bin>>,
    /// How well the confidence tells right poses from others, see [`auroc`].
    confidence_auroc: Option<f64>,
    /// Expected calibration error: how far, in the mean over [`Self::reliability`], the share of right
    /// poses is from the confidence.
    confidence_ece: Option<f64>,
    /// Poses in bins of equal count, least confidence first; null for few poses.
    reliability: Option<Vec<Reliability>>,
    /// What `--min-confidence` would leave; null where poses come without.
    by_confidence: Option<Vec<ByConfidence>>,
}

/// Confidences of some poses, and how many of these are right.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reliability {
    count: usize,
    confidence_mean: f64,
    /// Share of right poses.
    right_share: f64,
}

/// Expected and actual rotation errors of some poses.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bin {
    count: usize,
    sigma_rot_mean_deg: f64,
    rot_mean_deg: f64,
}

impl Summary {
    /// The summary of some outcomes.
    ///
    /// - `pairs`: number of samples
    /// - `extra`: confidences of predicted objects that no outcome is about
    pub fn new(
        views: usize,
        pairs: usize,
        extra: &[Option<f64>],
        outcomes: &[Outcome],
        bounds: Bounds,
    ) -> Self {
        let Bounds { resolved_deg, .. } = bounds;
        let found: Vec<Errors> = outcomes.iter().filter_map(Outcome::errors).collect();
        let all = |value: &dyn Fn(&Errors) -> f64| found.iter().map(value).collect::<Vec<f64>>();
        let mean_of = |value: &dyn Fn(&Errors) -> f64| mean(&all(value));
        let rotations = all(&|e| e.rot_deg);
        // Results of other programs say nothing of what they expect.
        let sure = outcomes
            .iter()
            .filter_map(|outcome| Some((outcome.errors()?, outcome.sigma?)));
        let (of_sure, sigmas): (Vec<Errors>, Vec<Sigma>) = sure.unzip();
        let expected: Vec<f64> = sigmas.iter().map(|sigma| sigma.rot_deg).collect();
        let actual: Vec<f64> = of_sure.iter().map(|errors| errors.rot_deg).collect();
        let open: Vec<bool> = actual.iter().map(|&rot| rot > resolved_deg).collect();
        let judged = outcomes.iter().filter_map(|outcome| {
            let right = outcome.errors()?.within(&bounds);
            Some((outcome.confidence?, right))
        });
        let (confidences, rights): (Vec<f64>, Vec<bool>) = judged.unzip();
        let reliability = reliability(&confidences, &rights);
        Self {
            views,
            pairs,
            found: found.len(),
            rot_mean_deg: mean(&rotations),
            rot_median_deg: median(&rotations),
            share_over_30_deg: mean_of(&|e| f64::from(u8::from(e.rot_deg > WRONG_DEG))),
            add_mean_m: mean_of(&|e| e.add_m.unwrap_or(f64::NAN)).filter(|mean| mean.is_finite()),
            trans_mean_m: mean_of(&|e| e.trans_m),
            sigma_rot_mean_deg: mean(&expected),
            sigma_t_mean_m: mean(&sigmas.iter().map(|sigma| sigma.t_m).collect::<Vec<_>>()),
            extra: extra.len(),
            bounds,
            right: Right::new(
                outcomes.iter().map(Outcome::errors),
                found.len() + extra.len(),
                &bounds,
            ),
            resolved_share: mean_of(&|e| f64::from(u8::from(e.rot_deg <= resolved_deg))),
            sigma_rot_auroc: auroc(&expected, &open),
            sigma_rot_correlation: correlation(&expected, &actual),
            calibration: calibration(&expected, &actual),
            confidence_auroc: auroc(&confidences, &rights),
            confidence_ece: reliability.as_deref().map(calibration_error),
            reliability,
            by_confidence: right::by_confidence(outcomes, extra, &bounds),
        }
    }
}

impl Summary {
    /// How many poses are right of all and of those of at least some confidence, in the columns
    /// [`COLUMNS`](super::COLUMNS).
    pub fn by_confidence(&self) -> Vec<[String; 5]> {
        let predicted = self.found + self.extra;
        right::table(&self.right, predicted, self.by_confidence.as_deref())
    }

    /// For people.
    ///
    /// - `of`: what was predicted at once, `samples`
    /// - `objects`: number of objects of the truth
    pub fn text(&self, of: &str, objects: usize) -> String {
        let number = |x: Option<f64>, unit: f64, digits: usize| {
            x.map_or("–".into(), |x| format!("{:.digits$}", x * unit))
        };
        let (deg, mm) = (|x| number(x, 1.0, 2), |x| number(x, 1e3, 1));
        let Self {
            views,
            pairs,
            found,
            extra,
            bounds,
            right,
            ..
        } = self;
        let Bounds {
            resolved_deg,
            right_deg,
            right_mm,
        } = bounds;
        format!(
            "{of}: {pairs}, views: {views}, found: {found} of {objects} objects, \
             false positives: {extra}\n\n\
             error                 mean    median    expected\n\
             rotation, °       {:>8}{:>10}{:>12}\n\
             translation, mm   {:>8}{:>22}\n\
             ADD, mm           {:>8}\n\n\
             within {right_deg}° and {right_mm} mm: {} of {} predicted, precision {} %, \
             recall {} %\n\
             rotation within {resolved_deg}°: {} % of the found, over {WRONG_DEG}°: {} %\n\
             expected and actual rotation error: AUROC {}, correlation {}\n\
             confidence: AUROC {}, calibration error {}{}",
            deg(self.rot_mean_deg),
            deg(self.rot_median_deg),
            deg(self.sigma_rot_mean_deg),
            mm(self.trans_mean_m),
            mm(self.sigma_t_mean_m),
            mm(self.add_mean_m),
            right.right,
            found + extra,
            number(right.precision, 100.0, 1),
            number(right.recall, 100.0, 1),
            number(self.resolved_share, 100.0, 1),
            number(self.share_over_30_deg, 100.0, 1),
            number(self.sigma_rot_auroc, 1.0, 3),
            number(self.sigma_rot_correlation, 1.0, 2),
            number(self.confidence_auroc, 1.0, 3),
            number(self.confidence_ece, 1.0, 3),
            right::text(&self.by_confidence()),
        )
    }
}

/// `None` for too few poses.
///
/// - `expected`, `actual`: rotation errors, degrees
fn calibration(expected: &[f64], actual: &[f64]) -> Option<Vec<Bin>> {
    let bins = statistics::calibration(expected, actual, CALIBRATION_BINS);
    let bin = |bin: statistics::Bin| Bin {
        count: bin.count,
        sigma_rot_mean_deg: bin.expected,
        rot_mean_deg: bin.actual,
    };
    (expected.len() >= CALIBRATION_BINS * LEAST_IN_BIN).then(|| bins.into_iter().map(bin).collect())
}

/// `None` for too few poses.
///
/// - `rights`: whether each pose is right
fn reliability(confidences: &[f64], rights: &[bool]) -> Option<Vec<Reliability>> {
    let shares: Vec<f64> = rights
        .iter()
        .map(|&right| f64::from(u8::from(right)))
        .collect();
    let bins = statistics::calibration(confidences, &shares, RELIABILITY_BINS);
    let bin = |bin: statistics::Bin| Reliability {
        count: bin.count,
        confidence_mean: bin.expected,
        right_share: bin.actual,
    };
    let enough = confidences.len() >= RELIABILITY_BINS * LEAST_IN_BIN;
    enough.then(|| bins.into_iter().map(bin).collect())
}

fn calibration_error(bins: &[Reliability]) -> f64 {
    let total: usize = bins.iter().map(|bin| bin.count).sum();
    let off = |bin: &Reliability| bin.count as f64 * (bin.confidence_mean - bin.right_share).abs();
    bins.iter().map(off).sum::<f64>() / total as f64
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use mvtop_core::prediction::Timings;

    pub fn off_by(rot_deg: f64, trans_m: f64, sigma_rot_deg: f64) -> Outcome {
        Outcome {
            sample: "a".into(),
            object: 0,
            class: "ball".into(),
            views: 2,
            found: true,
            rot_deg: Some(rot_deg),
            trans_m: Some(trans_m),
            add_m: Some(trans_m / 2.0),
            by_symmetry: vec![],
            score: Some(0.9),
            sigma: Some(Sigma {
                rot_deg: sigma_rot_deg,
                t_m: 0.5,
            }),
            confidence: None,
            cameras: vec![],
            t_world_obj: None,
            timings_ms: Timings::default(),
        }
    }

    pub fn bounds(resolved_deg: f64) -> Bounds {
        Bounds {
            resolved_deg,
            right_deg: 5.0,
            right_mm: 5.0,
        }
    }

    pub fn missed() -> Outcome {
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
        let summary = Summary::new(2, 5, &[None; 3], &outcomes, bounds(10.0));
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
        let json =
            serde_json::to_value(Summary::new(2, 1, &[], &[missed()], bounds(15.0))).unwrap();
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
    fn confidence_is_compared_with_the_share_of_right_poses() {
        // Half of them is said to be right with 0.9, of which 0.8 are; the others with 0.3, of which
        // 0.4 are.
        let outcome = |i: usize| {
            let (confidence, right) = match i < 100 {
                true => (0.9, i % 10 < 8),
                false => (0.3, i % 10 < 4),
            };
            Outcome {
                confidence: Some(confidence),
                ..off_by(if right { 1.0 } else { 9.0 }, 0.001, 3.0)
            }
        };
        let outcomes: Vec<Outcome> = (0..200).map(outcome).collect();
        let summary = Summary::new(2, 200, &[], &outcomes, bounds(15.0));
        assert!((summary.confidence_ece.unwrap() - 0.1).abs() < 1e-9);
        // Right and wrong: 80 and 20 surer ones, 40 and 60 others. Of pairs, 80 * 60 are in order,
        // and 80 * 20 + 40 * 60 are even.
        let expected = (80.0 * 60.0 + (80.0 * 20.0 + 40.0 * 60.0) / 2.0) / (120.0 * 80.0);
        assert!((summary.confidence_auroc.unwrap() - expected).abs() < 1e-9);
        let few = Summary::new(2, 99, &[], &outcomes[..99], bounds(15.0));
        assert!(few.reliability.is_none() && few.confidence_ece.is_none());
    }

    #[test]
    fn calibration_is_null_for_few_poses() {
        let x = [1.0; 50];
        assert_eq!(calibration(&x, &x).unwrap().len(), 5);
        assert_eq!(calibration(&x[1..], &x[1..]), None);
    }
}
