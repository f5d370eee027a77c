//! Other matches of boxes across views, for objects whose poses are doubtful.
//!
//! Boxes of identical objects can fit each other by their lines of sight alone. Where they are matched
//! wrongly, no pose fits all images, so poses tell which match is right.

use super::detections;
use super::instance::Instance;
use super::pipeline::{Clock, Pipeline};
use crate::Result;
use crate::detect::Detection;

impl Pipeline<'_> {
    /// Tries other matches of the boxes of doubtful instances, and keeps the most probable ones.
    pub(super) fn rematch(&self, instances: &mut Vec<Instance>, clock: &mut Clock) -> Result<()> {
        let (bundle, search) = (&self.estimator.bundle, &self.config().search);
        // Without calibration no confidence tells what is doubtful.
        if self.options.boxes.is_some() || bundle.scorer.is_none() {
            return Ok(());
        }
        let is_doubtful =
            |one: &mut Instance| one.views() > 0 && one.confidence() < search.doubtful;
        let mut all: Vec<Instance> = instances.extract_if(.., is_doubtful).collect();
        let mut others = self.other_matches(&all);
        self.first_candidates(&mut others, clock)?;
        all.extend(others);
        let kept = most_probable(&all);
        let mut left = self.left_over(&all, &kept);
        self.first_candidates(&mut left, clock)?;
        let all = all.into_iter().enumerate();
        instances.extend(all.filter_map(|(index, one)| kept.contains(&index).then_some(one)));
        instances.extend(left);
        Ok(())
    }

    /// Instances of other matches of these instances' boxes, at most `search.max_instances`.
    fn other_matches(&self, doubtful: &[Instance]) -> Vec<Instance> {
        let (bundle, config) = (&self.estimator.bundle, self.config());
        let radii = &self.estimator.radii;
        let views = &self.views;
        let mut others = detections::rematched(bundle, &config.association, radii, views, doubtful);
        others.retain(|one| one.views() >= self.options.min_views);
        others.truncate(config.search.max_instances);
        others
    }

    /// Boxes of `instances` that none of those kept has, each as an instance of its own.
    pub(super) fn left_over(&self, instances: &[Instance], kept: &[usize]) -> Vec<Instance> {
        let threshold = f64::from(self.estimator.bundle.detector.score_threshold);
        let mut left = Vec::new();
        if self.options.min_views > 1 {
            return left;
        }
        for view in 0..self.views.len() {
            let taken: Vec<Detection> = kept
                .iter()
                .filter_map(|&index| instances[index].detections[view])
                .collect();
            let mut seen: Vec<Detection> = Vec::new();
            for one in instances.iter().filter_map(|one| one.detections[view]) {
                if one.score >= threshold && !taken.contains(&one) && !seen.contains(&one) {
                    seen.push(one);
                }
            }
            left.extend(seen.into_iter().map(|one| {
                let mut boxes = vec![None; self.views.len()];
                boxes[view] = Some(one);
                Instance::new(one.class, boxes)
            }));
        }
        left
    }
}

/// Indices of the instances that keep their boxes: no box is in two of them, and the more probable
/// one of two with the same box is kept.
pub fn most_probable(instances: &[Instance]) -> Vec<usize> {
    let odds = |index: usize| {
        let best = instances[index].best();
        best.map_or(f64::NEG_INFINITY, |best| best.scored.log_odds)
    };
    let mut order: Vec<usize> = (0..instances.len()).collect();
    order.sort_by(|&a, &b| odds(b).total_cmp(&odds(a)));
    let mut kept: Vec<usize> = Vec::new();
    for index in order {
        if !kept
            .iter()
            .any(|&other| share_a_box(&instances[index], &instances[other]))
        {
            kept.push(index);
        }
    }
    kept
}

fn share_a_box(a: &Instance, b: &Instance) -> bool {
    let mut pairs = a.detections.iter().zip(&b.detections);
    pairs.any(|(a, b)| a.is_some() && a == b)
}
