//! Writing: to stdout and stderr, pages, and files that appear when they are whole.

use std::io::{ErrorKind, Write};

use mvtop_core::error::{harmless, printable};
use mvtop_core::{Prediction, Rig};
use serde::Serialize;

pub use mvtop_eval::files::{folder, json, may_write, persist, spare, whole};

use crate::failure::{Failure, Result};

/// Writes lines to stdout, text or JSON, harmless to a terminal whatever names from files are in it. A
/// reader that has gone away, as in `| head`, is no failure.
pub fn print(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match writeln!(stdout, "{}", harmless(text)).and_then(|()| stdout.flush()) {
        Err(cause) if cause.kind() != ErrorKind::BrokenPipe => {
            Err(Failure(format!("cannot write to stdout: {cause}")))
        }
        _ => Ok(()),
    }
}

/// Writes a line to stderr, harmless as in [`print`]. There is nowhere left to say that this failed.
pub fn complain(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", harmless(text));
}

/// Writes what makes a prediction doubtful to stderr.
///
/// - `of`: what was predicted, where there are several
pub fn warn(prediction: &Prediction, of: Option<&str>) {
    for warning in &prediction.warnings {
        let of = of.map_or(String::new(), |of| format!("{of}: "));
        complain(&format!(
            "warning: {}",
            printable(&format!("{of}{}", warning.message))
        ));
    }
}

/// Writes what is doubtful of a rig to standard error.
pub fn warn_of_rig(rig: &Rig) {
    for warning in rig.warnings() {
        complain(&format!("warning: {}", printable(&warning)));
    }
}

/// JSON for people to look into as well.
pub fn pretty_json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string_pretty(value)
        .map_err(|cause| Failure(format!("cannot write JSON: {cause}")))
}

/// A page.
pub fn template(page: &impl askama::Template) -> Result<String> {
    page.render()
        .map_err(|cause| Failure(format!("cannot write a page: {cause}")))
}
