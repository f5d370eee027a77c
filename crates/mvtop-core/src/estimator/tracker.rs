//! Predictions of one rig, again and again.

use std::sync::Arc;

use super::{Estimator, PredictOptions, TrackOptions, Tracks, view};
use crate::image::ViewImage;
use crate::network::cached::{Answers, Cached};
use crate::{Prediction, Result, Rig};

/// Keeps the latest image of each camera of a rig, and what the network has said of it, so that a
/// new image of one camera does not compute those of the others again.
///
/// What is kept are the detector's maps of each image and the features of each close-up, compared
/// number by number with what is asked for; boxes are matched and poses decoded anew from all views.
/// So a prediction is that of [`Estimator::predict`] on the same images, but that objects have numbers
/// ([`ObjectPose::track_id`](crate::prediction::ObjectPose::track_id)) that stay theirs over time, see
/// [`Tracks`].
///
/// ```no_run
/// use std::path::Path;
/// use std::sync::Arc;
/// use mvtop_core::estimator::Tracker;
/// use mvtop_core::{Estimator, Options, PredictOptions, Rig, ViewImage, image};
///
/// let rig = Arc::new(Rig::load(Path::new("rig.json"))?);
/// let estimator = Arc::new(Estimator::load(Path::new("models/mvball"), &Options::default())?);
/// let mut tracker = Tracker::new(estimator, rig.clone());
/// for (camera, file) in [(0, "left.png"), (1, "right.png"), (0, "left-later.png")] {
///     let image = image::load(Path::new(file), &rig.cameras()[camera])?;
///     tracker.update(vec![ViewImage { camera, image }])?;
///     let prediction = tracker.predict(&PredictOptions::default())?;
///     println!("{} objects", prediction.objects.len());
/// }
/// # Ok::<(), mvtop_core::Error>(())
/// ```
pub struct Tracker {
    estimator: Arc<Estimator>,
    rig: Arc<Rig>,
    /// At most one per camera, in the order of the rig.
    images: Vec<ViewImage>,
    answers: Answers,
    tracks: Tracks,
}

impl Tracker {
    /// A tracker without images.
    pub fn new(estimator: Arc<Estimator>, rig: Arc<Rig>) -> Self {
        Self {
            estimator,
            rig,
            images: Vec::new(),
            answers: Answers::default(),
            tracks: Tracks::default(),
        }
    }

    /// The tracker with another way to follow objects; those followed so far are forgotten.
    #[must_use]
    pub fn with_tracks(self, options: TrackOptions) -> Self {
        Self {
            tracks: Tracks::new(options),
            ..self
        }
    }

    /// Indices of the cameras whose images are kept, in the rig's order.
    pub fn cameras(&self) -> impl Iterator<Item = usize> {
        self.images.iter().map(|view| view.camera)
    }

    /// Forgets the image of a camera, by its index in the rig: of one that is off, say.
    pub fn remove(&mut self, camera: usize) {
        self.images.retain(|view| view.camera != camera);
    }

    /// Takes over new images, each in the place of the one of its camera.
    ///
    /// - `images`: in any order, at most one per camera
    ///
    /// # Errors
    /// [`Error::ImageSize`](crate::Error::ImageSize) and [`Error::Input`](crate::Error::Input) where
    /// they do not fit the rig; none is then taken over.
    pub fn update(&mut self, images: Vec<ViewImage>) -> Result<()> {
        view::gather(&self.estimator.bundle, None, &self.rig, &images)?;
        for new in images {
            self.remove(new.camera);
            self.images.push(new);
        }
        self.images.sort_by_key(|view| view.camera);
        Ok(())
    }

    /// Finds objects and their poses in the latest image of each camera.
    ///
    /// # Errors
    /// Those of [`Estimator::predict`].
    pub fn predict(&mut self, options: &PredictOptions) -> Result<Prediction> {
        let network = Cached {
            network: self.estimator.network.as_ref(),
            answers: &self.answers,
        };
        let prediction = self
            .estimator
            .predict_by(&network, &self.rig, &self.images, options);
        self.answers.forget_unused();
        let mut prediction = prediction?;
        self.tracks.follow(&mut prediction, &self.estimator.bundle);
        Ok(prediction)
    }
}
