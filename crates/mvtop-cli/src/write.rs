//! Writing: files that appear when they are whole, and stdout.

use std::fs::{create_dir_all, rename, write};
use std::io::{Error, ErrorKind, Write};
use std::path::Path;

use serde::Serialize;

use crate::failure::{Failure, Result};

/// Writes a line to stdout. A reader that has gone away, as in `| head`, is no failure.
pub fn print(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        Err(cause) if cause.kind() != ErrorKind::BrokenPipe => {
            Err(Failure(format!("cannot write to stdout: {cause}")))
        }
        _ => Ok(()),
    }
}

/// One line of JSON.
pub fn json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string(value).map_err(json_error)
}

/// JSON for people to look into as well.
pub fn pretty_json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string_pretty(value).map_err(json_error)
}

/// A page.
pub fn template(page: &impl askama::Template) -> Result<String> {
    page.render()
        .map_err(|cause| Failure(format!("cannot write a page: {cause}")))
}

fn json_error(cause: serde_json::Error) -> Failure {
    Failure(format!("cannot write JSON: {cause}"))
}

/// Refuses to overwrite a file unless `force`.
pub fn may_write(path: &Path, force: bool) -> Result<()> {
    if path.exists() && !force {
        let path = path.display();
        return Err(Failure(format!(
            "{path} exists already; give --force to overwrite it"
        )));
    }
    Ok(())
}

/// Makes a folder and those above it, where they are not there.
pub fn folder(path: &Path) -> Result<()> {
    create_dir_all(path).map_err(failed("create", path))
}

/// The file appears when it is whole: who finds it need not ask whether it is.
pub fn whole(path: &Path, text: &str) -> Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    write(&partial, text)
        .and_then(|()| rename(&partial, path))
        .map_err(failed("write", path))
}

/// - `what`: what could not be done with the file, `write`
pub fn failed(what: &str, path: &Path) -> impl Fn(Error) -> Failure {
    let (what, path) = (what.to_owned(), path.display().to_string());
    move |cause| Failure(format!("cannot {what} {path}: {cause}"))
}
