//! The probability that a pose is right, from all that is known of it.
//!
//! A logistic regression over a few numbers, the [`evidence`], and their squares; of a pose that one
//! view alone shows, another one. Which weights they have is found on scenes that the network was not
//! trained on (`training/mvtop_train/training/confidence.py`), and stands in the bundle: another
//! network, other parts and other images err otherwise.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::prediction::{ObjectPose, RigConsistency};

/// What the evidence is called, in its order.
pub const EVIDENCE: [&str; 13] = [
    "expected_rotation",
    "expected_translation",
    "first_of_hypotheses",
    "views",
    "supported",
    "residual_px",
    "overlap",
    "explained",
    "explained_least",
    "print",
    "deviation",
    "expected_before",
    "object_deviation",
];

/// How far off views are said to be at most: where one shows something else, it may be any number.
const MOST_DEVIATION: f64 = 50.0;

/// Largest weight that is believed; the odds of far larger ones may be no number.
const MOST_WEIGHT: f64 = 1e6;

/// How a bundle judges its poses.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Confidence {
    /// Largest angle to the true rotation of a pose that is right, degrees.
    pub within_deg: f64,
    /// Largest distance to the true position, metres.
    pub within_m: f64,
    /// Of poses that several views show, and of others where `one_view` is left out.
    #[serde(flatten)]
    pub odds: Odds,
    /// Of poses that one view alone shows.
    pub one_view: Option<Odds>,
}

/// How the odds that a pose is right follow from the [`EVIDENCE`].
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
pub struct Odds {
    /// Their logarithm where all evidence is 0.
    pub bias: f64,
    /// What each piece of evidence adds to that for each of its units, by name; none where it is left
    /// out.
    pub weights: BTreeMap<String, f64>,
    /// The same for its square.
    #[serde(default)]
    pub squares: BTreeMap<String, f64>,
    /// Between what evidence was when the weights were found, by name; beyond, it says no more.
    #[serde(default)]
    pub limits: BTreeMap<String, [f64; 2]>,
}

impl Odds {
    /// Their logarithm.
    fn of(&self, evidence: &[f64; EVIDENCE.len()]) -> f64 {
        let each = EVIDENCE.iter().zip(evidence).map(|(&name, &value)| {
            let weight = |of: &BTreeMap<String, f64>| of.get(name).copied().unwrap_or(0.0);
            let [least, most] = self.limits.get(name).copied().unwrap_or([value; 2]);
            let value = value.max(least).min(most);
            (weight(&self.weights) + weight(&self.squares) * value) * value
        });
        self.bias + each.sum::<f64>()
    }

    /// The text is the problem.
    fn check(&self) -> Result<(), String> {
        let names = [&self.weights, &self.squares].map(|weights| weights.keys());
        let mut names = names.into_iter().flatten().chain(self.limits.keys());
        if let Some(name) = names.find(|name| !EVIDENCE.contains(&name.as_str())) {
            return Err(format!(
                "confidence has a weight for {name:?}, expected some of {EVIDENCE:?}"
            ));
        }
        let weights = [&self.weights, &self.squares].map(|weights| weights.values());
        let mut weights = weights.into_iter().flatten().chain([&self.bias]);
        let bounded = weights.all(|weight| weight.abs() <= MOST_WEIGHT);
        let mut limits = self.limits.values();
        if bounded && limits.all(|[least, most]| least <= most) {
            return Ok(());
        }
        Err(format!(
            "confidence has {self:?}, expected weights of {MOST_WEIGHT:e} at most, and limits in order"
        ))
    }
}

impl Confidence {
    /// The probability that a pose is within the bounds; `None` of one that was not refined.
    pub fn of(&self, object: &ObjectPose, rig: Option<&RigConsistency>) -> Option<f64> {
        let evidence = evidence(object, rig)?;
        let one_view = self.one_view.as_ref().filter(|_| shown_by(object) < 2);
        let odds = one_view.unwrap_or(&self.odds).of(&evidence);
        Some(1.0 / (1.0 + (-odds).exp()))
    }

    /// The text is the problem.
    pub(crate) fn check(&self) -> Result<(), String> {
        self.odds.check()?;
        self.one_view.as_ref().map_or(Ok(()), Odds::check)?;
        let above_zero = |x: f64| x.is_finite() && x > 0.0;
        if above_zero(self.within_deg) && above_zero(self.within_m) {
            return Ok(());
        }
        let bounds = [self.within_deg, self.within_m];
        Err(format!(
            "confidence is of poses within {bounds:?}, expected bounds above 0"
        ))
    }
}

/// The number of views that have a box of the object.
fn shown_by(object: &ObjectPose) -> usize {
    let seen = object.cameras.iter().filter(|seen| seen.bbox.is_some());
    seen.count()
}

/// What speaks for and against a pose, in the order of [`EVIDENCE`]: logarithms of the expected errors
/// (degrees, mm), the probability of this hypothesis among the others, the logarithm of the number of
/// views with a box, the refinement's numbers ([`crate::prediction::Refinement`]), how far the views are
/// from one pose, of all objects (by which the rig is judged) and of this one (logarithms of one more),
/// and that of the rotation error that the network expected before refinement.
/// `None` of a pose that was not refined.
pub fn evidence(
    object: &ObjectPose,
    rig: Option<&RigConsistency>,
) -> Option<[f64; EVIDENCE.len()]> {
    let refinement = object.refinement?;
    let first = object.hypotheses.first();
    let deviation = |of: Option<f64>| of.unwrap_or(0.0).min(MOST_DEVIATION).ln_1p();
    let log = |error: f64| error.max(1e-3).ln();
    Some([
        log(object.sigma.rot_deg),
        log(1e3 * object.sigma.t_m),
        first.map_or(1.0, |hypothesis| hypothesis.probability),
        (shown_by(object).max(1) as f64).ln(),
        refinement.supported,
        refinement.residual_px,
        refinement.overlap,
        refinement.explained,
        refinement.explained_least,
        refinement.print.unwrap_or(0.0),
        deviation(rig.map(|rig| rig.deviation)),
        log(refinement.sigma_before.rot_deg),
        deviation(object.deviation),
    ])
}

/// What to do with a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It is right with at least the probability that was asked for.
    Accept,
    /// The views leave it open: it may be another one of several, or one view alone shows it.
    NeedAnotherView,
    /// It is probably wrong, though it is settled.
    Reject,
}

/// Of several hypotheses, the first is settled if it is this probable.
const SETTLED: f64 = 0.9;

impl Verdict {
    /// - `least`: confidence that is asked for; a pose without any is accepted by 0 alone
    pub fn of(object: &ObjectPose, least: f64) -> Self {
        if object.confidence.unwrap_or(0.0) >= least {
            return Self::Accept;
        }
        let first = object.hypotheses.first();
        let open = first.is_some_and(|hypothesis| hypothesis.probability < SETTLED);
        match open || shown_by(object) < 2 {
            true => Self::NeedAnotherView,
            false => Self::Reject,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prediction::{CameraPose, Hypothesis, Refinement, Sigma};
    use crate::symmetry::Symmetry;
    use nalgebra::Isometry3;

    /// Seen by some views, with other hypotheses next to the first.
    fn object(views: usize, first: f64, confidence: f64) -> ObjectPose {
        let pose = Isometry3::identity();
        let sigma = Sigma {
            rot_deg: 1.0,
            t_m: 0.001,
        };
        let seen = |camera| CameraPose {
            camera,
            cam_from_obj: pose,
            bbox: Some([0., 0., 9., 9.].into()),
        };
        ObjectPose {
            class: "ball".into(),
            class_id: 1,
            score: 1.0,
            ref_from_obj: pose,
            world_from_obj: pose,
            sigma,
            deviation: None,
            support: None,
            refinement: Some(Refinement {
                accepted: true,
                supported: 0.5,
                residual_px: 2.0,
                overlap: 0.25,
                explained: 0.5,
                explained_least: 0.125,
                print: None,
                sigma_before: sigma,
            }),
            confidence: Some(confidence),
            hypotheses: vec![Hypothesis {
                world_from_obj: pose,
                sigma,
                probability: first,
            }],
            next_view: None,
            symmetry: Symmetry::default(),
            cameras: (0..views).map(seen).collect(),
        }
    }

    fn odds(weights: &[(&str, f64)]) -> Odds {
        let weights = weights.iter().map(|(name, x)| ((*name).to_owned(), *x));
        Odds {
            bias: 1.0,
            weights: weights.collect(),
            ..Odds::default()
        }
    }

    fn confidence(weights: &[(&str, f64)]) -> Confidence {
        Confidence {
            within_deg: 5.0,
            within_m: 0.005,
            odds: odds(weights),
            one_view: None,
        }
    }

    #[test]
    fn odds_are_summed_by_name() {
        let weights = [("supported", 2.0), ("residual_px", -1.0), ("views", 10.0)];
        // 1 + 2 * 0.5 - 2 = 0: even odds, of one view.
        let even = confidence(&weights).of(&object(1, 1.0, 0.0), None).unwrap();
        assert!((even - 0.5).abs() < 1e-12);
        let two = confidence(&weights).of(&object(2, 1.0, 0.0), None).unwrap();
        assert!((two - 1.0 / (1.0 + 2f64.powi(-10))).abs() < 1e-3, "{two}");
        let doubted = RigConsistency {
            px: 3.0,
            deviation: 1e9,
            worst_camera: None,
        };
        let by_rig = confidence(&[("deviation", -1.0)]);
        let least = by_rig.of(&object(2, 1.0, 0.0), Some(&doubted)).unwrap();
        assert!((least - 1.0 / (1.0 + 51.0 / 1f64.exp())).abs() < 1e-12);
        let by_object = confidence(&[("object_deviation", -1.0)]);
        let mut off = object(2, 1.0, 0.0);
        off.deviation = Some(1.0);
        let half = by_object.of(&off, None).unwrap();
        assert!((half - 1.0 / (1.0 + 2.0 / 1f64.exp())).abs() < 1e-12);
    }

    #[test]
    fn squares_count_within_limits() {
        // 0.5 supported, residual of 2 px: 1 + 4 * 0.5^2 - 2 = 0.
        let mut bent = confidence(&[("residual_px", -1.0)]);
        bent.odds.squares.insert("supported".to_owned(), 4.0);
        let even = bent.of(&object(2, 1.0, 0.0), None).unwrap();
        assert!((even - 0.5).abs() < 1e-12);
        // As if the residual were 1 px, and 0.75 supported: 1 + 4 * 0.75^2 - 1.
        let limits = [("residual_px", [0.0, 1.0]), ("supported", [0.75, 1.0])];
        bent.odds.limits = limits.map(|(name, x)| (name.to_owned(), x)).into();
        let limited = bent.of(&object(2, 1.0, 0.0), None).unwrap();
        assert!((limited - 1.0 / (1.0 + (-2.25_f64).exp())).abs() < 1e-12);
    }

    #[test]
    fn one_view_has_its_own_odds() {
        let mut both = confidence(&[]);
        both.one_view = Some(odds(&[("residual_px", -0.5)]));
        let said = |views| both.of(&object(views, 1.0, 0.0), None).unwrap();
        assert!((said(1) - 0.5).abs() < 1e-12);
        for views in [2, 3] {
            assert!((said(views) - 1.0 / (1.0 + (-1.0_f64).exp())).abs() < 1e-12);
        }
    }

    #[test]
    fn pose_that_was_not_refined_has_none() {
        let mut object = object(2, 1.0, 0.0);
        object.refinement = None;
        assert_eq!(confidence(&[]).of(&object, None), None);
    }

    #[test]
    fn what_is_open_needs_another_view_and_what_is_settled_is_rejected() {
        assert_eq!(Verdict::of(&object(2, 0.5, 0.95), 0.9), Verdict::Accept);
        assert_eq!(Verdict::of(&object(2, 1.0, 0.85), 0.9), Verdict::Reject);
        let open = Verdict::NeedAnotherView;
        assert_eq!(Verdict::of(&object(2, 0.5, 0.85), 0.9), open);
        assert_eq!(Verdict::of(&object(1, 1.0, 0.85), 0.9), open);
    }

    #[test]
    fn numbers_that_say_nothing_are_refused() {
        assert_eq!(confidence(&[("views", 1.0)]).check(), Ok(()));
        let unknown = confidence(&[("weather", 1.0)]).check().unwrap_err();
        assert!(unknown.contains("\"weather\"") && unknown.contains("\"views\""));
        assert!(confidence(&[("views", f64::NAN)]).check().is_err());
        // Two of these may cancel to no number.
        assert!(confidence(&[("views", 1e300)]).check().is_err());
        let no_bound = Confidence {
            within_m: 0.0,
            ..confidence(&[])
        };
        assert!(no_bound.check().is_err());
        let mut of_one_view = confidence(&[]);
        of_one_view.one_view = Some(odds(&[("weather", 1.0)]));
        assert!(of_one_view.check().is_err());
        let mut squared = confidence(&[]);
        squared.odds.squares.insert("views".to_owned(), f64::NAN);
        assert!(squared.check().is_err());
        let mut limited = confidence(&[]);
        limited.odds.limits.insert("views".to_owned(), [1.0, 0.0]);
        assert!(limited.check().is_err());
    }
}
