//! The arguments of each command.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::audit::args::Audit;
use crate::eval::args::Eval;
use crate::options::{Detection, NetworkArgs, Refinement, probability};
use crate::request::Choice;
use crate::rig::args::Rig;
use crate::serve::args::Serve;

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
    /// Answer programs and robots: poses over HTTP, with a page to look at
    Serve(Serve),
    /// Say what was found of ONNX Runtime and the model, and what to do
    Doctor(NetworkArgs),
    /// Print the JSON Schema (draft 2020-12) of a document, to check it or to generate code that reads it
    Schema(Schema),
}

#[derive(Args)]
#[command(after_help = "\
Example:
    mvtop-cli schema prediction > prediction.schema.json")]
pub struct Schema {
    /// Of what `infer --json` prints, `infer --request` takes, `model.json`, `rig.json`, or settings with defaults
    pub document: SchemaOf,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum SchemaOf {
    Prediction,
    Request,
    Bundle,
    Rig,
    Inference,
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  The two views that come along, with nothing else at hand:
    mvtop-cli infer --example
  All cameras of the rig, named after them, or in its order:
    mvtop-cli infer --rig rig.json left.png right.png
  Some cameras, poses in the frame of one of them, with pictures:
    mvtop-cli infer --rig rig.json left=a.png top=b.png --reference top --overlay out
    mvtop-cli infer --rig rig.json *.png --overlay out --edges
  For a program to read:
    mvtop-cli infer --rig rig.json left.png right.png --json > poses.json
  For a robot that grasps only what is certain, with exit code 3 where something is not:
    mvtop-cli infer --rig rig.json left.png right.png --json --min-confidence 0.9")]
pub struct Infer {
    /// Rig file: cameras, lenses and poses
    #[arg(long, value_name = "FILE", required_unless_present = "example")]
    pub rig: Option<PathBuf>,

    /// Images (PNG, JPEG, TIFF, BMP): one per camera, in the rig's order or named after the cameras
    /// (left.png); or ID=PATH for some cameras
    #[arg(required_unless_present = "example", value_name = "IMAGE")]
    pub images: Vec<PathBuf>,

    /// Use the shipped example: rig, images and known poses
    #[arg(long, conflicts_with_all = ["rig", "images", "truth", "boxes"])]
    pub example: bool,

    /// Camera in whose frame poses are given [default: the rig's]
    #[arg(long, value_name = "ID")]
    pub reference: Option<String>,

    /// Use the boxes in this file instead of the detector's
    #[arg(long, value_name = "FILE", conflicts_with = "min_views")]
    pub boxes: Option<PathBuf>,

    #[command(flatten)]
    pub detection: Detection,

    #[command(flatten)]
    pub refinement: Refinement,

    /// Give each pose a verdict by this confidence: `accept`, `reject` or `need_another_view`; exit
    /// with 3 unless there are poses and all are accepted
    #[arg(long, value_name = "P", value_parser = probability)]
    pub min_confidence: Option<f64>,

    /// Print JSON instead of text
    #[arg(long, conflicts_with = "truth")]
    pub json: bool,

    /// Print the known poses in this file (truth.json) too; draw them as thin white axes
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,

    /// Draw the poses onto copies of the images, into this folder
    #[arg(long, value_name = "DIR")]
    pub overlay: Option<PathBuf>,

    /// Draw edges of the meshes instead: green where the image shows them, else red
    #[arg(long, requires = "overlay")]
    pub edges: bool,

    /// Overwrite existing pictures
    #[arg(long, requires = "overlay")]
    pub force: bool,

    #[command(flatten)]
    pub choice: Choice,

    #[command(flatten)]
    pub network: NetworkArgs,
}
