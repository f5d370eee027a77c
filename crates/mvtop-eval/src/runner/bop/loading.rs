//! A planned group as a sample: its images, the rig of their cameras and the truth.

use std::collections::BTreeMap;

use crate::bop::{Frame, Group, Instance, Scene};
use mvtop_core::annotations::{GivenBoxes, TruePose};
use mvtop_core::image::load_views;
use mvtop_core::pose::translation_error;
use mvtop_core::{Camera, Rig};
use nalgebra::Isometry3;

use super::plan::{Plan, name};
use crate::runner::sample::Sample;
use crate::{Error, Result};

/// Annotations of one object in two views are of the same one where its origins in the world are no
/// farther apart, in diameters.
const SAME_OBJECT: f64 = 0.2;
/// Share of an object's pixels, hidden ones and those beside the image counted, from which a view
/// counts as one that has it in sight.
const IN_SIGHT: f64 = 0.5;
/// Distance of an object's origin from a camera, in diameters, that only metres taken for millimetres
/// come below: the origin of a large plate, or one beside its object, may well be near.
const LEAST_AWAY: f64 = 0.04;

impl Plan {
    /// The images of a group, a rig of their cameras, and the objects of the targets in the reference.
    ///
    /// # Errors
    /// Where an image cannot be read, or numbers look like a mistake.
    pub fn load(&self, group: &Group) -> Result<Sample> {
        let mut sample = self.known(group)?;
        let frames = &self.scenes[&group.scene].frames;
        let files = group.views.iter().map(|id| &frames[id].path).enumerate();
        sample.images = load_views(&sample.rig, &files.collect::<Vec<_>>())?;
        Ok(sample)
    }

    /// The same without the images.
    pub(super) fn known(&self, group: &Group) -> Result<Sample> {
        let scene = &self.scenes[&group.scene];
        let views: Vec<&Frame> = group.views.iter().map(|id| &scene.frames[id]).collect();
        let mut cameras = Vec::new();
        for view in &views {
            let size = mvtop_core::image::size(&view.path)?;
            let world_from_cam = match view.world_from_cam {
                Some(pose) => pose,
                // One view needs no world.
                None if views.len() == 1 => Isometry3::identity(),
                None => {
                    return Err(Error::Input(format!(
                        "{}: image {}: expected cam_R_w2c and cam_t_w2c in scene_camera.json, got \
                         none; several views need to know where their cameras stand, so add them \
                         or give --views 1",
                        scene.folder.display(),
                        view.id
                    )));
                }
            };
            let (id, intrinsics) = (view.id.camera_id(), view.intrinsics.clone());
            cameras.push(Camera::new(id, size, intrinsics, world_from_cam)?);
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
        let visible = |object: &&Instance| object.visible.unwrap_or(1.0);
        // Targets are the most visible instances, as BOP has it.
        let targets = self.first(group, wanted.collect(), |object| object.object, visible);
        Ok(Sample {
            name: name(group),
            truth: targets.into_iter().map(known).collect(),
            images: Vec::new(),
            rig,
        })
    }

    /// Objects that views of a group show and that are not in its truth: those that lie beside the
    /// reference image, and those that the targets do not ask for.
    ///
    /// - `sample`: of the group
    pub(super) fn beside(&self, group: &Group, sample: &Sample) -> Vec<TruePose> {
        let frames = &self.scenes[&group.scene].frames;
        let mut beside: Vec<TruePose> = Vec::new();
        for (id, camera) in group.views.iter().zip(sample.rig.cameras()) {
            for object in &frames[id].objects {
                let Some(model) = self.models.get(&object.object) else {
                    continue;
                };
                let class = &self.classes[&object.object];
                let world_from_obj = camera.world_from_cam() * object.cam_from_obj;
                let same = |known: &TruePose| {
                    let off = translation_error(&known.world_from_obj, &world_from_obj);
                    known.seen.class == *class && off <= SAME_OBJECT * model.diameter_m
                };
                if !sample.truth.iter().chain(&beside).any(same) {
                    let class = class.clone();
                    let boxes = BTreeMap::new();
                    beside.push(TruePose {
                        seen: GivenBoxes { class, boxes },
                        world_from_obj,
                    });
                }
            }
        }
        beside
    }

    /// Refuses numbers that look like a mistake.
    fn check(&self, scene: &Scene, view: &Frame, camera: &Camera) -> Result<()> {
        let place = format!("{}: image {}", scene.folder.display(), view.id);
        let center = [camera.width(), camera.height()].map(|side| f64::from(side - 1) / 2.0);
        if camera.intrinsics().unproject(&center.into()).is_none() {
            return Err(Error::Input(format!(
                "{place}: expected a lens that sees the image's center, got cam_K and cam_dist by \
                 which no ray meets it"
            )));
        }
        for object in &view.objects {
            let Some(model) = self.models.get(&object.object) else {
                continue;
            };
            let distance = object.cam_from_obj.translation.vector.norm();
            if distance < LEAST_AWAY * model.diameter_m {
                return Err(Error::Input(format!(
                    "{place}: object {}: expected millimetres in cam_t_m2c, got {:.4} mm from the \
                     camera, where its middle can't be",
                    object.object,
                    1e3 * distance
                )));
            }
        }
        Ok(())
    }

    /// The annotated boxes of one object.
    fn boxes(
        &self,
        id: u32,
        world_from_obj: &Isometry3<f64>,
        views: &[&Frame],
        rig: &Rig,
    ) -> GivenBoxes {
        let seen = |(view, camera): (&&Frame, &Camera)| {
            let bbox = self.annotated(id, world_from_obj, view, camera)?.bbox?;
            // An object may be annotated where it is wholly beside the image.
            bbox.clip(camera.width(), camera.height())?;
            Some((camera.id().to_owned(), bbox))
        };
        GivenBoxes {
            class: self.classes[&id].clone(),
            boxes: views.iter().zip(rig.cameras()).filter_map(seen).collect(),
        }
    }

    /// Views of a group in which at least [`IN_SIGHT`] of an object is visible; `None` where one that
    /// shows it does not say how much.
    ///
    /// - `id`: of the object
    /// - `rig`: of the group's cameras
    pub(super) fn views_in_sight(
        &self,
        group: &Group,
        id: u32,
        world_from_obj: &Isometry3<f64>,
        rig: &Rig,
    ) -> Option<usize> {
        let frames = &self.scenes[&group.scene].frames;
        let views = group.views.iter().map(|view| &frames[view]);
        let annotated = views
            .zip(rig.cameras())
            .filter_map(|(view, camera)| self.annotated(id, world_from_obj, view, camera));
        let visible: Option<Vec<f64>> = annotated.map(|object| object.visible).collect();
        Some(visible?.iter().filter(|&&share| share >= IN_SIGHT).count())
    }

    /// The annotation of one object in a view: annotations have no identity across views, but a place.
    fn annotated<'a>(
        &self,
        id: u32,
        world_from_obj: &Isometry3<f64>,
        view: &'a Frame,
        camera: &Camera,
    ) -> Option<&'a Instance> {
        let off = |object: &Instance| {
            translation_error(
                &(camera.world_from_cam() * object.cam_from_obj),
                world_from_obj,
            )
        };
        let alike = view.objects.iter().filter(|object| object.object == id);
        let nearest = alike.min_by(|a, b| off(a).total_cmp(&off(b)))?;
        (off(nearest) <= SAME_OBJECT * self.models[&id].diameter_m).then_some(nearest)
    }
}
