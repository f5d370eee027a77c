//! Lists of what is to be evaluated.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use super::json::read;
use super::scene::FrameId;
use crate::{Error, Result};

/// Views to predict from together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Target {
    /// Number of the scene.
    pub scene: u32,
    /// The first one is the reference.
    pub views: Vec<FrameId>,
    /// Whether these are all; else the grouping chooses those that go with the reference.
    pub listed: bool,
    /// Objects asked for, and how many instances of each where that is known; all without it.
    pub objects: Option<BTreeMap<u32, Option<usize>>>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Document {
    /// BOP's: one row per image, per image and object, or per group of images.
    Rows(Vec<Row>),
    /// mvtop's `pairs.json`: scene, reference image, other image.
    Pairs { pairs: Vec<[u32; 3]> },
}

#[derive(Deserialize)]
struct Row {
    scene_id: u32,
    im_id: Images,
    obj_id: Option<u32>,
    inst_count: Option<usize>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Images {
    One(u32),
    Many(Vec<Image>),
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Image {
    Plain(u32),
    /// With what the sensor's files end in; `default` for none.
    Of(String, u32),
}

/// Reads `test_targets_bop19.json`, `test_targets_bop24.json`, a multi-view list (`im_id` being
/// `[[SENSOR, IMAGE], ...]` or `[IMAGE, ...]`) or mvtop's `pairs.json`.
///
/// Rows of the same views are put together, in the order of the first one. A view that a list names
/// twice, as XYZ-IBD's do, is one view.
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read, [`Error::Data`] where it is none of these or
/// empty.
pub fn load_targets(path: &Path) -> Result<Vec<Target>> {
    let expected = "BOP's targets, [{\"scene_id\": N, \"im_id\": N or [[SENSOR, N], ...], ...}], \
                    or {\"pairs\": [[SCENE, IMAGE, IMAGE]]}";
    let pair = |[scene_id, a, b]: [u32; 3]| Row {
        scene_id,
        im_id: Images::Many(vec![Image::Plain(a), Image::Plain(b)]),
        obj_id: None,
        inst_count: None,
    };
    let rows = match read(path, expected)? {
        Document::Pairs { pairs } => pairs.into_iter().map(pair).collect(),
        Document::Rows(rows) => rows,
    };
    let mut targets: Vec<Target> = Vec::new();
    let mut places: BTreeMap<(u32, bool, Vec<FrameId>), usize> = BTreeMap::new();
    for row in rows {
        let listed = matches!(row.im_id, Images::Many(_));
        let views = row.im_id.views();
        if views.is_empty() {
            return Err(Error::Data(format!(
                "{}: scene {}: expected at least one image in im_id, got []",
                path.display(),
                row.scene_id
            )));
        }
        let object = row.obj_id.map(|id| BTreeMap::from([(id, row.inst_count)]));
        let place = *places
            .entry((row.scene_id, listed, views.clone()))
            .or_insert(targets.len());
        match targets.get_mut(place) {
            None => targets.push(Target {
                scene: row.scene_id,
                views,
                listed,
                objects: object,
            }),
            Some(target) => match (&mut target.objects, object) {
                (Some(objects), Some(more)) => objects.extend(more),
                (objects, _) => *objects = None,
            },
        }
    }
    if targets.is_empty() {
        return Err(Error::Data(format!(
            "{}: expected at least one target, got an empty list",
            path.display()
        )));
    }
    Ok(targets)
}

impl Images {
    fn views(self) -> Vec<FrameId> {
        let images = match self {
            Self::One(image) => vec![Image::Plain(image)],
            Self::Many(images) => images,
        };
        let view = |image| match image {
            Image::Of(sensor, image) if sensor != "default" => FrameId { sensor, image },
            Image::Of(_, image) | Image::Plain(image) => FrameId {
                sensor: String::new(),
                image,
            },
        };
        let mut views: Vec<FrameId> = Vec::new();
        for view in images.into_iter().map(view) {
            if !views.contains(&view) {
                views.push(view);
            }
        }
        views
    }
}
