//! Whether two cameras show the same objects.

use std::collections::BTreeMap;

use super::instance::Instance;
use super::pipeline::Pipeline;
use crate::config::RigConfig;
use crate::scorer::ViewEvidence;

/// The two cameras that are least likely to show the same objects.
pub struct Contradiction {
    /// Log-likelihood ratio of a wrong rig.
    pub ratio: f64,
    /// Indices of the views.
    pub views: [usize; 2],
    /// What the two show.
    pub counts: Counts,
    /// The view of the two that contradicts all others most; `None` of two views.
    pub worst: Option<usize>,
}

/// Objects that two views show.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Objects that both show at one pose.
    pub confirmed: usize,
    /// Objects of which one has evidence, and the other should show them but does not.
    pub unconfirmed: usize,
}

impl Counts {
    fn ratio(self, config: &RigConfig) -> f64 {
        let [of_true, of_wrong] = [config.unconfirmed_true, config.unconfirmed_wrong];
        let confirmed = ((1.0 - of_wrong) / (1.0 - of_true)).ln();
        let unconfirmed = (of_wrong / of_true).ln();
        confirmed * self.confirmed as f64 + unconfirmed * self.unconfirmed as f64
    }
}

impl Contradiction {
    /// `None` of fewer than two views.
    pub fn find(pipeline: &Pipeline, instances: &[Instance]) -> Option<Self> {
        let config = &pipeline.config().rig;
        let count = pipeline.views.len();
        let mut all = BTreeMap::new();
        for (a, b) in pairs(count) {
            let mut counts = Counts::default();
            for instance in instances {
                match shown(pipeline, instance, a, b) {
                    Some(true) => counts.confirmed += 1,
                    Some(false) => counts.unconfirmed += 1,
                    None => {}
                }
            }
            all.insert((a, b), counts);
        }
        // Where no two cameras see one object, what each of two finds alone of one class is unconfirmed.
        if all.values().all(|counts| counts.confirmed == 0) {
            for ((a, b), counts) in &mut all {
                let alone = alone_of_class(pipeline, instances, *a, *b);
                counts.unconfirmed = counts.unconfirmed.max(alone);
            }
        }
        let ratio = |counts: &Counts| counts.ratio(config);
        let (&(a, b), &counts) = all
            .iter()
            .max_by(|p, q| ratio(p.1).total_cmp(&ratio(q.1)))?;
        let of_view = |view: usize| {
            let with = all
                .iter()
                .filter(|(pair, _)| pair.0 == view || pair.1 == view);
            with.map(|(_, counts)| ratio(counts)).sum::<f64>()
        };
        let worst = if of_view(a) > of_view(b) { a } else { b };
        Some(Self {
            ratio: counts.ratio(config),
            views: [a, b],
            counts,
            worst: (count > 2).then_some(worst),
        })
    }
}

fn pairs(count: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..count).flat_map(move |a| (a + 1..count).map(move |b| (a, b)))
}

/// Whether two views show an instance at one pose; `None` where they need not.
fn shown(pipeline: &Pipeline, instance: &Instance, a: usize, b: usize) -> Option<bool> {
    let [in_a, in_b] = [a, b].map(|view| instance.detections[view].is_some());
    let unconfirmed = match (in_a, in_b) {
        (true, true) => {
            let confidence = match is_calibrated(pipeline) {
                true => instance.confidence(),
                false => 1.0,
            };
            // More probably right than wrong.
            if confidence >= 0.5 {
                return Some(true);
            }
            confidence < pipeline.config().search.min_confidence
                && (is_evident(pipeline, instance, a) || is_evident(pipeline, instance, b))
        }
        (true, false) => is_alone(pipeline, instance, a) && is_missing(pipeline, instance, b),
        (false, true) => is_alone(pipeline, instance, b) && is_missing(pipeline, instance, a),
        (false, false) => false,
    };
    unconfirmed.then_some(false)
}

/// Confidences and log-odds of other bundles are no probabilities: their detections count alone.
fn is_calibrated(pipeline: &Pipeline) -> bool {
    pipeline.estimator.bundle.scorer.is_some()
}

/// Whether the image of one view fits the best pose. The detector finds unknown things as well, whose
/// images do not fit the mesh.
fn is_evident(pipeline: &Pipeline, instance: &Instance, view: usize) -> bool {
    !is_calibrated(pipeline)
        || evidence(pipeline, instance, view).is_some_and(|(_, log_odds)| log_odds > 0.0)
}

/// What one view shows of an instance at its best pose, and the log-odds by it.
fn evidence<'a>(
    pipeline: &Pipeline,
    instance: &'a Instance,
    view: usize,
) -> Option<(&'a ViewEvidence, f64)> {
    let best = instance.best()?;
    let seen = best.scored.views.iter().find(|one| one.view == view)?;
    let scorer = pipeline.estimator.scorer();
    Some((seen, scorer.view_log_odds(best.refinement.is_some(), seen)))
}

/// Whether a view detected an instance by itself, and has evidence of it.
fn is_alone(pipeline: &Pipeline, instance: &Instance, view: usize) -> bool {
    let threshold = f64::from(pipeline.estimator.bundle.detector.score_threshold);
    let detected = instance.detections[view].is_some_and(|one| one.score >= threshold);
    detected && is_evident(pipeline, instance, view)
}

/// Whether a view that did not detect an instance should show it, but has no evidence of it.
fn is_missing(pipeline: &Pipeline, instance: &Instance, view: usize) -> bool {
    let faintest = f64::from(pipeline.estimator.bundle.detector.faintest());
    evidence(pipeline, instance, view).is_some_and(|(seen, log_odds)| {
        seen.visible >= pipeline.config().search.min_in_image
            && seen.detector < faintest
            && log_odds <= 0.0
    })
}

/// Number of objects of classes that two views both find, each alone.
fn alone_of_class(pipeline: &Pipeline, instances: &[Instance], a: usize, b: usize) -> usize {
    let mut counts: BTreeMap<usize, [usize; 2]> = BTreeMap::new();
    for instance in instances.iter().filter(|one| one.views() == 1) {
        for (side, view) in [a, b].into_iter().enumerate() {
            if is_alone(pipeline, instance, view) {
                counts.entry(instance.class).or_default()[side] += 1;
            }
        }
    }
    counts.values().map(|[in_a, in_b]| 2 * in_a.min(in_b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same numbers as in `training/tests/test_calibrate.py`.
    #[test]
    fn ratio_by_hand() {
        let config = RigConfig {
            unconfirmed_true: 0.1,
            unconfirmed_wrong: 0.8,
            ..RigConfig::default()
        };
        let counts = Counts {
            confirmed: 1,
            unconfirmed: 3,
        };
        let by_hand = 3.0 * 8.0_f64.ln() + (2.0_f64 / 9.0).ln();
        assert!((counts.ratio(&config) - by_hand).abs() < 1e-12);
        assert_eq!(Counts::default().ratio(&config), 0.0);
    }
}
