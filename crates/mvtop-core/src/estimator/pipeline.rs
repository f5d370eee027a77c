//! One prediction, from images to poses: read [`Pipeline::predict`].

use std::time::Instant;

use super::instance::{Candidate, Instance};
use super::near_miss::NearMisses;
use super::view::View;
use super::wanted::Wanted;
use super::{Estimator, PredictOptions};
use super::{detections, nms, tiling, view};
use crate::config::InferenceConfig;
use crate::image::ViewImage;
use crate::network::{DetectorMaps, Network};
use crate::prediction::{Prediction, Timings};
use crate::{Error, Result, Rig};

/// What all stages of a prediction need.
pub struct Pipeline<'a> {
    pub estimator: &'a Estimator,
    /// Runs the network: a tracker keeps some of its answers.
    pub network: &'a dyn Network,
    pub rig: &'a Rig,
    /// In the order of the cameras' ids.
    pub views: Vec<View<'a>>,
    pub options: &'a PredictOptions,
    pub wanted: Wanted,
    /// Of the whole images; there once they were shown to the detector.
    pub maps: Option<DetectorMaps>,
}

impl<'a> Pipeline<'a> {
    /// - `images`: of the rig's cameras, as [`Estimator::predict`] takes them
    pub fn new(
        estimator: &'a Estimator,
        network: &'a dyn Network,
        rig: &'a Rig,
        images: &'a [ViewImage],
        options: &'a PredictOptions,
    ) -> Result<Self> {
        let bundle = &estimator.bundle;
        if options.refine == Some(true) {
            estimator.needs_mesh("refine", "do not ask for refinement")?;
        }
        let tiling = network.takes_any_size().then_some(&estimator.config.tiling);
        let views = view::gather(bundle, tiling, rig, images)?;
        let needed = options.min_views.max(1);
        if views.len() < needed {
            return Err(Error::TooFewImages {
                expected: needed,
                got: views.len(),
            });
        }
        Ok(Self {
            estimator,
            network,
            rig,
            views,
            options,
            wanted: Wanted::new(bundle, options)?,
            maps: None,
        })
    }

    pub(super) fn config(&self) -> &'a InferenceConfig {
        &self.estimator.config
    }

    /// Detect, associate, propose, refine, score, suppress, verify.
    ///
    /// - `reference`: index of the camera in whose frame poses are given
    pub fn predict(mut self, reference: usize) -> Result<Prediction> {
        let mut clock = Clock::start();
        self.detect(&mut clock)?;
        let mut misses = NearMisses::new(self.estimator.bundle.classes.len());
        let mut instances = self.instances(&mut misses)?;
        clock.lap(|timings| &mut timings.detect);

        self.first_candidates(&mut instances, &mut clock)?;
        self.rematch(&mut instances, &mut clock)?;
        self.propose_priors(&mut instances, &mut clock)?;
        for proposer in &self.config().search.schedule {
            self.search(*proposer, &mut instances, &mut clock)?;
        }
        instances.retain(|one| {
            let has_pose = one.best().is_some();
            if !has_pose {
                self.note(&mut misses, one.class, || self.without_pose(one));
            }
            has_pose
        });
        if self.options.boxes.is_none() {
            instances = self.suppressed(instances, &mut misses);
        }
        let prediction = self.verified(reference, instances, misses, &mut clock)?;
        Ok(Prediction {
            timings: clock.total(),
            ..prediction
        })
    }

    /// Shows the whole images to the detector.
    fn detect(&mut self, clock: &mut Clock) -> Result<()> {
        let (bundle, views) = (&self.estimator.bundle, &self.views);
        let images = view::tensor(views, &bundle.input)?;
        clock.lap(|timings| &mut timings.prepare);
        let maps = self.network.detect(images.view())?;
        let faintest = bundle.detector.faintest();
        maps.check(views.len(), bundle.classes.len(), faintest)?;
        self.maps = Some(maps);
        clock.lap(|timings| &mut timings.features);
        Ok(())
    }

    /// The instances that the boxes of all views show, without poses yet.
    fn instances(&self, misses: &mut NearMisses) -> Result<Vec<Instance>> {
        let Estimator { bundle, radii, .. } = self.estimator;
        if let Some(boxes) = &self.options.boxes {
            let mut given = detections::given(bundle, self.rig, &self.views, boxes)?;
            self.wanted.leave_out(&mut given);
            return Ok(given);
        }
        let Some(maps) = &self.maps else {
            return Ok(Vec::new());
        };
        let mut boxes = detections::in_whole_images(bundle, &self.views, maps);
        let config = self.config();
        tiling::detect(self, &mut boxes)?;
        let association = &config.association;
        let mut found = detections::detected(bundle, association, radii, &self.views, &boxes);
        self.note_undetected(misses, &boxes, &found);
        let least = self.options.min_views;
        found.retain(|one| {
            let enough = one.views() >= least;
            if !enough {
                self.note(misses, one.class, || self.in_few_views(one, least));
            }
            enough
        });
        self.wanted.leave_out(&mut found);
        Ok(found)
    }

    /// One instance for each object.
    fn suppressed(&self, instances: Vec<Instance>, misses: &mut NearMisses) -> Vec<Instance> {
        let Estimator { bundle, radii, .. } = self.estimator;
        let search = &self.config().search;
        let left = nms::suppress(search, &bundle.classes, &self.views, radii, instances);
        for (one, better) in &left.duplicates {
            let better = &left.kept[*better];
            self.note(misses, one.class, || self.duplicate(one, better));
        }
        left.kept
    }

    /// The network's candidates from the detected boxes.
    pub(super) fn first_candidates(
        &self,
        instances: &mut [Instance],
        clock: &mut Clock,
    ) -> Result<()> {
        let rois: Vec<_> = instances.iter().map(Instance::boxes).collect();
        let requests = instances.iter().zip(&rois).enumerate();
        let requests = requests.map(|(object, (one, rois))| self.request(object, one.class, rois));
        let (crops, groups) = self.encoded(requests.collect::<Result<_>>()?, clock)?;
        let classes: Vec<usize> = instances.iter().map(|one| one.class).collect();
        let proposed = self.network_candidates(&crops, &groups, &classes, &rois)?;
        clock.lap(|timings| &mut timings.propose);
        self.accept(&mut instances.iter_mut().collect::<Vec<_>>(), proposed);
        clock.lap(|timings| &mut timings.refine);
        Ok(())
    }

    /// Refines and scores what was proposed, and adds it to the instances: the most probable candidate
    /// of each first, the others of those that it does not settle.
    pub(super) fn accept(
        &self,
        instances: &mut [&mut Instance],
        mut proposed: Vec<Vec<Candidate>>,
    ) {
        let mut others: Vec<Vec<Candidate>> = proposed
            .iter_mut()
            .map(|all| all.split_off(all.len().min(1)))
            .collect();
        self.evaluate(instances, proposed);
        for (instance, others) in instances.iter().zip(&mut others) {
            if self.is_done(instance) {
                others.clear();
            }
        }
        self.evaluate(instances, others);
    }

    fn evaluate(&self, instances: &mut [&mut Instance], proposed: Vec<Vec<Candidate>>) {
        let read: Vec<&Instance> = instances.iter().map(|one| &**one).collect();
        let scored = self.refine_and_score(&read, proposed);
        let search = &self.config().search;
        for (instance, mut new) in instances.iter_mut().zip(scored) {
            let class = &self.estimator.bundle.classes[instance.class];
            self.wanted.narrow(instance, &mut new, class, search);
            instance.add(new, class, search.merge_deg, search.max_candidates);
        }
    }

    /// Whether an instance needs no further candidates: it is settled on a pose that priors allow.
    pub(super) fn is_done(&self, instance: &Instance) -> bool {
        let (index, best) = (instance.class, instance.best());
        let class = &self.estimator.bundle.classes[index];
        let fits = |best: &Candidate| self.wanted.fit(index, class, &best.world_from_obj).is_ok();
        self.is_settled(instance) && best.is_none_or(fits)
    }

    /// Whether one pose of an instance is probable enough; never with a bundle that was not calibrated.
    pub(super) fn is_settled(&self, instance: &Instance) -> bool {
        let calibrated = self.estimator.bundle.scorer.is_some();
        calibrated && instance.confidence() >= self.config().search.settled
    }
}

/// Measures the time of each stage.
pub(super) struct Clock {
    start: Instant,
    lap: Instant,
    timings: Timings,
}

impl Clock {
    fn start() -> Self {
        let now = Instant::now();
        Self {
            start: now,
            lap: now,
            timings: Timings::default(),
        }
    }

    /// Adds the time since the last lap to a stage.
    pub fn lap(&mut self, stage: fn(&mut Timings) -> &mut f64) {
        *stage(&mut self.timings) += self.lap.elapsed().as_secs_f64() * 1e3;
        self.lap = Instant::now();
    }

    fn total(&self) -> Timings {
        Timings {
            total: self.start.elapsed().as_secs_f64() * 1e3,
            ..self.timings
        }
    }
}
