//! Who proposes candidate poses of instances, and for which of them.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use super::crops::{self, CropRequest, Crops, Features, Group};
use super::instance::{Candidate, Instance};
use super::pipeline::{Clock, Pipeline};
use super::pnp::{self, Correspondences};
use super::{decoder, grouping, reprojection};
use crate::bundle::Class;
use crate::config::Proposer;
use crate::prediction::{Hypothesis, Sigma};
use crate::scorer::Scored;
use crate::{BBox, Result};

impl Pipeline<'_> {
    pub(super) fn request(
        &self,
        object: usize,
        class: usize,
        rois: &[Option<BBox>],
    ) -> Result<CropRequest<'_>> {
        CropRequest::boxes(&self.estimator.bundle, &self.views, object, class, rois)
    }

    pub(super) fn encoded(
        &self,
        requests: Vec<CropRequest>,
        clock: &mut Clock,
    ) -> Result<(Crops, Vec<Group>)> {
        let encoded = crops::encoded(self.network, &self.estimator.bundle, requests);
        clock.lap(|timings| &mut timings.crop);
        encoded
    }

    /// Candidates of PnP where crops have object coordinates, else of the decoder.
    ///
    /// - `classes`, `rois`: of each object, by the groups' indices
    pub(super) fn network_candidates(
        &self,
        crops: &Crops,
        groups: &[Group],
        classes: &[usize],
        rois: &[Vec<Option<BBox>>],
    ) -> Result<Vec<Vec<Candidate>>> {
        let (bundle, config) = (&self.estimator.bundle, self.config());
        let mut hypotheses = vec![Vec::new(); classes.len()];
        let mut correspondences = vec![None; classes.len()];
        let Crops { list, features } = crops;
        match features {
            Features::Memory(memory) => {
                let search = &config.search;
                let network = self.network;
                hypotheses =
                    decoder::hypotheses(network, bundle, search, list, memory, groups, classes)?;
            }
            Features::Coordinates(codes) => {
                for group in groups {
                    let class = &bundle.classes[group.class];
                    let Some(extent) = class.coordinates_extent_m else {
                        continue;
                    };
                    let (codes, least) = (codes.view(), config.pnp.min_trust);
                    let mut all = Correspondences::new(list, codes, group, extent, class, least);
                    hypotheses[group.object] = pnp::solve(config, &mut all);
                    correspondences[group.object] = Some(Arc::new(all));
                }
            }
        }
        let candidates = hypotheses.into_iter().zip(correspondences).enumerate();
        let candidates = candidates.map(|(object, (found, correspondences))| {
            self.candidates(classes[object], found, &rois[object], correspondences)
        });
        Ok(candidates.collect())
    }

    /// Hypotheses of an object as candidates, without those that cannot be seen.
    fn candidates(
        &self,
        class: usize,
        mut found: Vec<Hypothesis>,
        rois: &[Option<BBox>],
        correspondences: Option<Arc<Correspondences>>,
    ) -> Vec<Candidate> {
        let class = &self.estimator.bundle.classes[class];
        let search = &self.config().search;
        found.retain(|one| self.can_be_seen(class, one));
        found.truncate(search.max_candidates);
        if found.is_empty() {
            return Vec::new();
        }
        let total: f64 = found.iter().map(|one| one.probability).sum();
        found.iter_mut().for_each(|one| one.probability /= total);
        let initial_sigma = grouping::expected_error(&found, &class.symmetry, class.diameter_m);
        let candidate = |one: Hypothesis| Candidate {
            world_from_obj: one.world_from_obj,
            sigma: one.sigma,
            initial_sigma,
            prior: one.probability,
            rois: rois.to_vec(),
            correspondences: correspondences.clone(),
            refinement: None,
            scored: Scored::default(),
        };
        found.into_iter().map(candidate).collect()
    }

    /// Whether a hypothesis is in front of a camera and near enough to be seen.
    fn can_be_seen(&self, class: &Class, one: &Hypothesis) -> bool {
        let origin = Point3::from(one.world_from_obj.translation.vector);
        self.views.iter().any(|view| {
            let in_cam = view
                .camera
                .world_from_cam()
                .inverse_transform_point(&origin);
            let pinhole = view.camera.intrinsics().projection().family() == "pinhole";
            let near = in_cam.coords.norm() <= pnp::MAX_DIAMETERS * class.diameter_m;
            near && (!pinhole || in_cam.z > 0.0)
        })
    }

    /// Lets a proposer work on the instances that are not settled.
    pub(super) fn search(
        &self,
        proposer: Proposer,
        instances: &mut [Instance],
        clock: &mut Clock,
    ) -> Result<()> {
        let mut open = self.open(proposer, instances);
        if open.is_empty() {
            return Ok(());
        }
        let proposed = match proposer {
            Proposer::Reprojected => self.reprojected(&open, clock)?,
            Proposer::Augmented => self.augmented(&open, clock)?,
            Proposer::Perturbed => self.perturbed(&open),
        };
        clock.lap(|timings| &mut timings.propose);
        self.accept(&mut open, proposed);
        clock.lap(|timings| &mut timings.refine);
        Ok(())
    }

    /// The instances that a proposer works on: the most confident ones that are not settled.
    fn open<'i>(&self, proposer: Proposer, instances: &'i mut [Instance]) -> Vec<&'i mut Instance> {
        let search = &self.config().search;
        let coordinates = self.estimator.bundle.has_coordinates();
        let calibrated = self.estimator.bundle.scorer.is_some();
        let works = |one: &Instance| {
            let refined = one.best().is_some_and(|best| best.refinement.is_some());
            match proposer {
                // Another view may show what it missed. Boxes that were given are taken as they are.
                Proposer::Reprojected => self.views.len() > 1 && self.options.boxes.is_none(),
                // Object coordinates are searched from rotations all around already.
                Proposer::Augmented | Proposer::Perturbed => {
                    one.views() > 1 && refined && !coordinates
                }
            }
        };
        let mut open: Vec<(f64, &mut Instance)> = instances
            .iter_mut()
            .filter(|one| works(one))
            .filter(|one| !self.is_done(one))
            .map(|one| (one.confidence(), one))
            .filter(|(confidence, _)| !calibrated || *confidence >= search.hopeless)
            .collect();
        open.sort_by(|a, b| b.0.total_cmp(&a.0));
        open.truncate(search.max_instances);
        open.into_iter().map(|(_, one)| one).collect()
    }

    /// The network's candidates from the crops where the best pose projects the object.
    fn reprojected(
        &self,
        open: &[&mut Instance],
        clock: &mut Clock,
    ) -> Result<Vec<Vec<Candidate>>> {
        let classes = &self.estimator.bundle.classes;
        let search = &self.config().search;
        let least = search.min_in_image;
        let (mut requests, mut rois) = (Vec::new(), vec![Vec::new(); open.len()]);
        for (object, one) in open.iter().enumerate() {
            let Some(best) = one.best() else { continue };
            let pose = &best.world_from_obj;
            let shown = reprojection::expected(&classes[one.class], &self.views, pose, least);
            let shown = shown.iter().zip(&best.rois);
            let new: Vec<_> = shown
                .map(|(new, old)| new.map(|one| one.bbox).or(*old))
                .collect();
            if !reprojection::same_rois(&new, &best.rois, search.same_crop_iou) {
                requests.push(self.request(object, one.class, &new)?);
                rois[object] = new;
            }
        }
        self.proposed_by_crops(open, requests, &rois, clock)
    }

    /// The network's candidates from rolled crops.
    fn augmented(&self, open: &[&mut Instance], clock: &mut Clock) -> Result<Vec<Vec<Candidate>>> {
        let each = open.iter().enumerate();
        let requests = each.flat_map(|(object, one)| self.rolled(object, one));
        let rois = open
            .iter()
            .map(|one| one.best().map(|best| best.rois.clone()));
        let rois: Vec<_> = rois.map(Option::unwrap_or_default).collect();
        self.proposed_by_crops(open, requests.collect(), &rois, clock)
    }

    /// The network's candidates from crops; those of all crops of an instance are grouped.
    ///
    /// - `rois`: of each instance
    fn proposed_by_crops(
        &self,
        open: &[&mut Instance],
        requests: Vec<CropRequest>,
        rois: &[Vec<Option<BBox>>],
        clock: &mut Clock,
    ) -> Result<Vec<Vec<Candidate>>> {
        let classes: Vec<usize> = open.iter().map(|one| one.class).collect();
        let (crops, groups) = self.encoded(requests, clock)?;
        self.network_candidates(&crops, &groups, &classes, rois)
    }

    /// The best pose turned about each axis of the object, both ways.
    fn perturbed(&self, open: &[&mut Instance]) -> Vec<Vec<Candidate>> {
        let degrees = self.config().search.perturbation_deg;
        let of_instance = |one: &&mut Instance| {
            let (best, refiner) = (one.best()?, self.estimator.refiners[one.class].as_ref()?);
            let poses = turned(&best.world_from_obj, refiner.center(), degrees);
            let candidate = |world_from_obj| Candidate {
                world_from_obj,
                sigma: Sigma {
                    rot_deg: best.sigma.rot_deg.hypot(degrees),
                    ..best.sigma
                },
                refinement: None,
                ..best.clone()
            };
            Some(poses.into_iter().map(candidate).collect())
        };
        open.iter()
            .map(|one| of_instance(one).unwrap_or_default())
            .collect()
    }
}

/// A pose turned about each axis of the object, both ways.
///
/// - `center`: of the turns, object frame
pub fn turned(
    world_from_obj: &Isometry3<f64>,
    center: Point3<f64>,
    degrees: f64,
) -> [Isometry3<f64>; 6] {
    std::array::from_fn(|i| {
        let sign = if i < 3 { 1.0 } else { -1.0 };
        let turn = Vector3::ith(i % 3, sign * degrees.to_radians());
        let turn = UnitQuaternion::from_scaled_axis(turn);
        world_from_obj * Isometry3::rotation_wrt_point(turn, center)
    })
}
