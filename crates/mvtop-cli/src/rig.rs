//! `rig`: rig files, from other programs' files, and what they say.

pub mod args;
mod observed;
mod picture;
mod views;

use std::path::PathBuf;

use mvtop_core::Rig;

use self::args::{Check, Import, Rig as Command, Show};
use self::views::Views;
use crate::failure::{Failure, Result};
use crate::write;

pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::Import(args) => import(args),
        Command::Show(args) => show(args, &[]).map(|_| ()),
        Command::Check(args) => check(args),
        Command::Refine(args) => observed::refine(args),
    }
}

fn import(args: &Import) -> Result<()> {
    write::may_write(&args.out, args.force)?;
    let imported = mvtop_import::import(&args.files, &args.options())?;
    write::spare(&args.out, &imported.files, "name another file")?;
    let text = imported.rig.to_json();
    // What is written here must be read everywhere.
    Rig::from_json(&text)?;
    write::whole(&args.out, text.as_bytes())?;
    let cameras = imported.rig.cameras().len();
    let (out, format) = (args.out.display(), imported.format);
    let s = if cameras == 1 { "" } else { "s" };
    write::print(&format!("{out}: {cameras} camera{s}, from {format}"))?;
    for note in &imported.notes {
        write::print(&format!("  {note}"))?;
    }
    write::print(&format!(
        "look at it: mvtop-cli rig show {out} --picture rig.svg"
    ))
}

fn check(args: &Check) -> Result<()> {
    let mut problem = show(&args.show, &observed::files(&args.images))?;
    if !args.images.is_empty() {
        problem = observed::check(args)?.or(problem);
    }
    match problem {
        Some(problem) => Err(Failure(format!("{}: {problem}", args.show.rig.display()))),
        None if args.images.is_empty() => write::print("nothing speaks against this rig"),
        None => write::print("no camera is seen to be off"),
    }
}

/// What cannot be meant, if anything.
///
/// - `images`: files that are read as well
fn show(args: &Show, images: &[PathBuf]) -> Result<Option<String>> {
    if let Some(path) = &args.picture {
        write::may_write(path, args.force)?;
        let read = images.iter().chain([&args.rig]);
        write::spare(path, read, "name another file")?;
    }
    let rig = Rig::load(&args.rig)?;
    let views = Views::of(&rig);
    write::print(views.text(&rig).trim_end())?;
    let problem = views.problem(&rig);
    if let Some(problem) = &problem {
        write::print(&format!("warning: {problem}"))?;
    }
    if let Some(path) = &args.picture {
        write::whole(path, picture::svg(&rig).as_bytes())?;
    }
    Ok(problem)
}
