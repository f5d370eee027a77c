//! Rigs against images: `rig check` with images, and `rig refine`.

use std::path::PathBuf;

use mvtop_core::bundle::Bundle;
use mvtop_core::calibration::{Comparison, Observed, Off, PairResidual, Reading, observe};
use mvtop_core::{Rig, ViewImage, image};
use nalgebra::Isometry3;

use super::args::{Check, Refine};
use crate::args::NetworkArgs;
use crate::failure::{Failure, Result};
use crate::infer::assign;
use crate::write;

/// What is wrong with the rig by its images, if anything.
pub fn check(args: &Check) -> Result<Option<String>> {
    let rig = Rig::load(&args.show.rig)?;
    let Seen { bundle, observed } = Seen::new(&rig, &args.images, &args.network)?;
    let comparison = observed.compare(&bundle.classes, &rig);
    write::print(&summary(&rig, &observed))?;
    for pair in &comparison.pairs {
        write::print(&format!("  {}", of_pair(&rig, pair)))?;
    }
    for off in &comparison.off {
        write::print(&format!("  {}", of_camera(&rig, off)))?;
    }
    // What was not compared is not right for that.
    let untold = untold(&rig, &observed);
    let unchecked = (!untold.is_empty()).then(|| {
        format!(
            "the images have too few objects in common to tell where `{}` stands, so that was not checked; \
             give more sets of images, with more objects",
            untold.join("`, `")
        )
    });
    Ok(problem(&rig, &comparison).or(unchecked))
}

/// Writes the rig as its images show it.
pub fn refine(args: &Refine) -> Result<()> {
    write::may_write(&args.out, args.force)?;
    if write::same_file(&args.rig, &args.out) {
        let (rig, out) = (args.rig.display(), args.out.display());
        return Err(Failure(format!(
            "{out} is the rig that is read, {rig}; name another file"
        )));
    }
    let rig = Rig::load(&args.rig)?;
    let Seen { bundle, observed } = Seen::new(&rig, &args.images, &args.network)?;
    let untold = untold(&rig, &observed);
    if !untold.is_empty() {
        return Err(Failure(format!(
            "images: expected enough to tell where each camera stands to 2 degrees and 30 mm, got too few \
             objects that `{}` has in common with others; give more sets of images, with more objects",
            untold.join("`, `")
        )));
    }
    let (before, after) = (
        observed.pairs(&bundle.classes, &rig),
        observed.pairs(&bundle.classes, &observed.rig),
    );
    write::print(&summary(&rig, &observed))?;
    for (before, after) in before.iter().zip(&after) {
        let [a, b] = before.cameras.map(|index| rig.cameras()[index].id());
        let [before_px, after_px] = [before.px, after.px].map(px);
        write::print(&format!(
            "  {a} - {b}: lines of sight of {} missed each other by {before_px}, now by {after_px}",
            objects(before.objects),
        ))?;
    }
    let reference = rig.reference_camera();
    for (index, camera) in rig.cameras().iter().enumerate() {
        let (Some(sigma), false) = (observed.sigmas[index], index == rig.reference()) else {
            continue;
        };
        let as_seen = |rig: &Rig| {
            let [world_from_ref, world_from_cam] =
                [rig.reference(), index].map(|i| *rig.cameras()[i].world_from_cam());
            world_from_ref.inv_mul(&world_from_cam)
        };
        write::print(&format!(
            "  camera `{}` {}; certain to {:.2} deg, {:.1} mm against `{}`",
            camera.id(),
            motion(
                &as_seen(&rig).inv_mul(&as_seen(&observed.rig)),
                "turned",
                "moved"
            ),
            sigma.rot_deg,
            1e3 * sigma.t_m,
            reference.id()
        ))?;
    }
    if let Some(reading) = observed.compare(&bundle.classes, &rig).reading {
        write::print(&format!("  note: as they were, {}", explained(&reading)))?;
    }
    let text = observed.rig.to_json();
    Rig::from_json(&text)?;
    write::whole(&args.out, text.as_bytes())?;
    write::print(&format!("{}: written", args.out.display()))
}

/// What the images tell, and of which objects.
struct Seen {
    bundle: Bundle,
    observed: Observed,
}

impl Seen {
    fn new(rig: &Rig, images: &[PathBuf], network: &NetworkArgs) -> Result<Self> {
        let mut sets = Vec::new();
        for set in sets_of(rig, images)? {
            let load = |(camera, path): (usize, PathBuf)| -> Result<ViewImage> {
                let image = image::load(&path, &rig.cameras()[camera])?;
                Ok(ViewImage { camera, image })
            };
            sets.push(set.into_iter().map(load).collect::<Result<Vec<_>>>()?);
        }
        let estimator = network.load(&network.bundle()?)?;
        Ok(Self {
            observed: observe(&estimator, rig, &sets)?,
            bundle: estimator.bundle().clone(),
        })
    }
}

/// Images by set and camera.
fn sets_of(rig: &Rig, images: &[PathBuf]) -> Result<Vec<Vec<(usize, PathBuf)>>> {
    let count = rig.cameras().len();
    if count < 2 {
        let problem =
            "rig: expected two cameras or more, got one, which nothing can be compared with";
        return Err(Failure(problem.into()));
    }
    let id = |image: &PathBuf| {
        let (id, _) = image.to_str()?.split_once('=')?;
        rig.index_of(id)
    };
    if images.iter().all(|image| id(image).is_none()) {
        if !images.len().is_multiple_of(count) {
            let got = images.len();
            return Err(Failure(format!(
                "expected sets of {count} images, one for each camera of the rig, one set after the other, \
                 got {got} images; to use some of the cameras, give each image as ID=PATH"
            )));
        }
        return images.chunks(count).map(|set| assign(rig, set)).collect();
    }
    let mut sets: Vec<Vec<PathBuf>> = vec![Vec::new()];
    let mut seen = Vec::new();
    for image in images {
        let camera = id(image);
        if camera.is_some() && seen.contains(&camera) {
            seen.clear();
            sets.push(Vec::new());
        }
        seen.push(camera);
        if let Some(set) = sets.last_mut() {
            set.push(image.clone());
        }
    }
    sets.iter().map(|set| assign(rig, set)).collect()
}

/// One sentence of what is wrong, if anything.
fn problem(rig: &Rig, comparison: &Comparison) -> Option<String> {
    let ids = |off: &[Off]| -> Vec<String> {
        let id = |off: &Off| rig.cameras()[off.camera].id().to_owned();
        off.iter().map(id).collect()
    };
    let refine = "`mvtop-cli rig refine` writes where the images show the cameras";
    if let Some(reading) = &comparison.reading {
        return Some(format!("the images contradict it: {}", explained(reading)));
    }
    match &comparison.off[..] {
        [] => None,
        [off] if comparison.is_told => Some(format!("{}; {refine}", of_camera(rig, off))),
        off if comparison.is_told => Some(format!(
            "cameras `{}` do not stand where the images show them; {refine}",
            ids(off).join("`, `")
        )),
        off => Some(format!(
            "cameras do not stand to each other as the images show it, and which of them is wrong cannot \
             be told: `{}` would be off by {}; {refine}",
            ids(off).join("`, `"),
            px(off.iter().map(|one| one.px).fold(0.0, f64::max)),
        )),
    }
}

fn explained(reading: &Reading) -> String {
    match reading {
        Reading::Inverse => {
            "the poses fit the images if read in the other direction (world to camera \
                             instead of camera to world)"
                .into()
        }
        Reading::OpenGl => {
            "the poses fit the images if read in OpenGL's axes (y up, z backward)".into()
        }
        Reading::InverseOpenGl => {
            "the poses fit the images if read in the other direction and in OpenGL's axes".into()
        }
        Reading::Scaled(scale) => format!(
            "the cameras stand {scale:.4} times as far apart as the images show it; check the unit and scale \
             of translations"
        ),
        _ => "the poses fit the images in another reading".into(),
    }
}

fn summary(rig: &Rig, observed: &Observed) -> String {
    let count = rig.cameras().len();
    let found = objects(observed.objects.len());
    format!("against the images: {found} seen by two cameras or more of {count}")
}

fn objects(count: usize) -> String {
    format!("{count} object{}", if count == 1 { "" } else { "s" })
}

fn px(px: f64) -> String {
    match px.is_finite() {
        true => format!("{px:.1} px"),
        false => "any distance (they meet nowhere in view)".into(),
    }
}

fn of_pair(rig: &Rig, pair: &PairResidual) -> String {
    let [a, b] = pair.cameras.map(|index| rig.cameras()[index].id());
    let size = pair.size.map_or(String::new(), |size| {
        format!(", which show them {size:.3} times as large as their distance says")
    });
    let (found, px) = (objects(pair.objects), px(pair.px));
    format!("{a} - {b}: lines of sight of {found} miss each other by {px}{size}")
}

fn of_camera(rig: &Rig, off: &Off) -> String {
    let id = rig.cameras()[off.camera].id();
    let needed = motion(&off.cam_from_shown, "a turn", "a move");
    format!("camera `{id}` is off by {}: it needs {needed}", px(off.px))
}

/// A turn and a move in words.
fn motion(pose: &Isometry3<f64>, turn: &str, shift: &str) -> String {
    let axis = pose
        .rotation
        .axis()
        .map_or([0.0; 3], |axis| axis.into_inner().into());
    let degrees = pose.rotation.angle().to_degrees();
    let millimetres = pose.translation.vector * 1e3;
    let [x, y, z] = axis.map(|x| x + 0.0);
    let (length, by) = (
        millimetres.norm(),
        if turn == "turned" { "by" } else { "of" },
    );
    let [a, b, c] = <[f64; 3]>::from(millimetres);
    format!(
        "{turn} {by} {degrees:.2} deg about [{x:.2} {y:.2} {z:.2}] and {shift} {by} {length:.1} mm \
         [{a:.1} {b:.1} {c:.1}], in its own axes"
    )
}

fn untold(rig: &Rig, observed: &Observed) -> Vec<String> {
    let cameras = rig.cameras().iter().zip(&observed.sigmas).enumerate();
    let untold = cameras.filter(|(i, (_, sigma))| *i != rig.reference() && sigma.is_none());
    untold
        .map(|(_, (camera, _))| camera.id().to_owned())
        .collect()
}
