//! What results depend on, so that none are taken for those of other data, another model or tool.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use crate::bop::FrameId;
use mvtop_core::{Error, file};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::Options;
use super::plan::Plan;
use crate::Result;

/// Largest file that results are said to depend on.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// What results depend on, for `run.json`. Where files lie is no part of it, but for the names of the
/// data set.
///
/// - `sources`: what poses come from, a file and what to call it
pub fn about(options: &Options, sources: &[(&str, PathBuf)], plan: &Plan) -> Result<Value> {
    let (split, conditions) = (&options.split, &options.conditions);
    let targets = split.targets.as_deref().map(|path| hash([path]));
    let mut about = json!({
        "tool": concat!("mvtop-cli ", env!("CARGO_PKG_VERSION")),
        "dataset": folder_name(&split.dataset),
        "split": split.split,
        "grouping": split.grouping.map(|grouping| grouping.to_string()),
        "sensor": split.sensor,
        "views": conditions.views,
        "objects": split.objects,
        "targets_sha256": targets.transpose()?,
        "annotations_sha256": annotations(plan)?,
        "images_sha256": images(plan)?,
        "meshes_sha256": hash(plan.models.values().map(|model| model.path.as_path()))?,
        "map": options.map,
        "true_boxes": conditions.true_boxes,
        "min_views": conditions.min_views,
        "refine": conditions.refine,
        "min_confidence": conditions.min_confidence,
        "box_noise": conditions.noise.boxes,
        "rig_noise_deg": conditions.noise.rig_deg,
        "rig_noise_mm": conditions.noise.rig_mm,
        "noise_seed": conditions.noise.seed,
        "vsd_delta_mm": options.vsd_delta_mm,
    });
    for (name, path) in sources {
        about[name] = hash([path.as_path()])?.into();
    }
    Ok(about)
}

/// Name of a folder, however it was given.
pub fn folder_name(path: &Path) -> String {
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// Of the contents of the scenes' files, `scene_camera.json` and its like, and of
/// `models_info.json`.
fn annotations(plan: &Plan) -> Result<String> {
    let mut files: Vec<PathBuf> = Vec::new();
    for scene in plan.scenes.values() {
        let entries = std::fs::read_dir(&scene.folder).map_err(Error::read(&scene.folder))?;
        let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
        let listed = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with("scene_") && name.ends_with(".json")
        };
        files.extend(paths.filter(listed));
    }
    files.sort();
    let mesh = plan
        .models
        .values()
        .next()
        .map(|model| model.path.as_path());
    let info = mesh.map(|mesh| mesh.with_file_name("models_info.json"));
    hash(files.iter().chain(&info).map(PathBuf::as_path))
}

/// Of the sizes and times of all images that are looked at: to read them all would take as long as
/// the evaluation of a large split.
fn images(plan: &Plan) -> Result<String> {
    let groups = plan.groups.iter();
    let views = groups.flat_map(|group| group.views.iter().map(|view| (group.scene, view)));
    let views: BTreeSet<(u32, &FrameId)> = views.collect();
    let mut sum = Sha256::new();
    for (scene, view) in views {
        let frame = &plan.scenes[&scene].frames[view];
        for path in [Some(&frame.path), frame.depth.as_ref()]
            .into_iter()
            .flatten()
        {
            let about = path.metadata().map_err(Error::read(path))?;
            let time = about.modified().ok();
            let time = time.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
            let (bytes, time) = (about.len(), time.unwrap_or_default().as_nanos());
            sum.update(format!("{scene}/{view} {bytes} {time}\n"));
        }
    }
    Ok(format!("{:x}", sum.finalize()))
}

/// Of the names and contents of some files.
fn hash<'a>(paths: impl IntoIterator<Item = &'a Path>) -> Result<String> {
    let mut sum = Sha256::new();
    for path in paths {
        let bytes = file::read(path, MAX_FILE_BYTES)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        sum.update(format!("{name} {}\n", bytes.len()));
        sum.update(bytes);
    }
    Ok(format!("{:x}", sum.finalize()))
}
