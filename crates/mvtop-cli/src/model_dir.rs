//! Which model bundle to use where none is named.

use std::path::{Path, PathBuf};

use crate::failure::{Failure, Result};

const SHIPPED: &str = "models/mvball";

/// The folder of `--model`, else of `$MVTOP_MODEL`, else `models/mvball` in the current folder or
/// in one above the executable.
pub fn find(named: Option<&Path>) -> Result<PathBuf> {
    if let Some(dir) = named {
        return Ok(dir.to_owned());
    }
    if let Some(dir) = std::env::var_os("MVTOP_MODEL").filter(|dir| !dir.is_empty()) {
        return Ok(dir.into());
    }
    let executable = std::env::current_exe().unwrap_or_default();
    let above = executable.ancestors().skip(1).map(|dir| dir.join(SHIPPED));
    let here = std::iter::once(PathBuf::from(SHIPPED));
    let tried: Vec<PathBuf> = here.chain(above).collect();
    let found = tried.iter().find(|dir| dir.join("model.json").is_file());
    found.cloned().ok_or_else(|| {
        let tried: Vec<String> = tried.iter().map(|dir| dir.display().to_string()).collect();
        Failure(format!(
            "no model bundle found, tried {}; name one with --model or $MVTOP_MODEL",
            tried.join(", ")
        ))
    })
}
