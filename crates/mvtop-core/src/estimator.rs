//! From images to poses: start reading at [`Estimator::predict`].

mod closeups;
mod pose;
mod sightings;
mod view;

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use image::RgbImage;
use nalgebra::Isometry3;
use ndarray::{Array2, Array3, Axis};

use self::pose::{Pose, decoded_pose, mean_pose};
use self::sightings::Sighting;
use self::view::{Picture, View};
use crate::bundle::{Bundle, Class};
use crate::known::KnownBoxes;
use crate::network::{Network, OnnxNetwork, Queries};
use crate::prediction::{CameraPose, ObjectPose, Prediction, Timings};
use crate::rays::{box_rays, encode};
use crate::{Error, Result, Rig, onnx};

/// How to run the network.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// ONNX Runtime's library; `None` searches for it, see [`onnx::Runtime::locate`].
    pub ort_lib: Option<PathBuf>,
    pub session: onnx::SessionOptions,
}

/// What to predict.
#[derive(Debug, Clone, Default)]
pub struct PredictOptions {
    /// Id of the camera in whose frame poses are given (it needs no image); the rig's by default.
    pub reference: Option<String>,
    /// Boxes to use instead of detecting.
    pub boxes: Option<Vec<KnownBoxes>>,
    /// Fewest images in which an object must be detected; 0 and 1 keep all. Given boxes are taken as
    /// they are.
    pub min_views: usize,
}

/// A loaded network, ready for any number of predictions with any rigs.
pub struct Estimator {
    bundle: Bundle,
    /// Least and greatest half width of each class, metres.
    radii: Vec<[f64; 2]>,
    network: Box<dyn Network>,
}

/// Close-ups of an object that are anchors in turn, at most: more cost time and gain little.
const MAX_ANCHORS: usize = 4;

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
        Self {
            bundle,
            radii,
            network,
        }
    }

    /// What the network was made for.
    pub fn bundle(&self) -> &Bundle {
        &self.bundle
    }

    /// Finds the objects of the bundle's classes, and their poses.
    ///
    /// - `images`: with the index of the camera in the rig, in any order; at least one, at most one
    ///   per camera, of the camera's size
    ///
    /// # Errors
    /// [`Error::Input`] where the images, the reference, the given boxes or the fewest views do not
    /// fit the rig or the bundle; [`Error::Shape`] and [`Error::Pose`] where the network does not
    /// do its part.
    pub fn predict(
        &self,
        rig: &Rig,
        images: &[(usize, RgbImage)],
        options: &PredictOptions,
    ) -> Result<Prediction> {
        let mut clock = Clock::start();
        let reference = reference(rig, options.reference.as_deref())?;
        let views = view::gather(&self.bundle, rig, images)?;
        if options.min_views > views.len() {
            return Err(Error::Input(format!(
                "fewest views of an object: expected at most {}, as there are images, got {}",
                views.len(),
                options.min_views
            )));
        }
        let pictures = views
            .iter()
            .map(|view| view.picture(&self.bundle))
            .collect::<Result<Vec<Picture>>>()?;
        let (tensor, rays) = view::stack(&pictures.iter().collect::<Vec<_>>());
        let prepare = clock.lap();

        let features = self.network.features(tensor, rays)?;
        features.check(views.len(), self.bundle.classes.len())?;
        let features_time = clock.lap();

        let objects = match &options.boxes {
            Some(boxes) => sightings::given(&self.bundle, rig, &views, boxes)?,
            None => {
                let camera = &rig.cameras()[reference];
                let mut objects =
                    sightings::detected(&self.bundle, &self.radii, camera, &views, &features);
                objects.retain(|object| object.views() >= options.min_views);
                objects
            }
        };
        let detect = clock.lap();

        let mut closeup = 0.0;
        let poses = match (&self.bundle.closeup, &features.memory) {
            (Some(closeups), _) => {
                let seen = closeups::take(&self.bundle, &views, reference, &objects, closeups)?;
                let memory = closeups::memory(self.network.as_ref(), &seen)?;
                closeup = clock.lap();
                self.poses_from_closeups(&seen, &memory)?
            }
            (None, Some(memory)) => self.poses(&views, &pictures, reference, memory, &objects)?,
            (None, None) => {
                let problem = "features: expected memory, as there are no close-ups";
                return Err(Error::Input(problem.into()));
            }
        };
        let decode = clock.lap();

        let ref_from_world = rig.cameras()[reference].world_from_cam().inverse();
        Ok(Prediction {
            reference,
            objects: objects
                .iter()
                .zip(poses)
                .map(|(object, pose)| self.object_pose(&views, &ref_from_world, object, pose))
                .collect(),
            timings: Timings {
                prepare,
                features: features_time,
                detect,
                closeup,
                decode,
                total: clock.total(),
            },
            provider: self.network.provider().to_owned(),
        })
    }

    /// Decodes the objects in groups that share an anchor: the reference camera where it sees the
    /// object, else the first camera that does.
    fn poses(
        &self,
        views: &[View],
        pictures: &[Picture],
        reference: usize,
        memory: &Array3<f32>,
        objects: &[Sighting],
    ) -> Result<Vec<Pose>> {
        let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (i, object) in objects.iter().enumerate() {
            let anchor = object.anchor(views, reference);
            groups.entry(anchor.unwrap_or(0)).or_default().push(i);
        }

        let mut poses: Vec<(usize, Pose)> = Vec::new();
        for (anchor, members) in groups {
            let mut order: Vec<usize> = (0..views.len()).collect();
            order.sort_by_key(|&v| Reverse(v == anchor)); // stable: the others keep their order
            let shown: Vec<&Picture> = order.iter().map(|&v| &pictures[v]).collect();
            let boxes = |i: usize| order.iter().map(|&v| objects[i].boxes[v]).collect();
            let members_boxes: Vec<(usize, Vec<_>)> = members
                .iter()
                .map(|&i| (objects[i].class, boxes(i)))
                .collect();
            let queries = self.queries(&shown, &members_boxes);
            let decoded = if anchor == 0 {
                self.network.decode(memory.view(), &queries)?
            } else {
                self.network
                    .decode(memory.select(Axis(0), &order).view(), &queries)?
            };
            decoded.check(members.len())?;
            for (q, &i) in members.iter().enumerate() {
                poses.push((
                    i,
                    decoded_pose(shown[0].camera.world_from_cam(), &decoded, q)?,
                ));
            }
        }
        poses.sort_by_key(|(i, _)| *i);
        Ok(poses.into_iter().map(|(_, pose)| pose).collect())
    }

    /// Decodes each object from its own close-ups, anchored in one after the other: the mean of these
    /// poses errs less than each, and does not depend on which camera is the reference.
    fn poses_from_closeups(
        &self,
        objects: &[closeups::Seen],
        memory: &Array3<f32>,
    ) -> Result<Vec<Pose>> {
        let mut start = 0;
        let mut poses = Vec::new();
        for object in objects {
            let views = object.pictures.len();
            let anchored = (0..views.min(MAX_ANCHORS)).map(|anchor| {
                let mut order: Vec<usize> = (0..views).collect();
                order.sort_by_key(|&v| Reverse(v == anchor)); // stable: the others keep their order
                let shown: Vec<&Picture> = order.iter().map(|&v| &object.pictures[v]).collect();
                let boxes = order.iter().map(|&v| Some(object.boxes[v])).collect();
                let queries = self.queries(&shown, &[(object.class, boxes)]);
                let rows: Vec<usize> = order.iter().map(|v| start + v).collect();
                let memory = memory.select(Axis(0), &rows);
                let decoded = self.network.decode(memory.view(), &queries)?;
                decoded.check(1)?;
                decoded_pose(shown[0].camera.world_from_cam(), &decoded, 0)
            });
            poses.push(mean_pose(&anchored.collect::<Result<Vec<Pose>>>()?));
            start += views;
        }
        Ok(poses)
    }

    /// The decoder's input for objects anchored in the first of `pictures`.
    ///
    /// - `objects`: index of the class, and the box in each of `pictures`, px
    fn queries(
        &self,
        pictures: &[&Picture],
        objects: &[(usize, Vec<Option<[f64; 4]>>)],
    ) -> Queries {
        let (v_len, q_len) = (pictures.len(), objects.len());
        let encoding = self.bundle.los_encoding;
        let cells = pictures[0].camera_rays.nrows();
        let mut queries = Queries {
            rays: Array3::zeros((v_len, cells, encoding.width())),
            centers: Array3::from_elem((v_len, q_len, 2), 0.5),
            half_sizes: Array3::zeros((v_len, q_len, 2)),
            box_rays: Array3::zeros((v_len, q_len, 12)),
            valid: Array2::zeros((v_len, q_len)),
            class_index: objects.iter().map(|(class, _)| *class as i64).collect(),
        };
        let world_from_anchor = pictures[0].camera.world_from_cam();
        for (row, picture) in pictures.iter().enumerate() {
            let anchor_from_cam = world_from_anchor.inv_mul(picture.camera.world_from_cam());
            let rays = encode(picture.camera_rays.view(), &anchor_from_cam, encoding);
            queries.rays.index_axis_mut(Axis(0), row).assign(&rays);
            for (q, (_, boxes)) in objects.iter().enumerate() {
                let Some(bbox) = boxes[row] else {
                    continue;
                };
                let Some(rays) = box_rays(&picture.camera, bbox, &anchor_from_cam) else {
                    continue;
                };
                let (center, half_size) = picture.net_box(bbox);
                for axis in 0..2 {
                    queries.centers[(row, q, axis)] = center[axis] as f32;
                    queries.half_sizes[(row, q, axis)] = half_size[axis] as f32;
                }
                for (i, number) in rays.into_iter().enumerate() {
                    queries.box_rays[(row, q, i)] = number;
                }
                queries.valid[(row, q)] = 1.0;
            }
        }
        queries
    }

    fn object_pose(
        &self,
        views: &[View],
        ref_from_world: &Isometry3<f64>,
        object: &Sighting,
        pose: Pose,
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
            cameras: cameras.collect(),
        }
    }
}

fn reference(rig: &Rig, id: Option<&str>) -> Result<usize> {
    let Some(id) = id else {
        return Ok(rig.reference());
    };
    rig.index_of(id).ok_or_else(|| {
        let known: Vec<&str> = rig.cameras().iter().map(|camera| camera.id()).collect();
        let known = known.join(", ");
        Error::Input(format!(
            "reference: no camera `{id}` in the rig, expected one of: {known}"
        ))
    })
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
