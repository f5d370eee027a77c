//! The arguments of each command.

use std::path::{Path, PathBuf};

use clap::{Args, Parser, Subcommand};
use mvtop_core::bundle::Bundle;
use mvtop_core::onnx::{Provider, SessionOptions};
use mvtop_core::{Estimator, Options};

use crate::audit::args::Audit;
use crate::eval::args::Eval;
use crate::failure::{Failure, Result};
use crate::model_dir;
use crate::rig::args::Rig;

/// 6-DoF poses of objects seen by several calibrated cameras.
#[derive(Parser)]
#[command(name = "mvtop-cli", version, about, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand)]
pub enum Command {
    /// Find the objects in the images of a rig, and their poses
    Infer(Infer),
    /// Compare predictions with the truth
    #[command(subcommand)]
    Eval(Eval),
    /// Check a data set
    #[command(subcommand)]
    Audit(Audit),
    /// Make rig files from other programs' calibrations, and look at them
    #[command(subcommand)]
    Rig(Rig),
    /// Say what was found of ONNX Runtime and the model, and what to do
    Doctor(NetworkArgs),
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  The two views that come along, with nothing else at hand:
    mvtop-cli infer --example
  All cameras of the rig, in its order:
    mvtop-cli infer --rig rig.json left.png right.png
  Some cameras, poses in the frame of one of them, with pictures:
    mvtop-cli infer --rig rig.json left=a.png top=b.png --reference top --overlay out
    mvtop-cli infer --rig rig.json *.png --overlay out --edges
  For a program to read:
    mvtop-cli infer --rig rig.json left.png right.png --json > poses.json
  For a robot that grasps only what is certain, with exit code 3 where something is not:
    mvtop-cli infer --rig rig.json left.png right.png --json --min-confidence 0.9")]
pub struct Infer {
    /// Rig file: the cameras, their lenses and where they are
    #[arg(long, value_name = "FILE", required_unless_present = "example")]
    pub rig: Option<PathBuf>,

    /// PNG, JPEG, TIFF or BMP images: one for each camera in the rig's order, or ID=PATH for some cameras
    #[arg(required_unless_present = "example", value_name = "IMAGE")]
    pub images: Vec<PathBuf>,

    /// Take the rig, images and known poses of the example that comes along
    #[arg(long, conflicts_with_all = ["rig", "images", "truth", "boxes"])]
    pub example: bool,

    /// Camera in whose frame poses are given [default: the rig's]
    #[arg(long, value_name = "ID")]
    pub reference: Option<String>,

    /// Use the boxes in this file instead of detecting objects
    #[arg(long, value_name = "FILE", conflicts_with = "min_views")]
    pub boxes: Option<PathBuf>,

    #[command(flatten)]
    pub detection: Detection,

    #[command(flatten)]
    pub refinement: Refinement,

    /// Say of each pose whether it is right with this probability, `accept`, `reject` or
    /// `need_another_view`; end with code 3 unless all are accepted and there is one
    #[arg(long, value_name = "P", value_parser = probability)]
    pub min_confidence: Option<f64>,

    /// Print JSON instead of text
    #[arg(long, conflicts_with = "truth")]
    pub json: bool,

    /// Print the known poses in this file (truth.json) beside the predicted ones; in pictures, thin
    /// white axes
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,

    /// Draw the poses onto copies of the images, in this folder
    #[arg(long, value_name = "DIR")]
    pub overlay: Option<PathBuf>,

    /// Draw the edges of the objects' meshes instead: green where the image shows them, else red
    #[arg(long, requires = "overlay")]
    pub edges: bool,

    /// Overwrite pictures that exist
    #[arg(long, requires = "overlay")]
    pub force: bool,

    #[command(flatten)]
    pub network: NetworkArgs,
}

#[derive(Args)]
pub struct Detection {
    /// Leave out objects that are detected in fewer images: 2 spares nearly all false ones, and
    /// costs those that only one image shows
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub min_views: u32,
}

#[derive(Args)]
pub struct Refinement {
    /// Refine poses on the images; an error where the model has no mesh [default: where it has]
    #[arg(long, overrides_with = "no_refine")]
    refine: bool,

    /// Give poses as the network finds them
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
    /// Model bundle [default: $MVTOP_MODEL, else models/mvball here or above the executable, else the
    /// wheel's]
    #[arg(long, value_name = "DIR")]
    pub model: Option<PathBuf>,

    /// ONNX Runtime's library [default: searched for, see `doctor`]
    #[arg(long, value_name = "PATH")]
    pub ort_lib: Option<PathBuf>,

    /// What executes the network
    #[arg(long, value_name = "NAME", default_value_t)]
    pub provider: Provider,

    /// Threads inside one operation of the network; 0: one per physical core
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
}

impl NetworkArgs {
    /// The model bundle's folder.
    pub fn bundle(&self) -> Result<PathBuf> {
        Ok(model_dir::find(self.model.as_deref())?.folder)
    }

    pub fn load(&self, bundle: &Path) -> Result<Estimator> {
        let session = SessionOptions {
            provider: self.provider,
            threads: self.threads,
        };
        let ort_lib = self.ort_lib.clone();
        Ok(Estimator::load(bundle, &Options { ort_lib, session })?)
    }
}

/// Refuses `--min-confidence` of a model that does not say how sure it is.
pub fn knows_confidence(bundle: &Bundle) -> Result<()> {
    match bundle.confidence {
        Some(_) => Ok(()),
        None => Err(Failure(format!(
            "--min-confidence: expected a model bundle that says how sure it is, got {} without; \
             add it with `python -m mvtop_train.training.confidence`",
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
