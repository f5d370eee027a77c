//! `infer`: the poses in one set of images.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use mvtop_core::annotations::TruePose;
use mvtop_core::report::Report;
use mvtop_core::{Estimator, PredictOptions, Prediction, Rig, ViewImage, annotations, overlay};

use crate::args::Infer;
use crate::failure::{Failure, Result, may_write, print};
use crate::{model_dir, table};

/// File name of all views side by side.
const SHEET: &str = "all_views.png";

pub fn run(args: &Infer) -> Result<()> {
    let rig = Rig::load(&args.rig)?;
    let files = assign(&rig, &args.images)?;
    let options = PredictOptions {
        reference: args.reference.clone(),
        boxes: args
            .boxes
            .as_deref()
            .map(annotations::load_boxes)
            .transpose()?,
        min_views: args.detection.min_views as usize,
    };
    let truth = args
        .truth
        .as_deref()
        .map(annotations::load_truth)
        .transpose()?;
    let pictures = match &args.overlay {
        Some(dir) => Some(Pictures::plan(dir, &rig, &files, args.force)?),
        None => None,
    };
    let mut images = Vec::new();
    for (camera, path) in files {
        let image = mvtop_core::image::load(&path, &rig.cameras()[camera])?;
        images.push(ViewImage { camera, image });
    }
    let estimator = Estimator::load(
        &model_dir::find(args.network.model.as_deref())?,
        &args.network.options(),
    )?;

    let prediction = estimator.predict(&rig, &images, &options)?;

    let written = match &pictures {
        Some(pictures) => {
            let truth = truth.as_deref().unwrap_or_default();
            pictures.write(&prediction, &estimator, &rig, &images, truth)?
        }
        None => Vec::new(),
    };
    if args.json {
        let report = serde_json::to_string_pretty(&Report::new(&prediction, &rig))
            .map_err(|cause| Failure(format!("cannot write JSON: {cause}")))?;
        return print(&report);
    }
    print(&table::objects(&prediction, &rig))?;
    if let Some(truth) = &truth {
        print(&format!("\n{}", table::compared(&prediction, truth, &rig)))?;
    }
    if !written.is_empty() {
        let written: Vec<String> = written
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        print(&format!("\npictures: {}", written.join(" ")))?;
    }
    Ok(())
}

/// Which camera each image belongs to.
fn assign(rig: &Rig, images: &[PathBuf]) -> Result<Vec<(usize, PathBuf)>> {
    let ids: Vec<&str> = rig.cameras().iter().map(|camera| camera.id()).collect();
    let ids = ids.join(", ");
    let mut named = Vec::new();
    for image in images {
        let Some((id, path)) = image.to_str().and_then(|text| text.split_once('=')) else {
            continue;
        };
        match rig.index_of(id) {
            Some(camera) => named.push((camera, PathBuf::from(path))),
            None if image.exists() => {} // A file that has `=` in its name.
            None => {
                let image = image.display();
                return Err(Failure(format!(
                    "image `{image}`: no camera `{id}` in the rig, expected one of: {ids}"
                )));
            }
        }
    }
    if named.len() == images.len() {
        return Ok(named);
    }
    if !named.is_empty() {
        return Err(Failure(
            "some images are given as ID=PATH and some are not; give all of them the same way"
                .into(),
        ));
    }
    if images.len() != rig.cameras().len() {
        return Err(Failure(format!(
            "expected {} images, one for each camera of the rig ({ids}), got {}; to use some of \
             the cameras, give each image as ID=PATH",
            rig.cameras().len(),
            images.len()
        )));
    }
    Ok(images.iter().cloned().enumerate().collect())
}

/// Where the pictures go.
struct Pictures {
    dir: PathBuf,
    /// In the order of the images.
    files: Vec<PathBuf>,
    sheet: PathBuf,
}

impl Pictures {
    /// Refuses before any work is done what would fail after it.
    fn plan(dir: &Path, rig: &Rig, images: &[(usize, PathBuf)], force: bool) -> Result<Self> {
        let mut taken = BTreeSet::from([SHEET.to_owned()]);
        let mut files = Vec::new();
        for (camera, _) in images {
            let mut name = file_name(&rig.cameras()[*camera].id());
            if !taken.insert(name.clone()) {
                name = format!("{camera}_{name}");
                taken.insert(name.clone());
            }
            files.push(dir.join(name));
        }
        let sheet = dir.join(SHEET);
        for path in files.iter().chain([&sheet]) {
            may_write(path, force)?;
            let same = |image: &(usize, PathBuf)| {
                image
                    .1
                    .canonicalize()
                    .is_ok_and(|image| path.canonicalize().is_ok_and(|p| p == image))
            };
            if images.iter().any(same) {
                let path = path.display();
                return Err(Failure(format!(
                    "{path} is one of the images; give --overlay another folder"
                )));
            }
        }
        Ok(Self {
            dir: dir.to_owned(),
            files,
            sheet,
        })
    }

    fn write(
        &self,
        prediction: &Prediction,
        estimator: &Estimator,
        rig: &Rig,
        images: &[ViewImage],
        truth: &[TruePose],
    ) -> Result<Vec<PathBuf>> {
        std::fs::create_dir_all(&self.dir)
            .map_err(|cause| Failure(format!("cannot make {}: {cause}", self.dir.display())))?;
        let bundle = estimator.bundle();
        let mut drawn = overlay::draw_prediction(prediction, &bundle.classes, rig, images);
        for known in truth {
            // Of a class that the model does not know there is no size.
            let Some(class) = bundle.class_index(&known.seen.class) else {
                continue;
            };
            let diameter_m = bundle.classes[class].diameter_m;
            for (picture, view) in drawn.iter_mut().zip(images) {
                let camera = &rig.cameras()[view.camera];
                *picture = overlay::draw_truth(picture, camera, &known.world_from_obj, diameter_m);
            }
        }
        let sheet = overlay::contact_sheet(&drawn);
        let files = self.files.iter().chain([&self.sheet]);
        for (path, picture) in files.clone().zip(drawn.iter().chain([&sheet])) {
            picture
                .save(path)
                .map_err(|cause| Failure(format!("cannot write {}: {cause}", path.display())))?;
        }
        Ok(files.cloned().collect())
    }
}

/// A camera's id as a file name that is safe everywhere.
fn file_name(id: &str) -> String {
    let safe = |c: char| {
        if c.is_ascii_alphanumeric() || "-_".contains(c) {
            c
        } else {
            '_'
        }
    };
    format!("{}.png", id.chars().map(safe).collect::<String>())
}
