//! What `eval bop` goes through: scenes, groups of views, and the objects in them.

use std::collections::BTreeMap;
use std::path::Path;

use mvtop_core::annotations::{GivenBoxes, TruePose};
use mvtop_core::pose::translation_error;
use mvtop_core::{Camera, Estimator, Rig, ViewImage};
use mvtop_eval::bop::{Frame, FrameId, Group, Instance, Model, Scene, Target};
use mvtop_eval::bop::{groups, load_models, load_targets, scene_ids};
use nalgebra::Isometry3;

use crate::eval::args::BopArgs;
use crate::eval::sample::Sample;
use crate::failure::{Failure, Result};

/// Annotations of one object in two views are of the same one where its origins in the world are no
/// farther apart, in diameters.
const SAME_OBJECT: f64 = 0.2;

/// What is evaluated.
pub struct Plan {
    /// By obj_id; those that the network knows and that were asked for.
    pub models: BTreeMap<u32, Model>,
    /// Name of the network's class, by obj_id.
    pub classes: BTreeMap<u32, String>,
    pub scenes: BTreeMap<u32, Scene>,
    pub groups: Vec<Group>,
}

/// `000048/000001+000036`: scene, then views.
pub fn name(group: &Group) -> String {
    let views: Vec<String> = group.views.iter().map(FrameId::to_string).collect();
    format!("{:06}/{}", group.scene, views.join("+"))
}

impl Plan {
    pub fn new(args: &BopArgs, estimator: &Estimator) -> Result<Self> {
        let options = &args.split;
        let root: &Path = &options.dataset;
        let asked = |id: &u32| options.objects.as_ref().is_none_or(|ids| ids.contains(id));
        let known = estimator.bundle().classes.iter();
        let classes: BTreeMap<u32, String> = known
            .filter_map(|class| Some((u32::try_from(class.id).ok()?, class.name.clone())))
            .filter(|(id, _)| asked(id))
            .collect();
        let models = load_models(root, |id| classes.contains_key(&id))?;
        check_names(&models, &classes)?;
        if let Some(id) = classes.keys().find(|id| !models.contains_key(id)) {
            return Err(Failure(format!(
                "{}: expected object {id} in models_info.json, as the model's class `{}` has this \
                 id, got none; choose objects with --objects",
                root.display(),
                classes[id]
            )));
        }
        if classes.is_empty() {
            return Err(Failure(
                "the model knows none of the objects in --objects; leave it out to evaluate those \
                 it knows"
                    .into(),
            ));
        }
        let folder = root.join(&options.split);
        let targets = options.targets.as_deref().map(load_targets).transpose()?;
        let ids = scene_ids(&folder)?;
        if let Some(target) = targets.iter().flatten().find(|t| !ids.contains(&t.scene)) {
            return Err(Failure(format!(
                "{}: expected scene {:06}, which is a target, got none; choose another --split",
                folder.display(),
                target.scene
            )));
        }
        let mut plan = Self {
            models,
            classes,
            scenes: BTreeMap::new(),
            groups: Vec::new(),
        };
        for id in ids {
            let of_scene = |all: &Vec<Target>| -> Vec<Target> {
                all.iter().filter(|t| t.scene == id).cloned().collect()
            };
            let of_scene = targets.as_ref().map(of_scene);
            if of_scene.as_ref().is_some_and(Vec::is_empty) {
                continue;
            }
            let scene = Scene::load(&folder, id)?;
            let views = args.trial.views.map(|views| views as usize);
            let sensor = options.sensor.as_deref();
            let mut found = groups(&scene, options.grouping, views, sensor, of_scene)?;
            found.retain(|group| plan.asks(&scene, group));
            plan.groups.extend(found);
            plan.scenes.insert(id, scene);
        }
        if plan.groups.is_empty() {
            let known: Vec<String> = plan.classes.keys().map(u32::to_string).collect();
            return Err(Failure(format!(
                "{}: no image shows any of the objects {}, which the model knows; choose another \
                 --split or another --model",
                folder.display(),
                known.join(", ")
            )));
        }
        Ok(plan)
    }

    /// Whether there is something to predict in a group; of images without annotations that is not
    /// known, so it is tried.
    fn asks(&self, scene: &Scene, group: &Group) -> bool {
        let annotated = &scene.frames[&group.views[0]].objects;
        annotated.is_empty() || annotated.iter().any(|o| self.wanted(group, o.object))
    }

    /// Whether a group asks for an object.
    pub fn wanted(&self, group: &Group, object: u32) -> bool {
        let targets = group.objects.as_ref();
        targets.is_none_or(|ids| ids.contains(&object)) && self.models.contains_key(&object)
    }

    /// obj_id of a class.
    pub fn object(&self, class: &str) -> Option<u32> {
        let mut classes = self.classes.iter();
        classes.find(|(_, name)| *name == class).map(|(&id, _)| id)
    }

    /// The group of that name.
    pub fn group(&self, wanted: &str) -> Option<&Group> {
        self.groups.iter().find(|group| name(group) == wanted)
    }

    /// The images of a group, a rig of their cameras, and the objects annotated in the reference.
    pub fn load(&self, group: &Group) -> Result<Sample> {
        let scene = &self.scenes[&group.scene];
        let views: Vec<&Frame> = group.views.iter().map(|id| &scene.frames[id]).collect();
        let mut cameras = Vec::new();
        let mut images = Vec::new();
        for view in &views {
            let size = mvtop_core::image::size(&view.path)?;
            let world_from_cam = match view.world_from_cam {
                Some(pose) => pose,
                // One view needs no world.
                None if views.len() == 1 => Isometry3::identity(),
                None => {
                    return Err(Failure(format!(
                        "{}: image {}: expected cam_R_w2c and cam_t_w2c in scene_camera.json, got \
                         none; several views need to know where their cameras stand, so add them \
                         or give --views 1",
                        scene.folder.display(),
                        view.id
                    )));
                }
            };
            let (id, intrinsics) = (view.id.camera_id(), view.intrinsics.clone());
            let camera = Camera::new(id, size, intrinsics, world_from_cam)?;
            images.push(ViewImage {
                camera: cameras.len(),
                image: mvtop_core::image::load(&view.path, &camera)?,
            });
            cameras.push(camera);
        }
        let rig = Rig::new(cameras, 0)?;
        for (view, camera) in views.iter().zip(rig.cameras()) {
            self.check(scene, view, camera)?;
        }
        let world_from_ref = rig.reference_camera().world_from_cam();
        let known = |object: &Instance| {
            let world_from_obj = world_from_ref * object.cam_from_obj;
            TruePose {
                seen: self.boxes(object.object, &world_from_obj, &views, &rig),
                world_from_obj,
            }
        };
        let annotated = views[0].objects.iter();
        let wanted = annotated.filter(|object| self.wanted(group, object.object));
        Ok(Sample {
            name: name(group),
            truth: wanted.map(known).collect(),
            images,
            rig,
        })
    }

    /// Refuses numbers that look like a mistake.
    fn check(&self, scene: &Scene, view: &Frame, camera: &Camera) -> Result<()> {
        let place = format!("{}: image {}", scene.folder.display(), view.id);
        let center = [camera.width(), camera.height()].map(|side| f64::from(side - 1) / 2.0);
        if camera.intrinsics().unproject(&center.into()).is_none() {
            return Err(Failure(format!(
                "{place}: expected a lens that sees the image's center, got cam_K and cam_dist by \
                 which no ray meets it"
            )));
        }
        for object in &view.objects {
            let Some(model) = self.models.get(&object.object) else {
                continue;
            };
            let distance = object.cam_from_obj.translation.vector.norm();
            if distance < model.diameter_m / 4.0 {
                return Err(Failure(format!(
                    "{place}: object {}: expected millimetres in cam_t_m2c, got {:.4} mm from the \
                     camera, which would be within the object",
                    object.object,
                    1e3 * distance
                )));
            }
        }
        Ok(())
    }

    /// The annotated boxes of one object: annotations have no identity across views, but a place.
    fn boxes(
        &self,
        id: u32,
        world_from_obj: &Isometry3<f64>,
        views: &[&Frame],
        rig: &Rig,
    ) -> GivenBoxes {
        let reach = SAME_OBJECT * self.models[&id].diameter_m;
        let seen = |(view, camera): (&&Frame, &Camera)| {
            let off = |object: &Instance| {
                translation_error(
                    &(camera.world_from_cam() * object.cam_from_obj),
                    world_from_obj,
                )
            };
            let alike = view.objects.iter().filter(|object| object.object == id);
            let nearest = alike.min_by(|a, b| off(a).total_cmp(&off(b)))?;
            let bbox = nearest.bbox.filter(|_| off(nearest) <= reach)?;
            // An object may be annotated where it is wholly beside the image.
            bbox.clip(camera.width(), camera.height())?;
            Some((camera.id().to_owned(), bbox))
        };
        GivenBoxes {
            class: self.classes[&id].clone(),
            boxes: views.iter().zip(rig.cameras()).filter_map(seen).collect(),
        }
    }
}

/// A data set's object and a class of the same number may be different things.
fn check_names(models: &BTreeMap<u32, Model>, classes: &BTreeMap<u32, String>) -> Result<()> {
    for (id, model) in models {
        let class = &classes[id];
        if let Some(name) = model.name.as_ref().filter(|name| *name != class) {
            return Err(Failure(format!(
                "object {id} is `{name}` in models_info.json and `{class}` in the model; give the \
                 model that was trained on this data set"
            )));
        }
    }
    Ok(())
}
