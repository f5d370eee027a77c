//! Candidates where priors say that objects are.

use super::crops::CropRequest;
use super::instance::{Candidate, Instance};
use super::pipeline::{Clock, Pipeline};
use super::reprojection;
use crate::prediction::Sigma;
use crate::request::Prior;
use crate::scorer::Scored;
use crate::{BBox, Result};

impl Pipeline<'_> {
    /// Proposes each prior to the detected instance that it projects onto, or to a new one that no view
    /// has detected.
    pub(super) fn propose_priors(
        &self,
        instances: &mut Vec<Instance>,
        clock: &mut Clock,
    ) -> Result<()> {
        // Boxes that were given are taken as they are.
        if self.options.boxes.is_some() {
            return Ok(());
        }
        for (class, prior) in self.wanted.priors() {
            let of_class = &self.estimator.bundle.classes[class];
            let least = self.config().search.min_in_image;
            let pose = prior.world_from_obj();
            let shown = reprojection::expected(of_class, &self.views, pose, least);
            let rois: Vec<Option<BBox>> = shown.iter().map(|one| one.map(|one| one.bbox)).collect();
            if rois.iter().all(Option::is_none) {
                continue;
            }
            let index = self.shown_at(instances, class, &rois);
            if index.is_some_and(|index| self.is_done(&instances[index])) {
                continue;
            }
            let proposed = self.of_prior(class, prior, rois, clock)?;
            clock.lap(|timings| &mut timings.propose);
            if proposed.is_empty() {
                continue;
            }
            let index = index.unwrap_or_else(|| {
                instances.push(Instance::new(class, vec![None; self.views.len()]));
                instances.len() - 1
            });
            self.accept(&mut [&mut instances[index]], vec![proposed]);
            clock.lap(|timings| &mut timings.refine);
        }
        Ok(())
    }

    /// The instance of a class whose boxes are where some others are, in every view that has both.
    fn shown_at(
        &self,
        instances: &[Instance],
        class: usize,
        rois: &[Option<BBox>],
    ) -> Option<usize> {
        let overlap = |one: &Instance| {
            let pairs = one.detections.iter().zip(rois);
            let both = pairs.filter_map(|(seen, roi)| Some((*seen)?.bbox.iou(roi.as_ref()?)));
            both.reduce(f64::min)
        };
        let each = instances.iter().enumerate();
        let each = each.filter(|(_, one)| one.class == class);
        let each = each.filter_map(|(index, one)| Some((index, overlap(one)?)));
        let best = each.max_by(|a, b| a.1.total_cmp(&b.1));
        let (index, _) = best.filter(|(_, iou)| *iou >= self.config().search.same_box_iou)?;
        Some(index)
    }

    /// The network's candidates from crops where the prior projects the object, then the prior itself
    /// if it can be refined: unrefined it would be no measurement.
    ///
    /// - `rois`: `[V]`, px of the images
    fn of_prior(
        &self,
        class: usize,
        prior: &Prior,
        rois: Vec<Option<BBox>>,
        clock: &mut Clock,
    ) -> Result<Vec<Candidate>> {
        let request: CropRequest = self.request(0, class, &rois)?;
        let (crops, groups) = self.encoded(vec![request], clock)?;
        let each = std::slice::from_ref(&rois);
        let found = self.network_candidates(&crops, &groups, &[class], each)?;
        let mut candidates: Vec<Candidate> = found.into_iter().flatten().collect();
        let refined =
            self.estimator.refiners[class].is_some() && self.options.refine != Some(false);
        if refined {
            let sigma = Sigma {
                rot_deg: prior.sigma_deg().min(180.0),
                t_m: prior.sigma_m(),
            };
            let correspondences = candidates
                .first()
                .and_then(|one| one.correspondences.clone());
            candidates.push(Candidate {
                world_from_obj: *prior.world_from_obj(),
                sigma,
                initial_sigma: sigma,
                // As one of all that are proposed here.
                prior: 1.0 / (candidates.len() + 1) as f64,
                rois,
                correspondences,
                refinement: None,
                scored: Scored::default(),
            });
        }
        Ok(candidates)
    }
}
