//! Lines for the service's log, on stderr.

use std::io::Write;

use mvtop_core::error::printable;

/// Writes a line, harmless whatever names are in it. There is nowhere left to say that this failed.
pub fn line(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", printable(text));
}
