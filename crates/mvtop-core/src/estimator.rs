//! From images to poses: start reading at [`Estimator::predict`].

mod augmentation;
mod color_check;
mod contradiction;
mod crops;
mod decoder;
mod detections;
mod grouping;
mod instance;
mod near_miss;
mod next_view;
mod nms;
mod occlusion;
mod pipeline;
mod pnp;
mod priors;
mod proposals;
mod refinement;
mod rematch;
mod reprojection;
mod rig_check;
mod rig_test;
mod self_test;
mod tiling;
mod tracker;
mod tracks;
mod verification;
mod view;
mod wanted;

#[cfg(feature = "onnx")]
use std::path::{Path, PathBuf};

use derive_setters::Setters;

use self::pipeline::Pipeline;
use crate::annotations::GivenBoxes;
use crate::bundle::{Bundle, Class};
use crate::config::InferenceConfig;
use crate::image::{Pyramid, ViewImage};
use crate::network::Network;
#[cfg(feature = "onnx")]
use crate::network::OnnxNetwork;
#[cfg(feature = "onnx")]
use crate::onnx;
use crate::prediction::{ObjectPose, Prediction};
use crate::refine::{self, Edge, Refiner};
use crate::request::{Plane, Prior};
use crate::scorer::Scorer;
use crate::{Error, Result, Rig, cancel};

pub use self::detections::MOST_GIVEN;
pub use self::tracker::Tracker;
pub use self::tracks::{TrackOptions, Tracks};

/// How to run the network.
#[derive(Debug, Clone, Default, Setters)]
#[setters(prefix = "with_", strip_option)]
#[non_exhaustive]
pub struct Options {
    /// ONNX Runtime's library; `None` searches for it, see [`onnx::Runtime::locate`].
    #[cfg(feature = "onnx")]
    #[setters(into)]
    pub ort_lib: Option<PathBuf>,
    /// What runs the graphs, and on how many threads.
    #[cfg(feature = "onnx")]
    pub session: onnx::SessionOptions,
    /// Inference settings that replace the bundle's, by dotted path, as in `search.settled`.
    pub inference: Vec<(String, serde_json::Value)>,
}

/// What to predict.
///
/// ```
/// let options = mvtop_core::estimator::PredictOptions::default()
///     .with_reference("left")
///     .with_min_views(2);
/// ```
#[derive(Debug, Clone, Default, Setters)]
#[setters(prefix = "with_", strip_option)]
#[non_exhaustive]
pub struct PredictOptions {
    /// Id of the camera in whose frame poses are given (it needs no image); the rig's by default.
    #[setters(into)]
    pub reference: Option<String>,
    /// Boxes to use instead of detecting.
    pub boxes: Option<Vec<GivenBoxes>>,
    /// Fewest images in which an object must be detected; 0 and 1 keep all. Given boxes are taken as
    /// they are.
    pub min_views: usize,
    /// Whether poses are refined on the images; by default those of classes with a mesh are.
    pub refine: Option<bool>,
    /// Only objects of these classes, by name. Others are looked at only where their boxes overlap one
    /// of these: they may hide such an object, or stand in its place.
    pub classes: Option<Vec<String>>,
    /// Rough poses: where objects of their classes are looked for, and where alone they may be.
    pub priors: Vec<Prior>,
    /// Planes on which objects of their classes stand upright.
    pub planes: Vec<Plane>,
    /// Whether to say what came nearest of each class without an object.
    pub why: bool,
}

/// A loaded network, ready for any number of predictions with any rigs.
pub struct Estimator {
    bundle: Bundle,
    config: InferenceConfig,
    /// The bundle's, or one that ranks candidates.
    scorer: Scorer,
    /// Least and greatest half width of each class, metres.
    radii: Vec<[f64; 2]>,
    /// Of each class with a mesh.
    refiners: Vec<Option<Refiner>>,
    network: Box<dyn Network>,
}

impl Estimator {
    /// Loads ONNX Runtime and a model bundle.
    ///
    /// # Errors
    /// Where the runtime is missing or too old, the bundle is incomplete, changed or of another
    /// version, or the provider cannot be had.
    #[cfg(feature = "onnx")]
    pub fn load(bundle: &Path, options: &Options) -> Result<Self> {
        let (bundle, runtime) = rayon::join(
            || Bundle::load(bundle),
            || onnx::Runtime::locate(options.ort_lib.as_deref()),
        );
        let (bundle, runtime) = (bundle?, runtime?);
        let network = OnnxNetwork::load(&runtime, &bundle, &options.session)?;
        let config = bundle.inference.with(&options.inference)?;
        Ok(Self::with_config(bundle, config, Box::new(network)))
    }

    /// An estimator with a network that something other than ONNX Runtime runs.
    pub fn new(bundle: Bundle, network: Box<dyn Network>) -> Self {
        let config = bundle.inference.clone();
        Self::with_config(bundle, config, network)
    }

    fn with_config(bundle: Bundle, config: InferenceConfig, network: Box<dyn Network>) -> Self {
        let radii = bundle.classes.iter().map(Class::half_widths).collect();
        let refiner = |class: &Class| {
            let mesh = class.mesh.as_ref()?;
            let refiner = Refiner::with_config(mesh, class.diameter_m, config.refine.clone());
            let refiner = refiner.with_symmetry(class.symmetry.clone());
            Some(refiner.with_texture(&class.points))
        };
        let refiners = bundle.classes.iter().map(refiner).collect();
        Self {
            scorer: bundle.scorer.clone().unwrap_or_default(),
            config,
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

    /// Refuses a bundle none of whose classes has a mesh.
    ///
    /// - `role`: what needs one, for the error
    /// - `without`: how to do without, for the error
    ///
    /// # Errors
    /// [`Error::Input`].
    pub fn needs_mesh(&self, role: &str, without: &str) -> Result<()> {
        if self.refiners.iter().any(Option::is_some) {
            return Ok(());
        }
        Err(Error::Input(format!(
            "{role}: expected a model bundle with a mesh, got {} without; add it with \
             `mvtop-train mesh`, or {without}",
            self.bundle.dir.display()
        )))
    }

    /// The numbers that steer inference.
    pub fn config(&self) -> &InferenceConfig {
        &self.config
    }

    pub(crate) fn scorer(&self) -> &Scorer {
        &self.scorer
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
    /// [`Error::TooFewImages`], [`Error::ImageSize`], [`Error::Geometry`],
    /// [`Error::UnknownClass`] and [`Error::Input`] where the images, the reference, the given boxes
    /// or the fewest views do not fit the rig or the bundle; [`Error::Shape`], [`Error::Pose`] and
    /// [`Error::Geometry`] where the network does not do its part.
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
        let reference = match &options.reference {
            Some(id) => rig.find("reference", id)?,
            None => rig.reference(),
        };
        let prediction = Pipeline::new(self, network, rig, images, options)?.predict(reference);
        cancel::check()?;
        prediction
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
            let image = &Pyramid::new(&view.image);
            let view = refine::View { camera, image };
            Some(refiner?.edges(&view, &object.world_from_obj))
        };
        let of_view = |view| edges(view).unwrap_or_default();
        images.iter().map(of_view).collect()
    }
}

#[cfg(test)]
mod tests;
