//! `eval --dataset`: a split of a data set in BOP's layout.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::time::Instant;

use mvtop_core::bop::{Group, Instance, Model, Scene, View, ViewId};
use mvtop_core::bop::{groups, load_depth, load_models, load_targets, scene_ids};
use mvtop_core::known::{KnownBoxes, KnownPose};
use mvtop_core::prediction::ObjectPose;
use mvtop_core::{Camera, Estimator, Rig};
use nalgebra::Isometry3;
use serde::Serialize;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::journal::{Estimate, Journal, Line, write_whole};
use super::outcome::{Outcome, outcomes};
use super::sample::Sample;
use super::score::{self, Scored, Scores};
use super::summary::Summary;
use super::{html, json_error, noise, progress};
use crate::args::Eval;
use crate::failure::{Failure, Result, print};
use crate::matching::{matches, unmatched};
use crate::model_dir;

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

/// `summary.json`: what `eval --samples` says, and BOP's metrics.
#[derive(Serialize)]
pub struct Results {
    #[serde(flatten)]
    pub summary: Summary,
    pub all: Scores,
    /// By obj_id.
    pub objects: BTreeMap<u32, Scores>,
}

pub fn run(args: &Eval, root: &Path, report: &Path) -> Result<()> {
    let bundle = model_dir::find(args.network.model.as_deref())?;
    let estimator = Estimator::load(&bundle, &args.network.options())?;
    let plan = Plan::new(args, root, &estimator)?;
    let about = about(args, root, &bundle)?;
    let (mut journal, mut lines) = Journal::open(report, &about, args.force)?;

    let done: HashSet<String> = lines.iter().map(|line| line.group.clone()).collect();
    let bar = progress(plan.groups.len(), "groups");
    bar.inc(done.len() as u64);
    bar.reset_eta();
    for group in &plan.groups {
        if done.contains(&name(group)) {
            continue;
        }
        let line = plan.evaluate(group, args, &estimator)?;
        journal.append(&line)?;
        lines.push(line);
        bar.inc(1);
    }
    bar.finish_and_clear();

    let results = Results::new(&lines, args.resolved_deg);
    let dataset = folder_name(root);
    let results_csv = format!("mvtop_{dataset}-{}.csv", args.split.split);
    write_whole(&report.join(results_csv), &csv(&lines))?;
    let summary = serde_json::to_string(&results).map_err(json_error)?;
    write_whole(&report.join("summary.json"), &format!("{summary}\n"))?;
    let page = html::page(&about, &results, &lines, &plan)?;
    write_whole(&report.join("report.html"), &page)?;
    print(&summary)
}

/// What results depend on. Where files lie is no part of it, but for the names of the data set.
fn about(args: &Eval, root: &Path, bundle: &Path) -> Result<Value> {
    let hash = |path: &Path| {
        let bytes = std::fs::read(path)
            .map_err(|cause| Failure(format!("cannot read {}: {cause}", path.display())))?;
        Ok::<_, Failure>(format!("{:x}", Sha256::digest(bytes)))
    };
    let split = &args.split;
    Ok(json!({
        "dataset": folder_name(root),
        "split": split.split,
        "grouping": split.grouping.to_string(),
        "sensor": split.sensor,
        "views": args.views,
        "objects": split.objects,
        "targets_sha256": split.targets.as_deref().map(hash).transpose()?,
        // It holds the hashes of all other files of the bundle.
        "model_sha256": hash(&bundle.join("model.json"))?,
        "true_boxes": args.true_boxes,
        "box_noise": args.box_noise,
        "rig_noise_deg": args.rig_noise_deg,
        "rig_noise_mm": args.rig_noise_mm,
        "noise_seed": args.noise_seed,
        "vsd_delta_mm": split.vsd_delta_mm,
    }))
}

fn folder_name(path: &Path) -> String {
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// `000048/000001+000036`: scene, then views.
fn name(group: &Group) -> String {
    let views: Vec<String> = group.views.iter().map(ViewId::to_string).collect();
    format!("{:06}/{}", group.scene, views.join("+"))
}

impl Plan {
    fn new(args: &Eval, root: &Path, estimator: &Estimator) -> Result<Self> {
        let options = &args.split;
        let classes: BTreeMap<u32, String> = estimator
            .bundle()
            .classes
            .iter()
            .filter_map(|class| Some((u32::try_from(class.id).ok()?, class.name.clone())))
            .filter(|(id, _)| options.objects.as_ref().is_none_or(|ids| ids.contains(id)))
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
            let of_scene: Option<Vec<_>> = targets
                .as_ref()
                .map(|all| all.iter().filter(|target| target.scene == id).collect());
            if of_scene.as_ref().is_some_and(Vec::is_empty) {
                continue;
            }
            let scene = Scene::load(&folder, id)?;
            let views = args.views.map(|views| views as usize);
            let sensor = options.sensor.as_deref();
            let found = groups(&scene, options.grouping, views, sensor, of_scene.as_deref())?;
            let asked = found.into_iter().filter(|group| plan.asks(&scene, group));
            let asked: Vec<Group> = asked.collect();
            plan.groups.extend(asked);
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
        let annotated = &scene.views[&group.views[0]].objects;
        annotated.is_empty()
            || annotated
                .iter()
                .any(|object| self.wanted(group, object.object))
    }

    fn wanted(&self, group: &Group, object: u32) -> bool {
        let target = group
            .objects
            .as_ref()
            .is_none_or(|ids| ids.contains(&object));
        target && self.models.contains_key(&object)
    }

    /// obj_id of a class.
    fn object(&self, class: &str) -> Option<u32> {
        self.classes
            .iter()
            .find(|(_, name)| *name == class)
            .map(|(&id, _)| id)
    }

    /// The group of that name.
    pub fn group(&self, wanted: &str) -> Option<&Group> {
        self.groups.iter().find(|group| name(group) == wanted)
    }

    fn evaluate(&self, group: &Group, args: &Eval, estimator: &Estimator) -> Result<Line> {
        let sample = self.load(group)?;
        let start = Instant::now();
        let mut prediction = sample.predict(estimator, args.true_boxes, &noise(args))?;
        let time_s = start.elapsed().as_secs_f64();
        // Objects that are not asked for are neither right nor wrong.
        prediction.objects.retain(|found| {
            self.object(&found.class)
                .is_some_and(|id| self.wanted(group, id))
        });
        let matched = matches(&sample.truth, &prediction);
        let outcomes = outcomes(&sample, group.views.len(), &prediction, &matched, estimator);
        let depth = load_depth(&self.scenes[&group.scene].views[&group.views[0]])?;
        let view = score::View {
            camera: &sample.rig.cameras[sample.rig.reference],
            depth: depth.as_ref(),
            vsd_delta: args.split.vsd_delta_mm * 1e-3,
        };
        let scored = |(i, outcome): (usize, Outcome)| {
            let known = &sample.truth[i];
            let model = &self.models[&self.object(&known.seen.class)?];
            let scored = Scored::new(outcome, known, matched[i], model, &view);
            Some(scored.map_err(|problem| Failure(format!("{}: {problem}", sample.name))))
        };
        let ViewId { sensor, image } = group.views[0].clone();
        Ok(Line {
            group: sample.name.clone(),
            scene: group.scene,
            sensor,
            image,
            time_s,
            extra: unmatched(&matched, &prediction),
            estimates: prediction
                .objects
                .iter()
                .filter_map(|found| Some(estimate(self.object(&found.class)?, found)))
                .collect(),
            objects: outcomes
                .into_iter()
                .enumerate()
                .filter_map(scored)
                .collect::<Result<_>>()?,
        })
    }

    /// The images of a group, a rig of their cameras, and the objects annotated in the reference.
    pub fn load(&self, group: &Group) -> Result<Sample> {
        let scene = &self.scenes[&group.scene];
        let views: Vec<&View> = group.views.iter().map(|id| &scene.views[id]).collect();
        let mut rig = Rig {
            cameras: Vec::new(),
            reference: 0,
        };
        let mut images = Vec::new();
        for view in &views {
            let (width, height) = image::image_dimensions(&view.path).map_err(|cause| {
                Failure(format!(
                    "image {}: expected PNG, JPEG, TIFF or BMP, got: {cause}",
                    view.path.display()
                ))
            })?;
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
            let camera = Camera {
                id: view.id.to_string(),
                width,
                height,
                lens: view.lens.clone(),
                world_from_cam,
            };
            images.push((
                rig.cameras.len(),
                mvtop_core::image::load(&view.path, &camera)?,
            ));
            rig.cameras.push(camera);
        }
        let world_from_ref = rig.cameras[0].world_from_cam;
        let truth = views[0]
            .objects
            .iter()
            .filter(|object| self.wanted(group, object.object))
            .map(|object| {
                let world_from_obj = world_from_ref * object.cam_from_obj;
                KnownPose {
                    seen: self.boxes(object.object, &world_from_obj, &views, &rig),
                    world_from_obj,
                }
            })
            .collect();
        Ok(Sample {
            name: name(group),
            rig,
            images,
            truth,
        })
    }

    /// The annotated boxes of one object: annotations have no identity across views, but a place.
    fn boxes(
        &self,
        id: u32,
        world_from_obj: &Isometry3<f64>,
        views: &[&View],
        rig: &Rig,
    ) -> KnownBoxes {
        let reach = SAME_OBJECT * self.models[&id].diameter_m;
        let boxes = views.iter().zip(&rig.cameras).filter_map(|(view, camera)| {
            let off = |object: &Instance| {
                let pose = camera.world_from_cam * object.cam_from_obj;
                (pose.translation.vector - world_from_obj.translation.vector).norm()
            };
            let alike = view.objects.iter().filter(|object| object.object == id);
            let nearest = alike.min_by(|a, b| off(a).total_cmp(&off(b)))?;
            Some((
                camera.id.clone(),
                nearest.bbox.filter(|_| off(nearest) <= reach)?,
            ))
        });
        KnownBoxes {
            class: self.classes[&id].clone(),
            boxes: boxes.collect(),
        }
    }
}

/// A data set's object and a class of the same number may be different things.
fn check_names(models: &BTreeMap<u32, Model>, classes: &BTreeMap<u32, String>) -> Result<()> {
    for (id, model) in models {
        match &model.name {
            Some(name) if *name != classes[id] => {
                return Err(Failure(format!(
                    "object {id} is `{name}` in models_info.json and `{}` in the model; give the \
                     model that was trained on this data set",
                    classes[id]
                )));
            }
            _ => {}
        }
    }
    Ok(())
}

fn estimate(obj_id: u32, found: &ObjectPose) -> Estimate {
    let rotation = found.ref_from_obj.rotation.to_rotation_matrix();
    Estimate {
        obj_id,
        score: found.score,
        r: std::array::from_fn(|i| rotation[(i / 3, i % 3)]),
        t_mm: (found.ref_from_obj.translation.vector * 1e3).into(),
    }
}

/// Results in BOP's format, for the reference images.
fn csv(lines: &[Line]) -> String {
    let numbers = |numbers: &[f64]| {
        numbers
            .iter()
            .map(f64::to_string)
            .collect::<Vec<_>>()
            .join(" ")
    };
    let mut text = String::from("scene_id,im_id,obj_id,score,R,t,time\n");
    for line in lines {
        for estimate in &line.estimates {
            text += &format!(
                "{},{},{},{},{},{},{}\n",
                line.scene,
                line.image,
                estimate.obj_id,
                estimate.score,
                numbers(&estimate.r),
                numbers(&estimate.t_mm),
                line.time_s
            );
        }
    }
    text
}

impl Results {
    fn new(lines: &[Line], resolved_deg: f64) -> Self {
        let scored: Vec<&Scored> = lines.iter().flat_map(|line| &line.objects).collect();
        let outcomes: Vec<Outcome> = scored.iter().map(|s| s.outcome.clone()).collect();
        let views = outcomes
            .iter()
            .map(|outcome| outcome.views)
            .max()
            .unwrap_or(0);
        let extra = lines.iter().map(|line| line.extra).sum();
        let mut by_object: BTreeMap<u32, Vec<&Scored>> = BTreeMap::new();
        for &scored in &scored {
            by_object.entry(scored.obj_id).or_default().push(scored);
        }
        Self {
            summary: Summary::new(views, lines.len(), extra, &outcomes, resolved_deg),
            all: Scores::new(&scored),
            objects: by_object
                .into_iter()
                .map(|(id, scored)| (id, Scores::new(&scored)))
                .collect(),
        }
    }
}
