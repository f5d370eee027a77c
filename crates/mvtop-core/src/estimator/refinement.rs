//! Candidates refined on the images, and the evidence of each view for the result.

use rayon::prelude::*;

use super::instance::{Candidate, Instance};
use super::pipeline::Pipeline;
use super::reprojection::{self, Projection};
use crate::bundle::Class;
use crate::cancel;
use crate::consistency::Sight;
use crate::consistency::alone::{Alone, Difference, differences};
use crate::network::DetectorMaps;
use crate::prediction::Refinement;
use crate::refine::{self, Quality};
use crate::scorer::{PoseEvidence, ViewEvidence};

impl Pipeline<'_> {
    /// Refines new candidates of instances on the images and scores them.
    ///
    /// - `proposed`: of each instance
    pub(super) fn refine_and_score(
        &self,
        instances: &[&Instance],
        proposed: Vec<Vec<Candidate>>,
    ) -> Vec<Vec<Candidate>> {
        let cancel = cancel::current();
        let one = |(instance, candidates): (&&Instance, Vec<Candidate>)| {
            let one = |candidate| match cancel.is_asked() {
                true => candidate, // the prediction ends with an error
                false => self.evaluated(instance, candidate),
            };
            candidates.into_par_iter().map(one).collect()
        };
        let each = instances.par_iter().zip(proposed);
        each.map(one).collect()
    }

    fn evaluated(&self, instance: &Instance, mut candidate: Candidate) -> Candidate {
        let class = &self.estimator.bundle.classes[instance.class];
        let refiner = self.estimator.refiners[instance.class].as_ref();
        let refiner = refiner.filter(|_| self.options.refine != Some(false));
        let mut quality = Quality::default();
        self.score(instance, class, &mut candidate, &quality);
        let initial = candidate.scored.log_odds;
        let least = self.config().search.min_initial_log_odds;
        let least = least.filter(|_| self.options.boxes.is_none());
        if let Some(refiner) = refiner.filter(|_| least.is_none_or(|least| initial >= least)) {
            let expected = |view| candidate.scored.views.iter().any(|one| one.view == view);
            let shown: Vec<usize> = (0..self.views.len())
                .filter(|&view| expected(view) || candidate.rois[view].is_some())
                .collect();
            let views: Vec<refine::View> = shown
                .iter()
                .map(|&view| self.views[view].refined())
                .collect();
            let start = &candidate.world_from_obj;
            if let Some(refined) = refiner.refine(&views, start, candidate.sigma) {
                quality = refined.quality;
                for of_view in &mut quality.views {
                    of_view.view = shown[of_view.view];
                }
                candidate.refinement = Some(Refinement {
                    accepted: refined.accepted,
                    contour_inliers: refined.contour_inliers,
                    contour_residual_px: refined.contour_residual_px,
                    color_separation: quality.color_separation(),
                    mutual_information: quality.mutual_information(),
                    mutual_information_min: quality.mutual_information_min(),
                    texture_correlation: quality.texture_correlation(),
                    initial_sigma: candidate.initial_sigma,
                });
                candidate.world_from_obj = match class.symmetry.is_none() {
                    true => refined.world_from_obj,
                    false => class.symmetry.canonical(&refined.world_from_obj),
                };
                candidate.sigma = refined.sigma;
            }
        }
        if candidate.refinement.is_some() {
            self.score(instance, class, &mut candidate, &quality);
        }
        candidate.scored.initial_log_odds = initial;
        candidate
    }

    /// Gathers the evidence of each view for a candidate, and scores it.
    fn score(
        &self,
        instance: &Instance,
        class: &Class,
        candidate: &mut Candidate,
        quality: &Quality,
    ) {
        let scale = self.config().pnp.inlier_scale();
        let coverage = candidate
            .correspondences
            .as_ref()
            .map(|all| all.coverage(&class.points, &candidate.world_from_obj, scale));
        let coverage = coverage.unwrap_or_default();
        let evidence = |(view, projection): (usize, Option<Projection>)| {
            let projection = projection?;
            let shown = quality.views.iter().find(|one| one.view == view);
            let number = |of: fn(&refine::ViewQuality) -> f64| shown.map_or(0.0, of);
            let covered = coverage.iter().find(|(of, _)| *of == view);
            Some(ViewEvidence {
                view,
                visible: projection.share,
                detector: self.detector_score(instance, view, &projection),
                coordinates: covered.map_or(0.0, |(_, share)| *share),
                contour: number(|one| one.contour_inliers),
                color: number(|one| one.color_separation),
                mutual_information: number(|one| one.mutual_information),
                texture: number(|one| one.texture_gain.unwrap_or(0.0)),
            })
        };
        let least = self.config().search.min_in_image;
        let pose = &candidate.world_from_obj;
        let expected = reprojection::expected(class, &self.views, pose, least);
        let views: Vec<_> = expected
            .into_iter()
            .enumerate()
            .filter_map(evidence)
            .collect();
        let pose = PoseEvidence {
            prior: candidate.prior,
            sigma: candidate.sigma,
            initial_sigma: candidate.initial_sigma,
            residual_px: candidate
                .refinement
                .map_or(0.0, |one| one.contour_residual_px),
            views: views.len(),
            object_deviation: 0.0,
            rig_deviation: 0.0,
        };
        let refined = candidate.refinement.is_some();
        let scorer = self.estimator.scorer();
        candidate.scored = scorer.score(refined, views, pose);
    }

    /// The greatest score that the detector gives by itself near the center of a projection, 0 to 1.
    fn detector_score(&self, instance: &Instance, view: usize, projection: &Projection) -> f64 {
        let detected = instance.detections[view]
            .filter(|one| one.bbox.iou(&projection.bbox) >= self.config().search.same_box_iou);
        let by_map = self.maps.as_ref().map_or(0.0, |maps| {
            map_score(
                maps,
                &self.views[view].letterbox,
                view,
                instance.class,
                projection,
            )
        });
        detected.map_or(by_map, |one| one.score.max(by_map))
    }

    /// How far the pose that each view gives by itself is from the one on which all agree best, by
    /// index of the camera; empty for objects without a mesh, or detected in fewer than two views.
    pub(super) fn compared(&self, instance: &Instance) -> Vec<(usize, Difference)> {
        let refiner = self.estimator.refiners[instance.class].as_ref();
        let (Some(refiner), Some(best)) = (refiner, instance.best()) else {
            return Vec::new();
        };
        if self.options.refine == Some(false) || instance.views() < 2 {
            return Vec::new();
        }
        let points = &self.estimator.bundle.classes[instance.class].points;
        let rig = &self.config().rig;
        let seen = self.views.par_iter().zip(&instance.detections);
        let own = seen.filter_map(|(view, detection)| {
            let sight = Sight {
                camera: view.camera,
                bbox: detection.as_ref()?.bbox,
            };
            let refined = view.refined();
            let own = Alone::of(rig, refiner, &refined, &sight, points, &best.world_from_obj)?;
            Some((view.index, own))
        });
        let (cameras, own): (Vec<usize>, Vec<Alone>) = own.collect::<Vec<_>>().into_iter().unzip();
        let all = differences(refiner, &own, &best.world_from_obj);
        all.map_or_else(Vec::new, |all| cameras.into_iter().zip(all).collect())
    }
}

/// The greatest score of a class in the middle half of a projection.
fn map_score(
    maps: &DetectorMaps,
    letterbox: &crate::image::Letterbox,
    view: usize,
    class: usize,
    projection: &Projection,
) -> f64 {
    let middle = letterbox.net_box(projection.bbox.scaled(0.5));
    let (_, _, rows, columns) = maps.scores.dim();
    let cells = |low: f64, high: f64, count: usize, side: u32| {
        let cell = |px: f64| {
            let cell = (px + 0.5) * count as f64 / f64::from(side);
            (cell.max(0.0) as usize).min(count.saturating_sub(1))
        };
        cell(low)..cell(high) + 1
    };
    let rows = cells(middle.y0, middle.y1, rows, letterbox.net_height);
    let columns = cells(middle.x0, middle.x1, columns, letterbox.net_width);
    let scores = rows.flat_map(|row| columns.clone().map(move |column| (row, column)));
    scores
        .map(|(row, column)| f64::from(maps.scores[(view, class, row, column)]))
        .fold(0.0, f64::max)
}
