//! What ends a command early, and printing that cannot.

use std::fmt;
use std::io::{ErrorKind, Write};
use std::path::Path;

pub type Result<T> = std::result::Result<T, Failure>;

/// One sentence for the user.
#[derive(Debug)]
pub struct Failure(pub String);

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // One line whatever the cause, for scripts that read the last one.
        f.write_str(&self.0.split_whitespace().collect::<Vec<_>>().join(" "))
    }
}

impl From<mvtop_core::Error> for Failure {
    fn from(error: mvtop_core::Error) -> Self {
        Self(error.to_string())
    }
}

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
