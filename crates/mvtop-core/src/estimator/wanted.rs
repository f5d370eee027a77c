//! What is asked for: objects of which classes, and where priors allow them.

use nalgebra::Isometry3;

use super::PredictOptions;
use super::grouping::distinct;
use super::instance::{Candidate, Instance};
use crate::bundle::{Bundle, Class};
use crate::config::SearchConfig;
use crate::prediction::MissReason;
use crate::request::{Plane, Prior};
use crate::{BBox, Error, Result};

/// What is asked for, by index of the class.
pub struct Wanted {
    classes: Vec<bool>,
    priors: Vec<Vec<Prior>>,
    planes: Vec<Vec<Plane>>,
}

/// How a pose misses what was known before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misfit {
    pub reason: MissReason,
    /// In the unit of the reason.
    pub value: f64,
    pub threshold: f64,
}

impl Wanted {
    /// # Errors
    /// [`Error::UnknownClass`] for a class that the bundle does not have.
    pub fn new(bundle: &Bundle, options: &PredictOptions) -> Result<Self> {
        let index = |role: &str, name: &str| {
            bundle.class_index(name).ok_or_else(|| Error::UnknownClass {
                role: role.into(),
                class: name.to_owned(),
                known: bundle.classes.iter().map(|one| one.name.clone()).collect(),
            })
        };
        let count = bundle.classes.len();
        let mut classes = vec![options.classes.is_none(); count];
        for name in options.classes.iter().flatten() {
            classes[index("classes", name)?] = true;
        }
        let mut priors = vec![Vec::new(); count];
        for prior in &options.priors {
            priors[index("priors", prior.class())?].push(prior.clone());
        }
        let mut planes = vec![Vec::new(); count];
        for plane in &options.planes {
            match plane.class() {
                Some(name) => planes[index("planes", name)?].push(plane.clone()),
                None => planes.iter_mut().for_each(|all| all.push(plane.clone())),
            }
        }
        Ok(Self {
            classes,
            priors,
            planes,
        })
    }

    /// Whether objects of a class are asked for.
    pub fn has_class(&self, class: usize) -> bool {
        self.classes[class]
    }

    /// Whether objects of all classes are.
    pub fn has_all_classes(&self) -> bool {
        self.classes.iter().all(|wanted| *wanted)
    }

    /// Priors of classes that are asked for, with the class.
    pub fn priors(&self) -> impl Iterator<Item = (usize, &Prior)> {
        let each = self.priors.iter().enumerate();
        let each = each.flat_map(|(class, all)| all.iter().map(move |prior| (class, prior)));
        each.filter(|(class, _)| self.classes[*class])
    }

    /// Whether poses of a class are restricted.
    pub fn restricts(&self, class: usize) -> bool {
        !(self.priors[class].is_empty() && self.planes[class].is_empty())
    }

    /// Of the poses that look like `pose` the one that is given, or how it misses the priors.
    ///
    /// - `index`: of the class
    pub fn fit(
        &self,
        index: usize,
        class: &Class,
        pose: &Isometry3<f64>,
    ) -> std::result::Result<Isometry3<f64>, Misfit> {
        let mut given = *pose;
        let nearest = self.priors[index]
            .iter()
            .map(|prior| prior.deviation(class, pose))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((alike, deviation)) = nearest {
            if deviation > Prior::MOST_DEVIATIONS {
                return Err(Misfit {
                    reason: MissReason::Prior,
                    value: deviation,
                    threshold: Prior::MOST_DEVIATIONS,
                });
            }
            given = alike;
        }
        let stands = self.planes[index]
            .iter()
            .map(|plane| (plane, plane.stand(class, pose)));
        let excess = |plane: &Plane, tilt_deg: f64, height_m: f64| {
            (tilt_deg / plane.within_deg()).max(height_m.abs() / plane.within_m())
        };
        let nearest = stands
            .map(|(plane, stand)| (excess(plane, stand.tilt_deg, stand.height_m), plane, stand))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, plane, stand)) = nearest {
            for (reason, value, threshold) in [
                (MissReason::Tilt, stand.tilt_deg, plane.within_deg()),
                (MissReason::Height, stand.height_m, plane.within_m()),
            ] {
                if value.abs() > threshold {
                    return Err(Misfit {
                        reason,
                        value,
                        threshold,
                    });
                }
            }
            if self.priors[index].is_empty() {
                given = stand.world_from_obj;
            }
        }
        Ok(given)
    }

    /// Excludes candidates that priors do not allow, where others are allowed. An instance without such
    /// others keeps its own: it is not given, and still hides and suppresses what it does.
    pub fn narrow(
        &self,
        instance: &mut Instance,
        new: &mut Vec<Candidate>,
        class: &Class,
        search: &SearchConfig,
    ) {
        let index = instance.class;
        if !self.restricts(index) {
            return;
        }
        let fits = |one: &Candidate| self.fit(index, class, &one.world_from_obj).is_ok();
        if instance.candidates.iter().chain(&*new).any(fits) {
            let mut excluded = std::mem::take(&mut instance.excluded);
            excluded.extend(instance.candidates.extract_if(.., |one| !fits(one)));
            excluded.extend(new.extract_if(.., |one| !fits(one)));
            excluded.sort_by(|a, b| b.scored.log_odds.total_cmp(&a.scored.log_odds));
            let pose = |one: &Candidate| one.world_from_obj;
            instance.excluded = distinct(
                excluded,
                pose,
                &class.symmetry,
                class.diameter_m,
                search.merge_deg,
                search.max_candidates,
            );
        }
    }

    /// Leaves out instances that can change nothing: of other classes, without a box that overlaps one
    /// of the classes asked for. Those that overlap may hide such an object, or stand in its place.
    pub fn leave_out(&self, instances: &mut Vec<Instance>) {
        if self.has_all_classes() {
            return;
        }
        let asked = instances.iter().filter(|one| self.classes[one.class]);
        let asked: Vec<Vec<Option<BBox>>> = asked.map(Instance::boxes).collect();
        instances.retain(|one| {
            let boxes = one.boxes();
            let overlaps = |other: &Vec<Option<BBox>>| {
                let mut pairs = boxes.iter().zip(other);
                pairs.any(|pair| matches!(pair, (Some(a), Some(b)) if a.iou(b) > 0.0))
            };
            self.classes[one.class] || asked.iter().any(overlaps)
        });
    }
}
