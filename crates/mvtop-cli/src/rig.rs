//! `rig`: rig files, from other programs' files, and what they say.

pub mod args;
mod observed;
mod picture;
mod views;

use std::path::PathBuf;

use mvtop_core::Rig;

use self::args::{Check, Import, Rig as Command, Show, Wheel};
use self::observed::Told;
use self::views::{Doubt, Views};
use crate::failure::{Failure, Result};
use crate::write;

pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::Import(args) => import(args),
        Command::Show(args) => show(args, &[]).map(|_| ()),
        Command::Check(args) => check(args),
        Command::Refine(args) => observed::refine(args),
        Command::Calibrate(args) => wheel("calibrate", args),
        Command::Board(args) => wheel("board", args),
        Command::HandEye(args) => wheel("hand-eye", args),
    }
}

/// Boards are found by OpenCV, from Python: this command knows where, and not how.
fn wheel(command: &str, args: &Wheel) -> Result<()> {
    let arguments = args.arguments.iter().map(|argument| argument.display());
    let typed: String = arguments.map(|argument| format!(" {argument}")).collect();
    Err(Failure(format!(
        "`rig {command}` comes with the Python wheel, not with this program; fix: pip install \
         'mvtop[calibrate]', then `mvtop-cli rig {command}{typed}` of that Python"
    )))
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
    let Shown { warned, doubt } = show(&args.show, &observed::files(&args.images))?;
    let told = match args.images.is_empty() {
        true => Told::Little,
        false => observed::check(args)?,
    };
    let hinted = doubt.is_some();
    let refused = doubt.filter(|doubt| doubt.refuses);
    let problem = match told {
        Told::Off(problem) => Some(problem),
        // What images show goes before what places of cameras look like.
        Told::Fits => None,
        Told::Little => refused.map(|doubt| doubt.sentence),
    };
    match problem {
        Some(problem) => Err(Failure(format!("{}: {problem}", args.show.rig.display()))),
        None if !args.images.is_empty() => write::print("no camera was found to be off"),
        None if hinted => write::print(
            "no other error was found in this rig; cameras that look apart on purpose cause this warning too, \
             and images of objects that the model knows decide",
        ),
        None if warned => write::print("no other error was found in this rig"),
        None => write::print("no error was found in this rig"),
    }
}

/// What was doubtful of a rig that was shown.
struct Shown {
    /// Of its lenses.
    warned: bool,
    /// What hints at swapped poses.
    doubt: Option<Doubt>,
}

/// Prints a rig, and what is doubtful of it.
///
/// - `images`: files that are read as well
fn show(args: &Show, images: &[PathBuf]) -> Result<Shown> {
    if let Some(path) = &args.picture {
        write::may_write(path, args.force)?;
        let read = images.iter().chain([&args.rig]);
        write::spare(path, read, "name another file")?;
    }
    let rig = Rig::load(&args.rig)?;
    let views = Views::of(&rig);
    write::print(views.text(&rig).trim_end())?;
    let warnings = rig.warnings();
    for warning in &warnings {
        write::print(&format!("warning: {warning}"))?;
    }
    let doubt = views.doubt(&rig);
    if let Some(doubt) = &doubt {
        write::print(&format!("warning: {}", doubt.sentence))?;
    }
    if let Some(path) = &args.picture {
        write::whole(path, picture::svg(&rig).as_bytes())?;
    }
    Ok(Shown {
        warned: !warnings.is_empty(),
        doubt,
    })
}
