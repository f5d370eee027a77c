//! The log-odds that a pose is right, from the evidence of each view.
//!
//! Each view that should show the object at a pose gives bounded log-odds by what it shows there; they
//! are added up, less where many views err together, with terms of the pose as a whole. Every term is
//! bounded, so that none outweighs all others. The score ranks candidates, says when to look further,
//! suppresses duplicates, rejects, and is the confidence. Its weights are fitted on held-out scenes
//! (`training/mvtop_train/training/calibrate.py`) and stand in the bundle.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::prediction::{ObjectPose, Sigma};

/// What one view shows of an object at a pose, in order; 0 where there is none of it.
pub const VIEW_TERMS: [&str; 6] = [
    "detector",
    "coordinates",
    "contour",
    "color",
    "mutual_information",
    "texture",
];

/// What is known of a pose as a whole, in order; 0 where nothing is.
pub const POSE_TERMS: [&str; 8] = [
    "prior",
    "expected_rotation",
    "expected_translation",
    "initial_rotation",
    "residual",
    "views",
    "object_deviation",
    "rig_deviation",
];

/// Largest weight of a bundle.
const MAX_WEIGHT: f64 = 1e4;

/// What one view shows of an object at a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewEvidence {
    /// Index of the view among the images.
    pub view: usize,
    /// Share of the object's projection that is inside the image and that no other object hides.
    pub visible: f64,
    /// Greatest score of the detector's map near the center of the projection, 0 to 1.
    pub detector: f64,
    /// Inlier share of the object coordinates over the projection, 0 to 1.
    pub coordinates: f64,
    /// Share of the visible contour that the image shows, 0 to 1.
    pub contour: f64,
    /// How well colors tell the silhouette from what is beside it, 0 to 1.
    pub color: f64,
    /// Mutual information of the object's parts and the colors, bits.
    pub mutual_information: f64,
    /// Correlation with the texture, less that of the texture displaced in the image.
    pub texture: f64,
}

impl ViewEvidence {
    /// In the order of [`VIEW_TERMS`].
    pub fn terms(&self) -> [f64; VIEW_TERMS.len()] {
        [
            self.detector,
            self.coordinates,
            self.contour,
            self.color,
            self.mutual_information,
            self.texture,
        ]
    }
}

/// What is known of a pose as a whole.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PoseEvidence {
    /// Probability among the poses that were proposed together.
    pub prior: f64,
    /// The expected error.
    pub sigma: Sigma,
    /// The expected error before refinement.
    pub initial_sigma: Sigma,
    /// Mean distance of the contour from where the images show it, px.
    pub residual_px: f64,
    /// Number of views that should show the object.
    pub views: usize,
    /// How far the views are from one pose of it, standard deviations; 0 before they are compared.
    pub object_deviation: f64,
    /// The same of the rig as a whole.
    pub rig_deviation: f64,
}

impl PoseEvidence {
    /// In the order of [`POSE_TERMS`]: logarithms.
    pub fn terms(&self, within_deg: f64, within_m: f64) -> [f64; POSE_TERMS.len()] {
        let log = |x: f64, unit: f64| (x / unit).max(1e-3).ln();
        [
            self.prior.max(1e-3).ln(),
            log(self.sigma.rot_deg, within_deg),
            log(self.sigma.t_m, within_m),
            log(self.initial_sigma.rot_deg, within_deg),
            self.residual_px,
            (self.views.max(1) as f64).ln(),
            self.object_deviation.min(50.0).ln_1p(),
            self.rig_deviation.min(50.0).ln_1p(),
        ]
    }
}

/// Log-odds of a pose, with the evidence that they are made of.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scored {
    /// Natural logarithm of the odds that the pose is right.
    pub log_odds: f64,
    /// The same before refinement.
    pub initial_log_odds: f64,
    /// Of the pose as a whole.
    pub pose: PoseEvidence,
    /// The same as the scorer takes it, in the order of [`POSE_TERMS`].
    pub terms: [f64; POSE_TERMS.len()],
    /// Of each view that should show the object.
    pub views: Vec<ViewEvidence>,
}

/// How a bundle scores poses.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Scorer {
    /// Largest angle to the true rotation of a right pose, degrees.
    pub within_deg: f64,
    /// Largest distance to the true position of a right pose, metres.
    pub within_m: f64,
    /// Of refined poses.
    pub refined: Weights,
    /// Of poses that are not refined.
    pub unrefined: Weights,
}

/// Weights of the evidence.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// Log-odds without any evidence.
    pub bias: f64,
    /// Log-odds of a view that shows nothing.
    pub view_bias: f64,
    /// Log-odds of one view for each unit of [`VIEW_TERMS`].
    pub view: BTreeMap<String, f64>,
    /// Log-odds for each unit of [`POSE_TERMS`].
    pub pose: BTreeMap<String, f64>,
    /// Bound of each view's log-odds, and of each term of the pose.
    pub bound: f64,
    /// The views' log-odds are summed over `views ^ correlation`: 0 if they err independently, 1 if
    /// they err together.
    pub correlation: f64,
}

impl Default for Scorer {
    /// For bundles that were not calibrated: ranks candidates, and is no probability.
    fn default() -> Self {
        let weights = |view: &[(&str, f64)]| Weights {
            bias: 0.0,
            view_bias: -3.0,
            view: view.iter().map(|(name, x)| ((*name).into(), *x)).collect(),
            pose: [("prior".to_owned(), 1.0)].into(),
            bound: 20.0,
            correlation: 1.0,
        };
        Self {
            within_deg: 5.0,
            within_m: 0.005,
            // Fitted on 300 pairs of the ball: which of two poses of one object is right.
            refined: weights(&[
                ("coordinates", 10.0),
                ("contour", 14.0),
                ("color", 10.0),
                ("mutual_information", 10.0),
                ("texture", 5.0),
            ]),
            unrefined: weights(&[("coordinates", 10.0), ("detector", 1.0)]),
        }
    }
}

/// `x`, smoothly bounded to plus and minus `bound`.
fn bounded(x: f64, bound: f64) -> f64 {
    bound * (x / bound).tanh()
}

impl Scorer {
    /// The score of a pose; its initial log-odds are its log-odds.
    ///
    /// - `refined`: whether it was refined on the images
    pub fn score(&self, refined: bool, views: Vec<ViewEvidence>, pose: PoseEvidence) -> Scored {
        let weights = self.weights(refined);
        let terms = pose.terms(self.within_deg, self.within_m);
        let of_view = |view: &ViewEvidence| view.visible * weights.of_view(&view.terms());
        let count = (views.len().max(1) as f64).powf(weights.correlation);
        let by_views = views.iter().map(of_view).sum::<f64>() / count;
        let named = POSE_TERMS.iter().zip(&terms);
        let by_pose =
            named.map(|(name, x)| bounded(weight(&weights.pose, name) * x, weights.bound));
        let log_odds = weights.bias + by_views + by_pose.sum::<f64>();
        Scored {
            log_odds,
            initial_log_odds: log_odds,
            pose,
            terms,
            views,
        }
    }

    /// Log-odds of one view by itself.
    pub fn view_log_odds(&self, refined: bool, view: &ViewEvidence) -> f64 {
        self.weights(refined).of_view(&view.terms())
    }

    fn weights(&self, refined: bool) -> &Weights {
        match refined {
            true => &self.refined,
            false => &self.unrefined,
        }
    }

    /// The text is the problem.
    pub(crate) fn check(&self) -> Result<(), String> {
        for weights in [&self.refined, &self.unrefined] {
            weights.check()?;
        }
        let above_zero = |x: f64| x.is_finite() && x > 0.0;
        if above_zero(self.within_deg) && above_zero(self.within_m) {
            return Ok(());
        }
        let bounds = [self.within_deg, self.within_m];
        Err(format!(
            "scorer is of poses within {bounds:?}, expected bounds above 0"
        ))
    }
}

fn weight(weights: &BTreeMap<String, f64>, name: &str) -> f64 {
    weights.get(name).copied().unwrap_or(0.0)
}

impl Weights {
    /// Log-odds of a view.
    fn of_view(&self, terms: &[f64; VIEW_TERMS.len()]) -> f64 {
        let named = VIEW_TERMS.iter().zip(terms);
        let sum: f64 = named.map(|(name, x)| weight(&self.view, name) * x).sum();
        bounded(self.view_bias + sum, self.bound)
    }

    fn check(&self) -> Result<(), String> {
        let known = |names: &BTreeMap<String, f64>, all: &[&str]| {
            let unknown = names.keys().find(|name| !all.contains(&name.as_str()));
            match unknown {
                Some(name) => Err(format!(
                    "scorer has a weight for {name:?}, expected some of {all:?}"
                )),
                None => Ok(()),
            }
        };
        known(&self.view, &VIEW_TERMS)?;
        known(&self.pose, &POSE_TERMS)?;
        let all = self.view.values().chain(self.pose.values());
        let mut all = all.chain([&self.bias, &self.view_bias]);
        if all.all(|x| x.abs() <= MAX_WEIGHT)
            && (1e-3..=MAX_WEIGHT).contains(&self.bound)
            && (0.0..=1.0).contains(&self.correlation)
        {
            return Ok(());
        }
        Err(format!(
            "scorer has {self:?}, expected weights of {MAX_WEIGHT:e} at most, a bound above 0, and a \
             correlation from 0 to 1"
        ))
    }
}

/// What to do with a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It is right with at least the probability that was asked for.
    Accept,
    /// The pose is ambiguous, or one view alone shows the object.
    NeedAnotherView,
    /// It is probably wrong, though it is not ambiguous.
    Reject,
}

impl Verdict {
    /// - `least`: confidence that is asked for; a pose without any is accepted by 0 alone. A pose of
    ///   which other hypotheses leave less is ambiguous
    pub fn of(object: &ObjectPose, least: f64) -> Self {
        if object.confidence.unwrap_or(0.0) >= least {
            return Self::Accept;
        }
        let first = object.hypotheses.first();
        let ambiguous = first.is_some_and(|hypothesis| hypothesis.probability < least);
        let views = object.cameras.iter().filter(|seen| seen.bbox.is_some());
        match ambiguous || views.count() < 2 {
            true => Self::NeedAnotherView,
            false => Self::Reject,
        }
    }
}

#[cfg(test)]
mod tests;
