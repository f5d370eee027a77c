//! Which model bundle, and which example, to use where none is named.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::failure::{Failure, Result};

/// What a package of the program brings along.
static SHIPPED: OnceLock<Shipped> = OnceLock::new();

struct Shipped {
    /// With `model` and `example` in it.
    folder: PathBuf,
    /// Of ONNX Runtime.
    library: Option<PathBuf>,
}

/// A folder, and what it was found by.
pub struct Found {
    pub folder: PathBuf,
    pub by: &'static str,
}

/// Says what the package that this runs from brings along; once for a process.
pub fn ship(folder: PathBuf, library: Option<PathBuf>) {
    // The same each time.
    let _ = SHIPPED.set(Shipped { folder, library });
}

/// The library of the ONNX Runtime that is installed with the package, if this runs from one.
pub fn library() -> Option<&'static Path> {
    SHIPPED.get()?.library.as_deref()
}

/// The folder of `--model`, else of `$MVTOP_MODEL`, else what is installed: the one that the wheel
/// carries, or `models/mvball` in a folder above the executable. Never one of the current folder,
/// which may hold a stranger's files.
pub fn find(named: Option<&Path>) -> Result<Found> {
    let found = |folder: &Path, by| Found {
        folder: folder.to_owned(),
        by,
    };
    if let Some(folder) = named {
        return Ok(found(folder, "--model"));
    }
    if let Some(folder) = std::env::var_os("MVTOP_MODEL").filter(|folder| !folder.is_empty()) {
        return Ok(found(Path::new(&folder), "$MVTOP_MODEL"));
    }
    look("models/mvball", "model", "model.json").map_err(|tried| {
        Failure(format!(
            "no model bundle found, tried {tried}; `pip install` of mvtop's wheel brings one along, \
             docs/how-to/train.md says how to train one; name it with --model or $MVTOP_MODEL"
        ))
    })
}

/// The folder of the example: a rig, an image of each of its cameras, and the truth.
pub fn example() -> Result<Found> {
    look("examples/mvball", "example", "rig.json").map_err(|tried| {
        Failure(format!(
            "no example found, tried {tried}; mvtop's wheel and a clone of its repository have it"
        ))
    })
}

/// Where something is, else what was tried.
///
/// - `path`: in a clone
/// - `shipped`: its name in the package
/// - `file`: that is in it
fn look(path: &str, shipped: &str, file: &str) -> std::result::Result<Found, String> {
    let executable = std::env::current_exe().unwrap_or_default();
    let above = executable
        .ancestors()
        .skip(1)
        .map(|folder| folder.join(path));
    let above = above.map(|folder| (folder, "a folder above the executable"));
    let tried: Vec<_> = match SHIPPED.get() {
        Some(package) => vec![(package.folder.join(shipped), "the wheel")],
        None => above.collect(),
    };
    match tried.iter().find(|(folder, _)| folder.join(file).is_file()) {
        Some((folder, by)) => Ok(Found {
            folder: folder.clone(),
            by,
        }),
        None => {
            let tried = tried.iter().map(|(folder, _)| folder.display().to_string());
            Err(tried.collect::<Vec<_>>().join(", "))
        }
    }
}
