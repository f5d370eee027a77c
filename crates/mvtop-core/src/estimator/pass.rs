//! One pass from images to poses, stage by stage: read [`Pass::predict`].

use std::time::Instant;

use nalgebra::Isometry3;

use super::believed::{believed, once, printed};
use super::picture::{CloseUpsOf, Group, Pictures};
use super::pose::DecodedPose;
use super::sightings::Sighting;
use super::view::View;
use super::{Estimator, PredictOptions};
use super::{closer, complete, decode, doubts, fit, next_view, picture, refined, sightings, view};
use crate::bundle::{CloseUps, PoseInput};
use crate::consistency::alone::Difference;
use crate::image::ViewImage;
use crate::network::{DetectorMaps, Network};
use crate::prediction::{CameraPose, ObjectPose, Prediction, Refinement, Timings};
use crate::{Error, Result, Rig};

/// Objects with their poses.
pub type Found = Vec<(Sighting, DecodedPose)>;

/// What is needed all along a pass.
pub struct Pass<'a> {
    pub estimator: &'a Estimator,
    /// As it is run this time: a tracker keeps some of its answers.
    pub network: &'a dyn Network,
    pub rig: &'a Rig,
    pub views: Vec<View<'a>>,
    pub options: &'a PredictOptions,
}

/// What poses are decoded from, as far as it is there before the objects are found.
enum Shown<'a> {
    WholeImages(Pictures),
    CloseUps(&'a CloseUps),
}

impl<'a> Pass<'a> {
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
        let views = view::gather(bundle, rig, images)?;
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
        })
    }

    /// - `reference`: index of the camera in whose frame poses are given
    pub fn predict(self, reference: usize) -> Result<Prediction> {
        let mut clock = Clock::start();
        let (maps, shown) = self.searched(&mut clock)?;
        let objects = self.sighted(&maps, &shown)?;
        clock.lap(|timings| &mut timings.detect);

        let (pictures, groups) = self.pictured(shown, &objects, &mut clock)?;
        let found = self.posed(&pictures, &groups, objects)?;
        clock.lap(|timings| &mut timings.decode);

        let (found, refinements) = self.refined(found)?;
        clock.lap(|timings| &mut timings.refine);
        let differences = self.compared(&found);
        clock.lap(|timings| &mut timings.check);

        let mut prediction = self.reported(reference, found, refinements, differences);
        prediction.timings = clock.total();
        Ok(prediction)
    }

    /// What the network says of the whole images.
    fn searched(&self, clock: &mut Clock) -> Result<(DetectorMaps, Shown<'a>)> {
        let (bundle, views) = (&self.estimator.bundle, &self.views);
        let images = view::tensor(views, &bundle.input)?;
        let (maps, shown) = match &bundle.poses {
            PoseInput::WholeImages { strides } => {
                let list = picture::whole_images(views, strides);
                let rays = picture::rays(&list);
                clock.lap(|timings| &mut timings.prepare);
                let (maps, memory) = self.network.detect_and_encode(images.view(), rays.view())?;
                (maps, Shown::WholeImages(Pictures::new(list, memory)?))
            }
            PoseInput::CloseUps(closeups) => {
                clock.lap(|timings| &mut timings.prepare);
                let maps = self.network.detect(images.view())?;
                (maps, Shown::CloseUps(closeups))
            }
        };
        maps.check(
            views.len(),
            bundle.classes.len(),
            bundle.detector.faintest(),
        )?;
        clock.lap(|timings| &mut timings.features);
        Ok((maps, shown))
    }

    /// The objects, and where each view sees them.
    fn sighted(&self, maps: &DetectorMaps, shown: &Shown) -> Result<Vec<Sighting>> {
        let Estimator { bundle, radii, .. } = self.estimator;
        if let Some(boxes) = &self.options.boxes {
            return sightings::given(bundle, self.rig, &self.views, boxes);
        }
        let mut boxes = sightings::in_whole_images(bundle, &self.views, maps);
        if let Shown::CloseUps(_) = shown {
            closer::look(self.network, bundle, radii, &self.views, &mut boxes)?;
        }
        let mut objects = sightings::detected(bundle, radii, &self.views, &boxes);
        objects.retain(|object| object.views() >= self.options.min_views);
        Ok(objects)
    }

    /// What poses are decoded from.
    fn pictured(
        &self,
        shown: Shown,
        objects: &[Sighting],
        clock: &mut Clock,
    ) -> Result<(Pictures, Vec<Group>)> {
        match shown {
            Shown::WholeImages(pictures) => {
                let groups = picture::in_whole_images(&self.views, objects);
                Ok((pictures, groups))
            }
            Shown::CloseUps(closeups) => {
                let taken = self.close_up(closeups, objects)?;
                clock.lap(|timings| &mut timings.closeup);
                Ok(taken)
            }
        }
    }

    fn close_up(
        &self,
        closeups: &CloseUps,
        objects: &[Sighting],
    ) -> Result<(Pictures, Vec<Group>)> {
        let (bundle, size) = (&self.estimator.bundle, closeups.size);
        let of_boxes = |seen| CloseUpsOf::boxes(bundle, &self.views, seen, size);
        let taken = objects.iter().map(of_boxes).collect::<Result<_>>()?;
        picture::in_closeups(self.network, bundle, closeups, taken)
    }

    /// The objects that are believed, with the poses that the network finds.
    fn posed(
        &self,
        pictures: &Pictures,
        groups: &[Group],
        objects: Vec<Sighting>,
    ) -> Result<Found> {
        let Estimator { bundle, radii, .. } = self.estimator;
        let poses = self.poses(pictures, groups)?;
        let mut found: Found = objects.into_iter().zip(poses).collect();
        // Boxes that are given are taken as they are.
        if self.options.boxes.is_none() {
            if let PoseInput::CloseUps(closeups) = &bundle.poses {
                found = self.completed(closeups, found)?;
                found = self.looked_at_again(closeups, found)?;
            }
            let share = |(object, pose): &(Sighting, DecodedPose)| {
                let class = &bundle.classes[object.class];
                complete::share_of_views(class, &self.views, object, pose)
            };
            let shares: Vec<f64> = found.iter().map(share).collect();
            found = believed(found, &shares, bundle.detector.support_threshold, radii);
        }
        for (object, pose) in &found {
            pose.check_in_front(&self.views)?;
            pose.check_near(&self.views, &bundle.classes[object.class])?;
        }
        Ok(found)
    }

    /// The poses of objects, by their index, each as its pictures show it.
    pub(super) fn poses(&self, pictures: &Pictures, groups: &[Group]) -> Result<Vec<DecodedPose>> {
        let bundle = &self.estimator.bundle;
        let poses = decode::poses(self.network, bundle, pictures, groups)?;
        Ok(fit::settled(bundle, pictures, groups, poses))
    }

    /// The poses of objects, each as its close-ups show it.
    pub fn decoded(&self, closeups: &CloseUps, objects: &[Sighting]) -> Result<Vec<DecodedPose>> {
        let (pictures, groups) = self.close_up(closeups, objects)?;
        self.poses(&pictures, &groups)
    }

    /// Objects with what single views have missed, and their poses from all that shows them.
    fn completed(&self, closeups: &CloseUps, found: Found) -> Result<Found> {
        let classes = &self.estimator.bundle.classes;
        let merged = complete::merge(classes, &self.views, found);
        let (mut again, mut objects) = (Vec::new(), Vec::new());
        for (index, (object, pose, gained)) in merged.iter().enumerate() {
            let more = complete::filled_in(&classes[object.class], &self.views, object, pose);
            if let Some(object) = more.or_else(|| gained.then(|| object.clone())) {
                again.push(index);
                objects.push(object);
            }
        }
        let mut found: Found = merged.into_iter().map(|(o, pose, _)| (o, pose)).collect();
        if again.is_empty() {
            return Ok(found);
        }
        let poses = self.decoded(closeups, &objects)?;
        for (index, pose) in again.into_iter().zip(poses) {
            // A view in which the object is hidden may mislead: the pose that is expected to be
            // nearer counts.
            let known = &mut found[index].1;
            if pose.sigma.rot_deg < known.sigma.rot_deg {
                *known = pose;
            }
        }
        Ok(found)
    }

    /// The objects as the images show them best; as they are where that was not wanted.
    fn refined(&self, mut found: Found) -> Result<(Found, Vec<Option<Refinement>>)> {
        if self.options.refine == Some(false) {
            let none = vec![None; found.len()];
            return Ok((found, none));
        }
        let Estimator {
            bundle,
            radii,
            refiners,
            ..
        } = self.estimator;
        let rolled;
        let looks: Option<&refined::Looks> = match &bundle.poses {
            PoseInput::CloseUps(closeups) => {
                rolled =
                    |places: &[(&Sighting, Isometry3<f64>)]| self.rolled_looks(closeups, places);
                Some(&rolled)
            }
            PoseInput::WholeImages { .. } => None,
        };
        let refinements = refined::on_images(refiners, &self.views, bundle, &mut found, looks)?;
        if self.options.boxes.is_some() {
            return Ok((found, refinements));
        }
        let (found, refinements) = printed(found, refinements, bundle.detector.print_threshold);
        Ok(once(found, refinements, radii))
    }

    /// How far each view by itself is from all together, of each object.
    fn compared(&self, found: &[(Sighting, DecodedPose)]) -> Vec<Vec<(usize, Difference)>> {
        if self.options.refine == Some(false) {
            return vec![Vec::new(); found.len()];
        }
        let Estimator {
            bundle, refiners, ..
        } = self.estimator;
        refined::by_view(refiners, &self.views, bundle, found)
    }

    /// What is told of all this, but for the times.
    fn reported(
        &self,
        reference: usize,
        found: Found,
        refinements: Vec<Option<Refinement>>,
        differences: Vec<Vec<(usize, Difference)>>,
    ) -> Prediction {
        let (Estimator { bundle, .. }, rig) = (self.estimator, self.rig);
        let ref_from_world = rig.cameras()[reference].world_from_cam().inverse();
        let mut objects: Vec<ObjectPose> = found
            .into_iter()
            .zip(refinements)
            .map(|((object, pose), refinement)| ObjectPose {
                refinement,
                ..self.object_pose(&ref_from_world, &object, pose)
            })
            .collect();
        let (rig_consistency, doubts) = doubts::of(bundle, rig, &mut objects, differences);
        if let Some(confidence) = &bundle.confidence {
            for object in &mut objects {
                object.confidence = confidence.of(object, rig_consistency.as_ref());
            }
        }
        let refiners = &self.estimator.refiners;
        next_view::name(bundle, refiners, rig, &self.views, &mut objects);
        let mut warnings = view::warnings(&self.views);
        warnings.extend(doubts);
        Prediction {
            reference,
            objects,
            rig_consistency,
            timings: Timings::default(),
            provider: self.network.provider().to_owned(),
            warnings,
        }
    }

    fn object_pose(
        &self,
        ref_from_world: &Isometry3<f64>,
        object: &Sighting,
        pose: DecodedPose,
    ) -> ObjectPose {
        let class = &self.estimator.bundle.classes[object.class];
        let cameras = self
            .views
            .iter()
            .zip(&object.boxes)
            .map(|(view, bbox)| CameraPose {
                camera: view.index,
                cam_from_obj: view.camera.world_from_cam().inv_mul(&pose.world_from_obj),
                bbox: *bbox,
            });
        ObjectPose {
            class: class.name.clone(),
            class_id: class.id,
            score: object.score,
            ref_from_obj: ref_from_world * pose.world_from_obj,
            world_from_obj: pose.world_from_obj,
            sigma: pose.sigma,
            deviation: None,
            support: pose.support,
            refinement: None,
            confidence: None,
            hypotheses: pose.hypotheses,
            next_view: None,
            symmetry: class.symmetry.clone(),
            cameras: cameras.collect(),
        }
    }
}

/// Tells how long each stage takes.
struct Clock {
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

    /// What was done since the last lap was this stage.
    fn lap(&mut self, stage: fn(&mut Timings) -> &mut f64) {
        *stage(&mut self.timings) = self.lap.elapsed().as_secs_f64() * 1e3;
        self.lap = Instant::now();
    }

    fn total(self) -> Timings {
        Timings {
            total: self.start.elapsed().as_secs_f64() * 1e3,
            ..self.timings
        }
    }
}
