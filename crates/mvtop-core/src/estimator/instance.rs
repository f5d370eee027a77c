//! One physical object on its way through the pipeline, with its candidate poses.

use std::sync::Arc;

use nalgebra::Isometry3;

use super::grouping::distinct;
use super::pnp::Correspondences;
use crate::BBox;
use crate::bundle::Class;
use crate::detect::Detection;
use crate::prediction::{Hypothesis, Refinement, Sigma};
use crate::request::Prior;
use crate::scorer::Scored;

/// One object: what the detector saw of it, and the poses that it may have.
#[derive(Clone)]
pub struct Instance {
    /// Index into the bundle's classes.
    pub class: usize,
    /// `[V]`, by the detector or the user alone: boxes projected from a pose are no detections.
    pub detections: Vec<Option<Detection>>,
    /// The best one first.
    pub candidates: Vec<Candidate>,
    /// Candidates that priors do not allow, where others are allowed: they are not given, and still
    /// speak against these.
    pub excluded: Vec<Candidate>,
}

/// A pose that an object may have.
#[derive(Clone)]
pub struct Candidate {
    /// Object frame to world frame, metres.
    pub world_from_obj: Isometry3<f64>,
    /// The expected error, should the object have this pose.
    pub sigma: Sigma,
    /// The expected error before refinement.
    pub initial_sigma: Sigma,
    /// Probability among the poses that were proposed together.
    pub prior: f64,
    /// `[V]`, the boxes whose crops proposed it, px of each image.
    pub rois: Vec<Option<BBox>>,
    /// Object coordinates of these crops; `None` where the network gives none.
    pub correspondences: Option<Arc<Correspondences>>,
    /// `None` where the class has no mesh or none was wanted.
    pub refinement: Option<Refinement>,
    /// Log-odds that the pose is right, and the evidence that they are made of.
    pub scored: Scored,
}

impl Instance {
    /// - `detections`: by index of the view
    pub fn new(class: usize, detections: Vec<Option<Detection>>) -> Self {
        Self {
            class,
            detections,
            candidates: Vec::new(),
            excluded: Vec::new(),
        }
    }

    /// Probability that not all views that detected the object are wrong, `1 - Π (1 - s)`.
    pub fn score(&self) -> f64 {
        let wrong = self.detections.iter().flatten().map(|one| 1.0 - one.score);
        1.0 - wrong.product::<f64>()
    }

    /// `[V]`, px of each image.
    pub fn boxes(&self) -> Vec<Option<BBox>> {
        let boxes = self.detections.iter().map(|one| one.map(|one| one.bbox));
        boxes.collect()
    }

    /// Number of views in which it was detected.
    pub fn views(&self) -> usize {
        self.detections.iter().flatten().count()
    }

    /// The most probable candidate.
    pub fn best(&self) -> Option<&Candidate> {
        self.candidates.first()
    }

    /// Probability that the best candidate is right: candidates exclude each other.
    pub fn confidence(&self) -> f64 {
        self.probabilities().first().copied().unwrap_or(0.0)
    }

    /// Probability of each candidate, in order: `odds / (1 + sum of odds)`. The odds of excluded ones
    /// are divided by [`Prior::ODDS`].
    pub fn probabilities(&self) -> Vec<f64> {
        let log_odds = self.candidates.iter().map(|one| one.scored.log_odds);
        let excluded = self.excluded.iter().map(|one| one.scored.log_odds);
        let most = log_odds.clone().chain(excluded.clone()).fold(0.0, f64::max);
        let odds: Vec<f64> = log_odds.map(|one| (one - most).exp()).collect();
        let excluded = excluded.map(|one| (one - most).exp() / Prior::ODDS);
        let all = (-most).exp() + odds.iter().sum::<f64>() + excluded.sum::<f64>();
        odds.into_iter().map(|one| one / all).collect()
    }

    /// Puts the most probable candidate first.
    pub fn sort(&mut self) {
        self.candidates
            .sort_by(|a, b| b.scored.log_odds.total_cmp(&a.scored.log_odds));
    }

    /// Adds candidates; of those within `merge_deg` of a better one, but for symmetries, none stays.
    pub fn add(&mut self, new: Vec<Candidate>, class: &Class, merge_deg: f64, most: usize) {
        self.candidates.extend(new);
        self.sort();
        let all = std::mem::take(&mut self.candidates);
        let (pose, symmetry) = (|one: &Candidate| one.world_from_obj, &class.symmetry);
        self.candidates = distinct(all, pose, symmetry, class.diameter_m, merge_deg, most);
    }

    /// The candidates as they are reported: shares of their odds, those of at least 2 %.
    pub fn hypotheses(&self) -> Vec<Hypothesis> {
        const LEAST: f64 = 0.02;
        let odds = self.candidates.iter().map(|one| one.scored.log_odds);
        let most = odds.clone().fold(f64::NEG_INFINITY, f64::max);
        let odds: Vec<f64> = odds.map(|one| (one - most).exp()).collect();
        let sum: f64 = odds.iter().sum();
        let kept = self.candidates.iter().zip(&odds);
        let kept = kept.filter(|(_, odds)| **odds / sum >= LEAST);
        let mut kept: Vec<Hypothesis> = kept
            .map(|(one, odds)| Hypothesis {
                world_from_obj: one.world_from_obj,
                sigma: one.sigma,
                probability: odds / sum,
            })
            .collect();
        let sum: f64 = kept.iter().map(|one| one.probability).sum();
        kept.iter_mut().for_each(|one| one.probability /= sum);
        kept
    }
}
