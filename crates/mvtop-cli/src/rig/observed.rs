//! Rigs against images: `rig check` with images, and `rig refine`.

use std::path::PathBuf;

use mvtop_core::calibration::{Correction, Observed, Refined, comparable, observe};
use mvtop_core::{Rig, ViewImage, image};

use super::args::{Check, Images, Refine};
use crate::failure::{Failure, Result};
use crate::infer::assign;
use crate::write;

/// What images say of a rig.
pub enum Told {
    /// What is wrong with it, a sentence.
    Off(String),
    /// Cameras agree on what they show, and none is seen to be off.
    Fits,
    /// Too little to say either.
    Little,
}

/// What images say of the rig; what one object alone says is printed only.
pub fn check(args: &Check) -> Result<Told> {
    let rig = Rig::load(&args.show.rig)?;
    let observed = observed(&rig, &args.images, &args.with)?;
    summary(&rig, &observed)?;
    let Some(problem) = observed.problem() else {
        let corrections = observed.corrections(rig.reference());
        print_corrections(&rig, &corrections)?;
        if corrections.iter().any(Correction::would_be_off) {
            write::print(
                "warning: one object alone says that cameras are off, and it may be taken for another; give \
                 more objects or sets of images",
            )?;
            return Ok(Told::Little);
        }
        return Ok(Told::Fits);
    };
    print_corrections(&rig, &observed.off().cameras)?;
    Ok(Told::Off(format!(
        "{problem}; `mvtop-cli rig refine` writes where the images show it"
    )))
}

/// Writes the rig with the cameras that are off where the images show them.
pub fn refine(args: &Refine) -> Result<()> {
    write::may_write(&args.out, args.force)?;
    let read = files(&args.images).into_iter().chain([args.rig.clone()]);
    write::spare(&args.out, read, "name another file")?;
    let rig = Rig::load(&args.rig)?;
    let observed = observed(&rig, &args.images, &args.with)?;
    summary(&rig, &observed)?;
    let off = observed.off();
    let cameras: Vec<usize> = off.cameras.iter().map(|camera| camera.camera).collect();
    let refined = observed.refined(&cameras)?;
    if cameras.is_empty() {
        print_corrections(&rig, &observed.corrections(rig.reference()))?;
    } else {
        print_refined(&rig, &observed, &refined)?;
    }
    let better = refined.accepted();
    let better = better.map_err(|error| Failure(format!("nothing was written: {error}")))?;
    if let Some(problem) = observed.problem().filter(|_| !off.is_told) {
        write::print(&format!("  note: {problem}"))?;
    }
    let text = better.to_json();
    Rig::from_json(&text)?;
    write::whole(&args.out, text.as_bytes())?;
    write::print(&format!("{}: written", args.out.display()))
}

fn print_refined(rig: &Rig, observed: &Observed, refined: &Refined) -> Result<()> {
    print_corrections(rig, &refined.moved)?;
    let (before, after) = (observed.pairs(rig), observed.pairs(&refined.rig));
    for (before, after) in before.iter().zip(after) {
        let [a, b] = before.cameras.map(|index| rig.cameras()[index].id());
        let (was, now) = (before.px, after.px);
        write::print(&format!(
            "  {a} - {b}: {was:.2} px before, {now:.2} px after"
        ))?;
    }
    match refined.held_out_px() {
        None => write::print("  one set of images alone: nothing was held out to judge this by"),
        Some([before, after]) => {
            let count = refined.held_out.len();
            write::print(&format!(
                "  of {count} sets, each held out: {before:.2} px before, {after:.2} px by what the others \
                 show"
            ))
        }
    }
}

fn observed(rig: &Rig, images: &[PathBuf], with: &Images) -> Result<Observed> {
    let mut sets = Vec::new();
    for set in sets_of(rig, images)? {
        let load = |(camera, path): (usize, PathBuf)| -> Result<ViewImage> {
            let image = image::load(&path, &rig.cameras()[camera])?;
            Ok(ViewImage { camera, image })
        };
        sets.push(set.into_iter().map(load).collect::<Result<Vec<_>>>()?);
    }
    let estimator = with.network.load(&with.network.bundle()?)?;
    Ok(observe(&estimator, rig, &sets, with.expected())?)
}

/// Files of images, whose names may be PATH or ID=PATH.
pub fn files(images: &[PathBuf]) -> Vec<PathBuf> {
    let named = |image: &PathBuf| Some(image.to_str()?.split_once('=')?.1.into());
    let named = images.iter().filter_map(named);
    images.iter().cloned().chain(named).collect()
}

/// Images by set and camera.
fn sets_of(rig: &Rig, images: &[PathBuf]) -> Result<Vec<Vec<(usize, PathBuf)>>> {
    comparable(rig)?;
    let count = rig.cameras().len();
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

fn summary(rig: &Rig, observed: &Observed) -> Result<()> {
    let (count, sets, agree) = (observed.objects(), observed.sets(), observed.agreeing());
    let noise = observed.noise_px();
    write::print(&format!(
        "against the images: {count} object{} in {sets} set{} seen by two cameras or more, which agree on {agree}; the edge noise \
         of one object in one view is estimated at {noise:.2} px (1 sigma)",
        s(count),
        s(sets)
    ))?;
    for pair in observed.pairs(rig) {
        let [a, b] = pair.cameras.map(|index| rig.cameras()[index].id());
        let (px, count) = (pair.px, pair.objects);
        write::print(&format!(
            "  {a} - {b}: edges of {count} object{} are {px:.2} px off",
            s(count)
        ))?;
    }
    Ok(())
}

fn s(count: usize) -> &'static str {
    if count == 1 { "" } else { "s" }
}

fn print_corrections(rig: &Rig, corrections: &[Correction]) -> Result<()> {
    for correction in corrections {
        let pose = &correction.cam_from_shown;
        let axis = pose
            .rotation
            .axis()
            .map_or([0.0; 3], |axis| axis.into_inner().into());
        let [x, y, z] = axis.map(|x| x + 0.0);
        let [a, b, c] = <[f64; 3]>::from(pose.translation.vector * 1e3);
        let verdict = match (correction.is_off(), correction.is_told()) {
            (true, true) => "off",
            (true, false) => "off; its position is poorly constrained",
            (false, _) if correction.would_be_off() => {
                "off if the pose of that one object is right"
            }
            (false, true) => "not off",
            (false, false) => "no error found; its position is poorly constrained",
        };
        write::print(&format!(
            "  `{}`: a rotation by {:.2} deg (sd {:.2}) about [{x:.2} {y:.2} {z:.2}] and a translation by {:.1} mm \
             (sd {:.1}) [{a:.1} {b:.1} {c:.1}] in its own axes would fit best, {:.1} standard deviations: {verdict}",
            rig.cameras()[correction.camera].id(),
            pose.rotation.angle().to_degrees(),
            correction.sigma.turn_deg,
            1e3 * pose.translation.vector.norm(),
            1e3 * correction.sigma.shift_m,
            correction.deviation,
        ))?;
    }
    Ok(())
}
