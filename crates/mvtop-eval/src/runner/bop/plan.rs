//! What `eval bop` goes through: scenes, groups of views, and the objects in them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::bop::{Doubts, FrameId, Group, Grouping, Model, Rules, Scene, Target};
use crate::bop::{groups, load_models, load_targets, scene_ids};
use mvtop_core::bundle::Class;

use super::Options;
use super::provenance::folder_name;
use crate::{Error, Result};

/// What is evaluated.
pub struct Plan {
    /// By obj_id; those that the network knows, if there is one, and that were asked for.
    pub models: BTreeMap<u32, Model>,
    /// Name of the network's class, or of the object, by obj_id.
    pub classes: BTreeMap<u32, String>,
    /// By number.
    pub scenes: BTreeMap<u32, Scene>,
    /// Views that are looked at together.
    pub groups: Vec<Group>,
    /// What makes results doubtful, a sentence each.
    pub warnings: Vec<String>,
}

/// `000048/000001+000036`: scene, then views.
pub(super) fn name(group: &Group) -> String {
    let views: Vec<String> = group.views.iter().map(FrameId::to_string).collect();
    format!("{:06}/{}", group.scene, views.join("+"))
}

impl Plan {
    /// Reads the data set's annotations and models.
    ///
    /// - `known`: the network's classes; without it, each image is looked at alone, as in results in
    ///   BOP's format
    ///
    /// # Errors
    /// Where a file cannot be read or is refused, or nothing is left to evaluate.
    pub fn new(options: &Options, known: Option<&[Class]>) -> Result<Self> {
        let split = &options.split;
        let root: &Path = &split.dataset;
        let rules = Rules::of(&folder_name(root));
        let asked = |id: &u32| split.objects.as_ref().is_none_or(|ids| ids.contains(id));
        let (models, classes) = match known {
            Some(known) => of_network(options, known, asked)?,
            None => {
                let models = load_models(root, |id| asked(&id))?;
                let mut ids = split.objects.iter().flatten();
                if let Some(id) = ids.find(|id| !models.contains_key(*id)) {
                    return Err(Error::Input(format!(
                        "{}: expected object {id} of --objects in models_info.json, got none",
                        root.display()
                    )));
                }
                let name = |(&id, model): (&u32, &Model)| {
                    let name = model.name.clone();
                    (id, name.unwrap_or_else(|| format!("obj_{id:06}")))
                };
                let classes = models.iter().map(name).collect();
                (models, classes)
            }
        };
        let folder = root.join(&split.split);
        let targets = split.targets.as_deref().map(load_targets).transpose()?;
        let ids = scene_ids(&folder)?;
        if let Some(target) = targets.iter().flatten().find(|t| !ids.contains(&t.scene)) {
            return Err(Error::Input(format!(
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
            warnings: Vec::new(),
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
            let views = match known {
                Some(_) => options.conditions.views.map(|views| views as usize),
                None => Some(1),
            };
            let grouping = split.grouping.unwrap_or_else(|| Grouping::of(&scene));
            let there = |sensor: &&str| scene.frames.keys().any(|id| id.sensor == *sensor);
            let sensor = split.sensor.as_deref().or(rules.sensor.filter(there));
            let mut found = groups(&scene, grouping, views, sensor, of_scene)?;
            found.retain(|group| plan.asks(&scene, group));
            plan.groups.extend(found);
            plan.scenes.insert(id, scene);
        }
        if plan.groups.is_empty() {
            let ids: Vec<String> = plan.classes.keys().map(u32::to_string).collect();
            return Err(Error::Input(format!(
                "{}: no image shows any of the objects {}{}",
                folder.display(),
                ids.join(", "),
                match known {
                    Some(_) => ", which the model knows; choose another --split or another --model",
                    None => "; choose another --split or other --objects",
                }
            )));
        }
        match known {
            Some(_) => plan.has_views(options.conditions.views, &folder)?,
            None => plan.keep_images_once(split.sensor.as_deref())?,
        }
        plan.warnings = plan.doubts(options, known.is_some());
        Ok(plan)
    }

    /// Refuses to look at fewer views than asked for in every group, unless a list says which they are.
    fn has_views(&self, asked: Option<u32>, folder: &Path) -> Result<()> {
        let listed = self.groups.iter().any(|group| group.listed);
        let most = self.groups.iter().map(|group| group.views.len()).max();
        match (asked, most) {
            (Some(views), Some(most)) if most < views as usize && !listed => {
                Err(Error::Input(format!(
                    "{}: expected groups of {views} views, as asked for, got {most} at most; ask for \
                 fewer views",
                    folder.display()
                )))
            }
            _ => Ok(()),
        }
    }

    /// For results, which name an image by scene and number: each is evaluated once.
    fn keep_images_once(&mut self, sensor: Option<&str>) -> Result<()> {
        let mut seen = BTreeSet::new();
        self.groups.retain(|group| {
            let asked = sensor.is_none_or(|sensor| group.views[0].sensor == sensor);
            asked && seen.insert(name(group))
        });
        let sensors = self
            .groups
            .iter()
            .map(|group| group.views[0].sensor.as_str());
        let sensors: BTreeSet<&str> = sensors.collect();
        if sensors.len() > 1 {
            return Err(Error::Input(format!(
                "--targets names images of several sensors ({}), which results do not tell apart; \
                 choose one with --sensor",
                sensors.into_iter().collect::<Vec<_>>().join(", ")
            )));
        }
        Ok(())
    }

    /// What of the data set and of what is asked for makes results doubtful.
    fn doubts(&self, options: &Options, network: bool) -> Vec<String> {
        let mut doubts = Doubts::default();
        for scene in self.scenes.values() {
            doubts.extend(scene.doubts.clone());
        }
        let mut sentences = doubts.sentences();
        let views = options.conditions.views;
        let count = |few: &dyn Fn(usize) -> bool| {
            let few = self.groups.iter().filter(|group| few(group.views.len()));
            let first = few.clone().next().map(name).unwrap_or_default();
            (few.count(), first)
        };
        let all = self.groups.len();
        let (alone, first) = count(&|views| views == 1);
        if network && alone > 0 && views != Some(1) {
            sentences.push(format!(
                "{alone} of {all} groups have one view, the first is {first}: poses in them are those \
                 of a single camera"
            ));
        }
        sentences.extend(self.doubts_of_references(&folder_name(&options.split.dataset)));
        if let Some(views) = views.filter(|_| network) {
            let (fewer, first) = count(&|count| count > 1 && count < views as usize);
            if fewer > 0 {
                sentences.push(format!(
                    "{fewer} of {all} groups have fewer than the {views} views asked for, the first is \
                     {first}"
                ));
            }
        }
        let without = self.scenes.values().filter(|scene| {
            let mut objects = scene
                .frames
                .values()
                .flat_map(|frame| &frame.objects)
                .peekable();
            objects.peek().is_some() && objects.all(|object| object.bbox.is_none())
        });
        let without: Vec<&Scene> = without.collect();
        if let (true, Some(first)) = (options.conditions.true_boxes, without.first()) {
            sentences.push(format!(
                "{} scenes have no bbox_obj in scene_gt_info.json, the first is {}: --true-boxes gives \
                 none there, so nothing is found; add the file, or leave out --true-boxes",
                without.len(),
                first.folder.display()
            ));
        }
        sentences
    }

    /// Why results of the references can't be submitted, or not as they are.
    fn doubts_of_references(&self, dataset: &str) -> Vec<String> {
        let mut sentences = Vec::new();
        if let Some(scored) = Rules::of(dataset).sensor {
            // Rendered images for training come without sensors.
            let another = |id: &FrameId| !id.sensor.is_empty() && id.sensor != scored;
            let others = self.groups.iter().filter(|group| another(&group.views[0]));
            if let Some(first) = others.clone().next() {
                sentences.push(format!(
                    "BOP scores {dataset} in images of {scored}, and {} of {} groups have another \
                     reference, the first is {}: unpack that sensor's images and give no other --sensor",
                    others.count(),
                    self.groups.len(),
                    name(first)
                ));
            }
        }
        let mut seen = BTreeSet::new();
        let again = |group: &&Group| !seen.insert((group.scene, group.views[0].image));
        if let Some(first) = self.groups.iter().find(again) {
            sentences.push(format!(
                "several groups have a reference of one scene and number, as {}: results do not tell \
                 them apart, so their poses can't be submitted together",
                name(first)
            ));
        }
        sentences
    }

    /// The number of an object by its name, in models_info.json or in --map.
    pub(super) fn names(&self, options: &Options) -> BTreeMap<String, u32> {
        let models = self.models.values();
        let names = models.filter_map(|model| Some((model.name.clone()?, model.id)));
        names.chain(options.map.iter().cloned()).collect()
    }

    /// Whether there is something to predict in a group; of images without annotations that is not
    /// known, so it is tried.
    fn asks(&self, scene: &Scene, group: &Group) -> bool {
        let annotated = &scene.frames[&group.views[0]].objects;
        annotated.is_empty() || annotated.iter().any(|o| self.wanted(group, o.object))
    }

    /// Whether a group asks for an object.
    pub(super) fn wanted(&self, group: &Group, object: u32) -> bool {
        let targets = group.objects.as_ref();
        targets.is_none_or(|counts| counts.contains_key(&object))
            && self.models.contains_key(&object)
    }

    /// Of many, as many of each object as the group's targets ask for, those that come first by some
    /// order; they stay in the order given.
    ///
    /// - `sort`: what orders them, the greatest first
    pub(super) fn first<T>(
        &self,
        group: &Group,
        many: Vec<T>,
        object: impl Fn(&T) -> u32,
        sort: impl Fn(&T) -> f64,
    ) -> Vec<T> {
        let mut order: Vec<usize> = (0..many.len()).collect();
        order.sort_by(|&a, &b| sort(&many[b]).total_cmp(&sort(&many[a])));
        let mut taken: BTreeMap<u32, usize> = BTreeMap::new();
        let mut kept = vec![false; many.len()];
        for i in order {
            let id = object(&many[i]);
            let most = group.objects.as_ref().and_then(|counts| *counts.get(&id)?);
            let taken = taken.entry(id).or_default();
            kept[i] = most.is_none_or(|most| *taken < most);
            *taken += usize::from(kept[i]);
        }
        let many = many.into_iter().zip(kept);
        many.filter_map(|(one, kept)| kept.then_some(one)).collect()
    }

    /// obj_id of a class.
    pub(super) fn object(&self, class: &str) -> Option<u32> {
        let mut classes = self.classes.iter();
        classes.find(|(_, name)| *name == class).map(|(&id, _)| id)
    }

    /// The group of that name.
    pub fn group(&self, wanted: &str) -> Option<&Group> {
        self.groups.iter().find(|group| name(group) == wanted)
    }
}

/// The objects that a network's classes are, and the names of these.
fn of_network(
    options: &Options,
    known: &[Class],
    asked: impl Fn(&u32) -> bool,
) -> Result<(BTreeMap<u32, Model>, BTreeMap<u32, String>)> {
    if let Some((name, _)) = options
        .map
        .iter()
        .find(|(name, _)| known.iter().all(|c| c.name != *name))
    {
        let names: Vec<&str> = known.iter().map(|class| class.name.as_str()).collect();
        return Err(Error::Input(format!(
            "--map: no class `{name}` in the model, expected one of: {}",
            names.join(", ")
        )));
    }
    let mut classes: BTreeMap<u32, String> = BTreeMap::new();
    for class in known {
        let mapped = options.map.iter().find(|(name, _)| *name == class.name);
        let id = mapped
            .map(|(_, id)| *id)
            .or_else(|| u32::try_from(class.id).ok());
        let Some(id) = id.filter(&asked) else {
            continue;
        };
        if let Some(other) = classes.insert(id, class.name.clone()) {
            return Err(Error::Input(format!(
                "object {id} would be both of the model's classes `{other}` and `{}`; say which with \
                 --map NAME=ID",
                class.name
            )));
        }
    }
    if classes.is_empty() {
        return Err(Error::Input(
            "the model knows none of the objects in --objects; leave it out to evaluate those it \
             knows, or give a --model that was trained on this data set (docs/how-to/train.md)"
                .into(),
        ));
    }
    let root = &options.split.dataset;
    let models = load_models(root, |id| classes.contains_key(&id))?;
    check_names(&models, &classes, options)?;
    if let Some(id) = classes.keys().find(|id| !models.contains_key(id)) {
        return Err(Error::Input(format!(
            "{}: expected object {id} in models_info.json, as the model's class `{}` has this id, got \
             none; choose objects with --objects, say which object a class is with --map NAME=ID, or \
             give a --model that was trained on this data set (docs/how-to/train.md)",
            root.display(),
            classes[id]
        )));
    }
    Ok((models, classes))
}

/// A data set's object and a class of the same number may be different things.
fn check_names(
    models: &BTreeMap<u32, Model>,
    classes: &BTreeMap<u32, String>,
    options: &Options,
) -> Result<()> {
    for (id, model) in models {
        let class = &classes[id];
        if options.map.iter().any(|(name, _)| name == class) {
            continue;
        }
        if let Some(name) = model.name.as_ref().filter(|name| *name != class) {
            return Err(Error::Input(format!(
                "object {id} is `{name}` in models_info.json and `{class}` in the model; give the \
                 model that was trained on this data set, or --map {class}={id} if they are the same"
            )));
        }
    }
    Ok(())
}
