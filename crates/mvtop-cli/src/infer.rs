//! `infer`: the poses in one set of images.

use std::collections::BTreeSet;
use std::io::Cursor;
use std::mem::ManuallyDrop;
use std::path::{Path, PathBuf};

use image::{ImageFormat, RgbImage};
use mvtop_core::annotations::TruePose;
use mvtop_core::bundle::Bundle;
use mvtop_core::request::Grasps;
use mvtop_core::{Rig, ViewImage, annotations, image::load_views, overlay};

use crate::args::Infer;
use crate::failure::{Failure, Result};
use crate::model_dir;
use crate::options::knows_confidence;
use crate::write::{may_write, print};
use crate::{table, write};

/// File name of all views side by side.
const SHEET: &str = "all_views.png";

/// Returns whether all poses are accepted, where that was asked.
pub fn run(args: &Infer) -> Result<bool> {
    let Inputs {
        rig: rig_file,
        images,
        truth: truth_file,
    } = Inputs::of(args)?;
    let rig = Rig::load(&rig_file)?;
    write::warn_of_rig(&rig);
    let files = assign(&rig, &images)?;
    let mut request = args.choice.request(args)?;
    let why = request.says_why();
    // Text reports them wherever there is no object.
    request.why |= !args.json;
    let truth = truth_file.as_deref().map(annotations::load_truth);
    let truth = truth.transpose()?;
    let pictures = args.overlay.as_ref();
    let inputs: Vec<&Path> = files
        .iter()
        .map(|(_, path)| path)
        .chain([&rig_file])
        .chain(
            args.boxes
                .iter()
                .chain(&truth_file)
                .chain(&args.choice.request),
        )
        .map(PathBuf::as_path)
        .collect();
    let cameras: Vec<usize> = files.iter().map(|(camera, _)| *camera).collect();
    let pictures = pictures.map(|dir| Pictures::plan(dir, &rig, &cameras, &inputs, args.force));
    let pictures = pictures.transpose()?;
    let (images, model) = rayon::join(
        || load_views(&rig, &files),
        || {
            let model = args.network.found()?;
            // Never freed, which takes time: the process is about to end.
            let estimator = ManuallyDrop::new(args.network.load(&model.folder)?);
            Ok::<_, Failure>((model, estimator))
        },
    );
    let (images, (model, estimator)) = (images?, model?);
    if request.min_confidence.is_some() {
        knows_confidence(estimator.bundle())?;
    }
    let grasps = Grasps::of_bundle(estimator.bundle())?;
    if args.edges {
        estimator.needs_mesh("--edges", "leave --edges out")?;
    }
    let answer = request.answer(&estimator, grasps.as_ref(), &rig, &images)?;
    let accepted = answer.is_accepted(&request);
    let prediction = answer.prediction;
    write::warn(&prediction, None);

    if let Some(pictures) = &pictures {
        let truth = truth.as_deref().unwrap_or_default();
        let drawn = match args.edges {
            true => overlay::draw_prediction_edges(&prediction, &estimator, &rig, &images),
            false => {
                let classes = &estimator.bundle().classes;
                overlay::draw_prediction(&prediction, classes, &rig, &images)
            }
        };
        pictures.write(drawn, estimator.bundle(), &rig, &images, truth)?;
    }
    if args.json {
        print(&answer.report.to_json()?)?;
        return Ok(accepted);
    }
    print(&table::objects(&prediction, &rig, request.min_confidence))?;
    if why || prediction.objects.is_empty() {
        let mut misses = answer.report.why.iter().flatten();
        misses.try_for_each(|miss| print(&format!("no {}: {}", miss.class, miss.message)))?;
    }
    print(&format!("model {} ({})", model.folder.display(), model.by))?;
    if let Some(truth) = &truth {
        let classes = &estimator.bundle().classes;
        let compared = table::compared(&prediction, truth, &rig, classes);
        print(&format!("\n{compared}"))?;
    }
    if let Some(pictures) = &pictures {
        let written = pictures.files.iter().map(|path| path.display().to_string());
        let written: Vec<String> = written.collect();
        print(&format!("\npictures: {}", written.join(" ")))?;
    }
    Ok(accepted)
}

/// The files that are read.
struct Inputs {
    rig: PathBuf,
    /// As given.
    images: Vec<PathBuf>,
    truth: Option<PathBuf>,
}

impl Inputs {
    fn of(args: &Infer) -> Result<Self> {
        if args.example {
            let folder = model_dir::example()?.folder;
            return Ok(Self {
                rig: folder.join("rig.json"),
                images: ["cam0.png", "cam1.png"]
                    .map(|name| folder.join(name))
                    .into(),
                truth: (!args.json).then(|| folder.join("truth.json")),
            });
        }
        let rig = args.rig.clone();
        Ok(Self {
            rig: rig.ok_or_else(|| Failure("give --rig FILE, or --example".into()))?,
            images: args.images.clone(),
            truth: args.truth.clone(),
        })
    }
}

/// Which camera each image belongs to.
pub fn assign(rig: &Rig, images: &[PathBuf]) -> Result<Vec<(usize, PathBuf)>> {
    let mut named = Vec::new();
    for image in images {
        let Some((id, path)) = image.to_str().and_then(|text| text.split_once('=')) else {
            continue;
        };
        match rig.index_of(id) {
            Some(camera) => named.push((camera, PathBuf::from(path))),
            None if image.exists() => {} // A file that has `=` in its name.
            None => {
                rig.find(&format!("image `{}`", image.display()), id)?;
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
        let ids: Vec<&str> = rig.cameras().iter().map(|camera| camera.id()).collect();
        return Err(Failure(format!(
            "expected {} images, one for each camera of the rig ({}), got {}; to use some of the \
             cameras, give each image as ID=PATH",
            ids.len(),
            ids.join(", "),
            images.len()
        )));
    }
    by_name(rig, images)
}

/// Images that are named after cameras are of these, whatever their order; where no name is a camera's
/// id, the order tells.
fn by_name(rig: &Rig, images: &[PathBuf]) -> Result<Vec<(usize, PathBuf)>> {
    let named = |image: &PathBuf| rig.index_of(image.file_stem()?.to_str()?);
    let Some(example) = images.iter().find(|image| named(image).is_some()) else {
        return Ok(images.iter().cloned().enumerate().collect());
    };
    let mut found: Vec<(usize, PathBuf)> = Vec::new();
    for image in images {
        let told = image.display();
        let Some(camera) = named(image) else {
            let ids: Vec<&str> = rig.cameras().iter().map(|camera| camera.id()).collect();
            return Err(Failure(format!(
                "image `{told}`: expected a file that is named after a camera ({}), as `{}` is, got another \
                 name; give each image as ID=PATH",
                ids.join(", "),
                example.display()
            )));
        };
        if let Some((_, other)) = found.iter().find(|(taken, _)| *taken == camera) {
            return Err(Failure(format!(
                "image `{told}`: expected one file that is named after camera `{}`, got `{}` as well; give \
                 each image as ID=PATH",
                rig.cameras()[camera].id(),
                other.display()
            )));
        }
        found.push((camera, image.clone()));
    }
    found.sort_by_key(|(camera, _)| *camera);
    Ok(found)
}

/// Where the pictures go.
struct Pictures {
    dir: PathBuf,
    /// In the order of the images, then all views side by side.
    files: Vec<PathBuf>,
}

impl Pictures {
    /// Refuses before any work is done what would fail after it.
    ///
    /// - `cameras`: those of the images
    /// - `inputs`: files that no picture may replace
    fn plan(
        dir: &Path,
        rig: &Rig,
        cameras: &[usize],
        inputs: &[&Path],
        force: bool,
    ) -> Result<Self> {
        let mut taken = BTreeSet::from([SHEET.to_owned()]);
        let mut files = Vec::new();
        for camera in cameras {
            let mut name = file_name(rig.cameras()[*camera].id());
            if !taken.insert(name.clone()) {
                name = format!("{camera}_{name}");
                taken.insert(name.clone());
            }
            files.push(dir.join(name));
        }
        files.push(dir.join(SHEET));
        for path in &files {
            may_write(path, force)?;
            write::spare(path, inputs, "give --overlay another folder")?;
        }
        let dir = dir.to_owned();
        Ok(Self { dir, files })
    }

    fn write(
        &self,
        mut drawn: Vec<RgbImage>,
        bundle: &Bundle,
        rig: &Rig,
        images: &[ViewImage],
        truth: &[TruePose],
    ) -> Result<()> {
        write::folder(&self.dir)?;
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
        drawn.push(overlay::contact_sheet(&drawn));
        for (path, picture) in self.files.iter().zip(&drawn) {
            let mut png = Cursor::new(Vec::new());
            let drawn = picture.write_to(&mut png, ImageFormat::Png);
            drawn.map_err(|cause| Failure(format!("cannot write {}: {cause}", path.display())))?;
            write::whole(path, png.get_ref())?;
        }
        Ok(())
    }
}

/// A camera's id as a file name that is safe everywhere.
fn file_name(id: &str) -> String {
    let other = |c: char| !(c.is_ascii_alphanumeric() || "-_".contains(c));
    format!("{}.png", id.replace(other, "_"))
}
