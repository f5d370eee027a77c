//! `eval samples`: a folder of samples.

use mvtop_eval::runner::samples::{evaluate, folders};

use super::args::SamplesArgs;
use crate::failure::Result;
use crate::progress::Progress;
use crate::write;

pub fn run(args: &SamplesArgs) -> Result<()> {
    let folders = folders(&args.folder)?;
    if let Some(out) = &args.out {
        write::may_write(out, args.force)?;
        // It may be what a sample is read of: its rig, its truth, an image.
        let name = out.file_name().unwrap_or_default();
        let read = folders.iter().map(|folder| folder.join(name));
        write::spare(out, read, "name another file")?;
    }
    let estimator = args.trial.load()?;
    let mut progress = Progress::new("samples");
    let conditions = args.trial.conditions();
    let done = evaluate(&folders, &estimator, &conditions, &mut progress)?;
    if let Some(out) = &args.out {
        let lines = done.outcomes.iter().map(write::json);
        let lines: Vec<String> = lines.collect::<mvtop_eval::Result<_>>()?;
        write::whole(out, (lines.join("\n") + "\n").as_bytes())?;
    }
    if args.json {
        return write::print(&write::json(&done.summary)?);
    }
    write::print(&done.summary.text("samples", done.outcomes.len()))
}
