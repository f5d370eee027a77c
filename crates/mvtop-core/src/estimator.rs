//! From images to poses: start reading at [`Estimator::predict`].

mod again;
mod believed;
mod closer;
mod complete;
mod decode;
mod doubts;
mod fit;
mod hypotheses;
mod kept;
mod next_view;
mod picture;
mod pose;
mod refined;
mod self_test;
mod sightings;
mod tracker;
mod view;

use std::path::{Path, PathBuf};
use std::time::Instant;

use nalgebra::Isometry3;

use self::believed::{believed, once, printed};
use self::picture::Pictures;
use self::pose::DecodedPose;
use self::sightings::Sighting;
use self::view::View;
use crate::annotations::GivenBoxes;
use crate::bundle::{Bundle, Class, CloseUps, PoseInput};
use crate::image::ViewImage;
use crate::network::{Network, OnnxNetwork};
use crate::prediction::{CameraPose, ObjectPose, Prediction, Timings};
use crate::refine::{self, Edge, Refiner};
use crate::{Error, Result, Rig, onnx};

pub use self::tracker::Tracker;

/// How to run the network.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// ONNX Runtime's library; `None` searches for it, see [`onnx::Runtime::locate`].
    pub ort_lib: Option<PathBuf>,
    /// What runs the graphs, and on how many threads.
    pub session: onnx::SessionOptions,
}

/// What to predict.
#[derive(Debug, Clone, Default)]
pub struct PredictOptions {
    /// Id of the camera in whose frame poses are given (it needs no image); the rig's by default.
    pub reference: Option<String>,
    /// Boxes to use instead of detecting.
    pub boxes: Option<Vec<GivenBoxes>>,
    /// Fewest images in which an object must be detected; 0 and 1 keep all. Given boxes are taken as
    /// they are.
    pub min_views: usize,
    /// Whether poses are refined on the images; by default those of classes with a mesh are.
    pub refine: Option<bool>,
}

/// A loaded network, ready for any number of predictions with any rigs.
pub struct Estimator {
    bundle: Bundle,
    /// Least and greatest half width of each class, metres.
    radii: Vec<[f64; 2]>,
    /// Of each class with a mesh.
    refiners: Vec<Option<Refiner>>,
    network: Box<dyn Network>,
}

/// What poses are decoded from, as far as it is there before the objects are found.
enum Shown<'a> {
    WholeImages(Pictures),
    CloseUps(&'a CloseUps),
}

impl Estimator {
    /// Loads ONNX Runtime and a model bundle.
    ///
    /// # Errors
    /// Where the runtime is missing or too old, the bundle is incomplete, changed or of another
    /// version, or the provider cannot be had.
    pub fn load(bundle: &Path, options: &Options) -> Result<Self> {
        let bundle = Bundle::load(bundle)?;
        let runtime = onnx::Runtime::locate(options.ort_lib.as_deref())?;
        let network = OnnxNetwork::load(&runtime, &bundle, &options.session)?;
        Ok(Self::new(bundle, Box::new(network)))
    }

    /// An estimator with a network that something other than ONNX Runtime runs.
    pub fn new(bundle: Bundle, network: Box<dyn Network>) -> Self {
        let radii = bundle.classes.iter().map(Class::half_widths).collect();
        let refiner = |class: &Class| {
            let refiner = Refiner::new(class.mesh.as_ref()?, class.diameter_m);
            Some(refiner.with_print(&class.points))
        };
        let refiners = bundle.classes.iter().map(refiner).collect();
        Self {
            bundle,
            radii,
            refiners,
            network,
        }
    }

    /// What the network was made for.
    pub fn bundle(&self) -> &Bundle {
        &self.bundle
    }

    /// What refines poses, of each class; `None` of those without a mesh.
    pub(crate) fn refiners(&self) -> &[Option<Refiner>] {
        &self.refiners
    }

    /// Runs the network once on a fixed input and compares its answers with those that the bundle
    /// says it gives; `false` for bundles of earlier exports, which do not say.
    ///
    /// # Errors
    /// [`Error::Bundle`] where they differ, and those of running the network.
    pub fn self_test(&self) -> Result<bool> {
        self_test::run(&self.bundle, self.network.as_ref())
    }

    /// Finds the objects of the bundle's classes, and their poses.
    ///
    /// Poses in the world frame do not depend on which camera is the reference.
    ///
    /// - `images`: in any order; at least one, at most one per camera, of the camera's size
    ///
    /// # Errors
    /// [`Error::TooFewImages`], [`Error::ImageSize`], [`Error::UnknownCamera`],
    /// [`Error::UnknownClass`] and [`Error::Input`] where the images, the reference, the given boxes
    /// or the fewest views do not fit the rig or the bundle; [`Error::Shape`], [`Error::Pose`] and
    /// [`Error::Rotation6d`] where the network does not do its part.
    ///
    /// ```no_run
    /// use std::path::Path;
    /// use mvtop_core::{Estimator, Options, PredictOptions, Rig, ViewImage, image};
    ///
    /// let rig = Rig::load(Path::new("rig.json"))?;
    /// let estimator = Estimator::load(Path::new("models/mvball"), &Options::default())?;
    /// let mut images = Vec::new();
    /// for (camera, file) in ["left.png", "right.png"].into_iter().enumerate() {
    ///     let image = image::load(Path::new(file), &rig.cameras()[camera])?;
    ///     images.push(ViewImage { camera, image });
    /// }
    /// let prediction = estimator.predict(&rig, &images, &PredictOptions::default())?;
    /// for object in &prediction.objects {
    ///     println!("{} at {} m", object.class, object.ref_from_obj.translation);
    /// }
    /// # Ok::<(), mvtop_core::Error>(())
    /// ```
    pub fn predict(
        &self,
        rig: &Rig,
        images: &[ViewImage],
        options: &PredictOptions,
    ) -> Result<Prediction> {
        self.predict_by(self.network.as_ref(), rig, images, options)
    }

    /// [`Estimator::predict`] with the network as `network` runs it.
    fn predict_by(
        &self,
        network: &dyn Network,
        rig: &Rig,
        images: &[ViewImage],
        options: &PredictOptions,
    ) -> Result<Prediction> {
        let mut clock = Clock::start();
        let reference = match &options.reference {
            Some(id) => rig.find("reference", id)?,
            None => rig.reference(),
        };
        if options.refine == Some(true) && self.refiners.iter().all(Option::is_none) {
            return Err(Error::Input(format!(
                "refine: expected a model bundle with a mesh, got {} without; add it with `python \
                 -m mvtop_train.export.mesh`, or do not ask for refinement",
                self.bundle.dir.display()
            )));
        }
        let views = view::gather(&self.bundle, rig, images)?;
        let needed = options.min_views.max(1);
        if views.len() < needed {
            return Err(Error::TooFewImages {
                expected: needed,
                got: views.len(),
            });
        }
        let images = view::tensor(&views, &self.bundle.input)?;
        let prepare;
        let (maps, shown) = match &self.bundle.poses {
            PoseInput::WholeImages { strides } => {
                let list = picture::whole_images(&views, strides);
                let rays = picture::rays(&list);
                prepare = clock.lap();
                let (maps, memory) = network.detect_and_encode(images.view(), rays.view())?;
                (maps, Shown::WholeImages(Pictures::new(list, memory)?))
            }
            PoseInput::CloseUps(closeups) => {
                prepare = clock.lap();
                (network.detect(images.view())?, Shown::CloseUps(closeups))
            }
        };
        let faintest = self.bundle.detector.faintest();
        maps.check(views.len(), self.bundle.classes.len(), faintest)?;
        let features = clock.lap();

        let objects = match &options.boxes {
            Some(boxes) => sightings::given(&self.bundle, rig, &views, boxes)?,
            None => {
                let mut boxes = sightings::in_whole_images(&self.bundle, &views, &maps);
                if let Shown::CloseUps(_) = shown {
                    closer::look(network, &self.bundle, &self.radii, &views, &mut boxes)?;
                }
                let mut objects = sightings::detected(&self.bundle, &self.radii, &views, &boxes);
                objects.retain(|object| object.views() >= options.min_views);
                objects
            }
        };
        let detect = clock.lap();

        let mut closeup = 0.0;
        let (pictures, groups, closeups) = match shown {
            Shown::WholeImages(pictures) => {
                let groups = picture::in_whole_images(&views, &objects);
                (pictures, groups, None)
            }
            Shown::CloseUps(closeups) => {
                let (pictures, groups) =
                    picture::in_closeups(network, &self.bundle, closeups, &views, &objects)?;
                closeup = clock.lap();
                (pictures, groups, Some(closeups))
            }
        };
        let poses = decode::poses(network, &self.bundle, &pictures, &groups)?;
        let poses = fit::settled(&self.bundle, &pictures, &groups, poses);
        let mut found: Vec<(Sighting, DecodedPose)> = objects.into_iter().zip(poses).collect();
        if let (Some(closeups), None) = (closeups, &options.boxes) {
            found = self.completed(network, closeups, &views, found)?;
            found = self.looked_at_again(network, closeups, &views, found)?;
        }
        if options.boxes.is_none() {
            let share = |(object, pose): &(Sighting, DecodedPose)| {
                let class = &self.bundle.classes[object.class];
                complete::share_of_views(class, &views, object, pose)
            };
            let shares: Vec<f64> = found.iter().map(share).collect();
            let least = self.bundle.detector.support_threshold;
            found = believed(found, &shares, least, &self.radii);
        }
        for (object, pose) in &found {
            pose.check_in_front(&views)?;
            pose.check_near(&views, &self.bundle.classes[object.class])?;
        }
        let decode = clock.lap();

        let mut refinements = vec![None; found.len()];
        let mut differences = Vec::new();
        let (mut refine, mut check) = (0.0, 0.0);
        if options.refine != Some(false) {
            refinements = refined::on_images(&self.refiners, &views, &self.bundle, &mut found);
            if options.boxes.is_none() {
                let least = self.bundle.detector.print_threshold;
                (found, refinements) = printed(found, refinements, least);
                (found, refinements) = once(found, refinements, &self.radii);
            }
            refine = clock.lap();
            differences = refined::by_view(&self.refiners, &views, &self.bundle, &found);
            check = clock.lap();
        }
        differences.resize(found.len(), Vec::new());

        let ref_from_world = rig.cameras()[reference].world_from_cam().inverse();
        let mut objects: Vec<ObjectPose> = found
            .into_iter()
            .zip(refinements)
            .map(|((object, pose), refinement)| ObjectPose {
                refinement,
                ..self.object_pose(&views, &ref_from_world, &object, pose)
            })
            .collect();
        let (rig_consistency, doubts) = doubts::of(&self.bundle, rig, &mut objects, differences);
        if let Some(confidence) = &self.bundle.confidence {
            for object in &mut objects {
                object.confidence = confidence.of(object, rig_consistency.as_ref());
            }
        }
        next_view::name(&self.bundle, &self.refiners, rig, &views, &mut objects);
        let mut warnings = view::warnings(&views);
        warnings.extend(doubts);
        Ok(Prediction {
            reference,
            objects,
            rig_consistency,
            timings: Timings {
                prepare,
                features,
                detect,
                closeup,
                decode,
                refine,
                check,
                total: clock.total(),
            },
            provider: self.network.provider().to_owned(),
            warnings,
        })
    }

    /// Where each image should show edges of an object's mesh at its pose, and whether it does, in the
    /// order of `images`; empty for classes without a mesh and images that do not show the object.
    ///
    /// - `object`: predicted on these images
    pub fn edges(&self, rig: &Rig, images: &[ViewImage], object: &ObjectPose) -> Vec<Vec<Edge>> {
        let class = self.bundle.class_index(&object.class);
        let refiner = class.and_then(|class| self.refiners[class].as_ref());
        let edges = |view: &ViewImage| {
            let camera = rig.cameras().get(view.camera)?;
            let view = refine::View {
                camera,
                image: &view.image,
            };
            Some(refiner?.edges(&view, &object.world_from_obj))
        };
        let of_view = |view| edges(view).unwrap_or_default();
        images.iter().map(of_view).collect()
    }

    /// Objects with what single views have missed, and their poses from all that shows them.
    fn completed(
        &self,
        network: &dyn Network,
        closeups: &CloseUps,
        views: &[View],
        found: Vec<(Sighting, DecodedPose)>,
    ) -> Result<Vec<(Sighting, DecodedPose)>> {
        let classes = &self.bundle.classes;
        let merged = complete::merge(classes, views, found);
        let (mut again, mut objects) = (Vec::new(), Vec::new());
        for (index, (object, pose, gained)) in merged.iter().enumerate() {
            let more = complete::filled_in(&classes[object.class], views, object, pose);
            if let Some(object) = more.or_else(|| gained.then(|| object.clone())) {
                again.push(index);
                objects.push(object);
            }
        }
        let mut found: Vec<_> = merged.into_iter().map(|(o, pose, _)| (o, pose)).collect();
        if again.is_empty() {
            return Ok(found);
        }
        let poses = self.decoded(network, closeups, views, &objects)?;
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

    /// The poses of objects, each as its close-ups show it.
    fn decoded(
        &self,
        network: &dyn Network,
        closeups: &CloseUps,
        views: &[View],
        objects: &[Sighting],
    ) -> Result<Vec<DecodedPose>> {
        let (pictures, groups) =
            picture::in_closeups(network, &self.bundle, closeups, views, objects)?;
        let poses = decode::poses(network, &self.bundle, &pictures, &groups)?;
        Ok(fit::settled(&self.bundle, &pictures, &groups, poses))
    }

    fn object_pose(
        &self,
        views: &[View],
        ref_from_world: &Isometry3<f64>,
        object: &Sighting,
        pose: DecodedPose,
    ) -> ObjectPose {
        let class = &self.bundle.classes[object.class];
        let cameras = views
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

/// Milliseconds since the last lap and since the start.
struct Clock {
    start: Instant,
    lap: Instant,
}

impl Clock {
    fn start() -> Self {
        let now = Instant::now();
        Self {
            start: now,
            lap: now,
        }
    }

    fn lap(&mut self) -> f64 {
        let lap = self.lap.elapsed();
        self.lap = Instant::now();
        lap.as_secs_f64() * 1e3
    }

    fn total(&self) -> f64 {
        self.start.elapsed().as_secs_f64() * 1e3
    }
}

#[cfg(test)]
mod tests;
