//! Views compared with each other, instances rejected, and results gathered.

use nalgebra::Isometry3;
use rayon::prelude::*;

use super::instance::{Candidate, Instance};
use super::near_miss::NearMisses;
use super::occlusion::Seen;
use super::pipeline::{Clock, Pipeline};
use super::wanted::Misfit;
use super::{Estimator, color_check, grouping, next_view, occlusion, rig_check, view};
use crate::Result;
use crate::prediction::{CameraPose, ObjectPose, Prediction, Timings, Warning};
use crate::scorer::{PoseEvidence, Scored, ViewEvidence};

impl Pipeline<'_> {
    /// Compares the views, judges the rig by all instances, scores them anew, and reports.
    ///
    /// - `instances`: with candidates
    pub(super) fn verified(
        &self,
        reference: usize,
        mut instances: Vec<Instance>,
        mut misses: NearMisses,
        clock: &mut Clock,
    ) -> Result<Prediction> {
        let (Estimator { bundle, .. }, rig) = (self.estimator, self.rig);
        let seen = occlusion::seen(self, &instances);
        self.occlude(&mut instances, &seen);
        let hopeless = self.config().search.hopeless;
        let compared: Vec<_> = instances
            .par_iter()
            .map(
                |one| match bundle.scorer.is_none() || one.confidence() >= hopeless {
                    true => self.compared(one),
                    false => Vec::new(),
                },
            )
            .collect();
        let checked = rig_check::check(self, &instances, &compared);
        let exchanged = color_check::check(self, &instances, &seen)?;
        let rig_deviation = checked.deviation;
        let ref_from_world = rig.cameras()[reference].world_from_cam().inverse();
        let least = match self.options.boxes {
            None => self.config().search.min_confidence,
            Some(_) => 0.0,
        };
        let mut objects = Vec::new();
        // Index of each instance among the objects that are reported.
        let mut reported = vec![None; instances.len()];
        for (index, instance) in instances.iter_mut().enumerate() {
            let own = checked.deviations[index];
            self.rescore(instance, |pose, _| {
                pose.object_deviation = own.unwrap_or(0.0);
                pose.rig_deviation = rig_deviation;
            });
            // One that only hides or suppresses others.
            if !self.wanted.has_class(instance.class) {
                continue;
            }
            let fitted = self.fitted(instance);
            let Some(mut object) = self.object(&ref_from_world, instance) else {
                continue;
            };
            object.deviation = own;
            object.evidence = instance.best().map(|best| best.scored.clone());
            object.confidence = bundle.scorer.is_some().then(|| instance.confidence());
            if rig_deviation > 1.0 {
                let apart = compared[index]
                    .iter()
                    .map(|(_, one)| one.across.hypot(one.along));
                object.sigma.t_m = apart.fold(object.sigma.t_m, f64::max);
            }
            if let Some(confidence) = object.confidence.filter(|one| *one < least) {
                let missed = || self.improbable(instance, confidence, least);
                self.note(&mut misses, instance.class, missed);
            } else if let Err(misfit) = fitted {
                let missed = || self.misfitted(instance, misfit);
                self.note(&mut misses, instance.class, missed);
            } else {
                reported[index] = Some(objects.len());
                objects.push(object);
            }
        }
        let rig_consistency = checked.consistency;
        let doubts = checked.warnings.into_iter().map(|warning| Warning {
            object: warning.object.and_then(|object| reported[object]),
            ..warning
        });
        next_view::name(
            bundle,
            &self.estimator.refiners,
            rig,
            &self.views,
            &mut objects,
        );
        let mut warnings = view::warnings(&self.views);
        warnings.extend(doubts);
        warnings.extend(exchanged);
        clock.lap(|timings| &mut timings.check);
        Ok(Prediction {
            reference,
            near_misses: misses.of_missing(&objects),
            objects,
            rig_consistency,
            timings: Timings::default(),
            model: bundle.dir.display().to_string(),
            provider: self.network.provider().to_owned(),
            warnings,
        })
    }

    /// Gives the poses, of those that look alike, that the priors are of; or how the best one misses them.
    fn fitted(&self, instance: &mut Instance) -> std::result::Result<(), Misfit> {
        let index = instance.class;
        let class = &self.estimator.bundle.classes[index];
        if !self.wanted.restricts(index) {
            return Ok(());
        }
        let fit = |one: &Candidate| self.wanted.fit(index, class, &one.world_from_obj);
        if let Some(Err(misfit)) = instance.best().map(fit) {
            return Err(misfit);
        }
        for one in &mut instance.candidates {
            one.world_from_obj = fit(one).unwrap_or(one.world_from_obj);
        }
        Ok(())
    }

    /// Lets views count as much as settled instances leave of an instance in sight.
    fn occlude(&self, instances: &mut [Instance], seen: &[Vec<Seen>]) {
        for (instance, seen) in instances.iter_mut().zip(seen) {
            self.rescore(instance, |_, views| {
                for one in views {
                    one.visible *= seen[one.view].share;
                }
            });
            instance.sort();
        }
    }

    /// Scores the candidates of an instance anew, with changed evidence.
    fn rescore(
        &self,
        instance: &mut Instance,
        change: impl Fn(&mut PoseEvidence, &mut [ViewEvidence]),
    ) {
        let excluded = &mut instance.excluded;
        for one in instance.candidates.iter_mut().chain(excluded) {
            let Scored {
                initial_log_odds,
                mut pose,
                mut views,
                ..
            } = std::mem::take(&mut one.scored);
            change(&mut pose, &mut views);
            let refined = one.refinement.is_some();
            one.scored = Scored {
                initial_log_odds,
                ..self.estimator.scorer().score(refined, views, pose)
            };
        }
    }

    fn object(&self, ref_from_world: &Isometry3<f64>, instance: &Instance) -> Option<ObjectPose> {
        let class = &self.estimator.bundle.classes[instance.class];
        let best = instance.best()?;
        let world_from_obj = best.world_from_obj;
        let hypotheses = instance.hypotheses();
        let views = self.views.iter().zip(&instance.detections);
        let mut cameras: Vec<CameraPose> = views
            .map(|(view, detection)| CameraPose {
                camera: view.index,
                cam_from_obj: view.camera.world_from_cam().inv_mul(&world_from_obj),
                bbox: detection.map(|one| one.bbox),
            })
            .collect();
        cameras.sort_by_key(|one| one.camera);
        let coordinates = best.correspondences.as_ref().map(|_| {
            let views = &best.scored.views;
            views.iter().map(|one| one.coordinates).sum::<f64>() / views.len().max(1) as f64
        });
        let ref_from_obj = ref_from_world * world_from_obj;
        Some(ObjectPose {
            sigma: grouping::expected_error(&hypotheses, &class.symmetry, class.diameter_m),
            coordinate_inliers: coordinates,
            refinement: best.refinement,
            hypotheses,
            symmetry: class.symmetry.clone(),
            cameras,
            ..ObjectPose::new(
                &class.name,
                class.id,
                instance.score(),
                ref_from_obj,
                world_from_obj,
            )
        })
    }
}
