//! Options that several commands have, and the numbers that options take.

use std::path::{Path, PathBuf};

use clap::Args;
use mvtop_core::bundle::Bundle;
use mvtop_core::onnx::{Provider, SessionOptions};
use mvtop_core::{Estimator, Options};

use crate::failure::{Failure, Result};
use crate::model_dir::{self, Found};

#[derive(Args)]
pub struct Detection {
    /// Leave out objects detected in fewer images; 2 removes nearly all false positives
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub min_views: u32,
}

impl Detection {
    /// The fewest images, unless they change nothing.
    pub fn given(&self) -> Option<usize> {
        (self.min_views > 1).then_some(self.min_views as usize)
    }
}

#[derive(Args)]
pub struct Refinement {
    /// Refine poses on the images; needs a mesh [default: where there is one]
    #[arg(long, overrides_with = "no_refine")]
    refine: bool,

    /// Give the network's poses
    #[arg(long, overrides_with = "refine")]
    no_refine: bool,
}

impl Refinement {
    /// What was asked for, if anything.
    pub fn wanted(&self) -> Option<bool> {
        match (self.refine, self.no_refine) {
            (true, _) => Some(true),
            (_, true) => Some(false),
            _ => None,
        }
    }
}

#[derive(Args)]
#[command(next_help_heading = "Network")]
pub struct NetworkArgs {
    /// Model bundle [default: $MVTOP_MODEL, else the wheel's, or models/mvball above the executable]
    #[arg(long, value_name = "DIR")]
    pub model: Option<PathBuf>,

    #[command(flatten)]
    pub runtime: RuntimeArgs,
}

/// How networks are run, whatever they are.
#[derive(Args)]
#[command(next_help_heading = "Network")]
pub struct RuntimeArgs {
    /// ONNX Runtime's library [default: searched for, see `doctor`]
    #[arg(long, value_name = "PATH")]
    pub ort_lib: Option<PathBuf>,

    /// Execution provider
    #[arg(long, value_name = "NAME", default_value_t)]
    pub provider: Provider,

    /// Threads per operation; 0: one per physical core
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,

    /// Change an inference setting (docs/reference/inference.md), as `search.settled=0.8`; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = setting)]
    pub settings: Vec<(String, serde_json::Value)>,
}

/// A setting by its dotted path, with a JSON value.
fn setting(text: &str) -> std::result::Result<(String, serde_json::Value), String> {
    let example = "expected KEY=VALUE, as in search.settled=0.8";
    let (key, value) = text.split_once('=').ok_or(example)?;
    let value = serde_json::from_str(value).map_err(|_| example)?;
    Ok((key.to_owned(), value))
}

impl NetworkArgs {
    /// The model bundle's folder, and what it was found by.
    pub fn found(&self) -> Result<Found> {
        model_dir::find(self.model.as_deref())
    }

    /// The model bundle's folder.
    pub fn bundle(&self) -> Result<PathBuf> {
        Ok(self.found()?.folder)
    }

    /// ONNX Runtime's library, see [`RuntimeArgs::library`].
    pub fn library(&self) -> Option<&Path> {
        self.runtime.library()
    }

    pub fn load(&self, bundle: &Path) -> Result<Estimator> {
        Ok(Estimator::load(bundle, &self.runtime.options())?)
    }
}

impl RuntimeArgs {
    /// ONNX Runtime's library: the one named, else that of the package that this runs from.
    pub fn library(&self) -> Option<&Path> {
        match &self.ort_lib {
            Some(path) => Some(path),
            None => model_dir::library(),
        }
    }

    pub fn options(&self) -> Options {
        let session = SessionOptions::default()
            .with_provider(self.provider)
            .with_threads(self.threads);
        let mut options = Options::default()
            .with_session(session)
            .with_inference(self.settings.clone());
        options.ort_lib = self.library().map(Path::to_owned);
        options
    }
}

/// Refuses `--min-confidence` of a model that does not say how sure it is.
pub fn knows_confidence(bundle: &Bundle) -> Result<()> {
    match bundle.scorer {
        Some(_) => Ok(()),
        None => Err(Failure(format!(
            "--min-confidence: expected a model bundle that says how sure it is, got {} without; \
             add it with `mvtop-train calibrate`",
            bundle.dir.display()
        ))),
    }
}

pub fn not_negative(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && number >= 0.0 => Ok(number),
        _ => Err("expected a number of 0 or more".into()),
    }
}

pub fn probability(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (0.0..=1.0).contains(&number) => Ok(number),
        _ => Err("expected a probability from 0 to 1".into()),
    }
}

pub fn positive(text: &str) -> std::result::Result<f64, String> {
    match not_negative(text) {
        Ok(number) if number > 0.0 => Ok(number),
        _ => Err("expected a number above 0".into()),
    }
}
