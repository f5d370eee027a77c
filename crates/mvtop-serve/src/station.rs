//! The models and rigs that are served, by name.

use std::path::{Path, PathBuf};

use mvtop_core::bundle::Bundle;
use mvtop_core::error::printable;
use mvtop_core::request::Grasps;
use mvtop_core::{Estimator, Options, Rig};

use crate::log;
use crate::problem::Problem;

/// A rig with its name.
pub struct NamedRig {
    pub name: String,
    pub rig: Rig,
}

/// A model with its name, ready to predict.
pub struct Model {
    pub name: String,
    pub folder: PathBuf,
    pub estimator: Estimator,
    pub grasps: Option<Grasps>,
}

impl Model {
    /// Loads a model and runs its self-test.
    pub fn load(name: &str, folder: &Path, options: &Options) -> Result<Self, String> {
        let told = |error: mvtop_core::Error| printable(&error.to_string());
        let estimator = Estimator::load(folder, options).map_err(told)?;
        estimator.self_test().map_err(told)?;
        let grasps = Grasps::of_bundle(estimator.bundle()).map_err(told)?;
        Ok(Self {
            name: name.to_owned(),
            folder: folder.to_owned(),
            estimator,
            grasps,
        })
    }

    pub fn bundle(&self) -> &Bundle {
        self.estimator.bundle()
    }
}

/// Loads all rigs, which takes no time.
pub fn load_rigs(files: &[(String, PathBuf)]) -> Result<Vec<NamedRig>, String> {
    let load = |(name, path): &(String, PathBuf)| {
        let rig = Rig::load(path).map_err(|error| printable(&error.to_string()))?;
        for warning in rig.warnings() {
            log::line(&printable(&format!("rig {name}: {warning}")));
        }
        let name = name.clone();
        Ok(NamedRig { name, rig })
    };
    files.iter().map(load).collect()
}

/// Refuses two things of one name, and nothing at all.
///
/// - `what`: what they are, `model`
pub fn check_names(what: &str, named: &[(String, PathBuf)]) -> Result<(), String> {
    if named.is_empty() {
        return Err(format!(
            "expected a {what}, got none; name one with --{what}"
        ));
    }
    for (index, (name, _)) in named.iter().enumerate() {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if name.is_empty() || !name.chars().all(plain) {
            return Err(printable(&format!(
                "{what} `{name}`: expected a name of letters, digits, `-`, `_` and `.`; give --{what} NAME=PATH"
            )));
        }
        if named[..index].iter().any(|(other, _)| other == name) {
            return Err(format!(
                "two {what}s have the name `{name}`; give them names that differ with --{what} NAME=PATH"
            ));
        }
    }
    Ok(())
}

/// Index of what is asked for by name, the first where nothing is.
///
/// - `what`: what they are, `model`
pub fn find<'a>(
    what: &str,
    name: Option<&str>,
    names: impl Iterator<Item = &'a str> + Clone,
) -> Result<usize, Problem> {
    let Some(name) = name else { return Ok(0) };
    names
        .clone()
        .position(|known| known == name)
        .ok_or_else(|| {
            let known: Vec<&str> = names.collect();
            let known = known.join(", ");
            Problem::bad(format!(
                "{what}: no {what} `{name}` here, expected one of: {known}"
            ))
        })
}
