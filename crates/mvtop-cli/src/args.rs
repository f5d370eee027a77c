//! The arguments of each command.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use mvtop_core::Options;
use mvtop_core::onnx::{Provider, SessionOptions};
use mvtop_eval::bop::Grouping;

use crate::audit::args::Audit;

/// 6-DoF poses of objects seen by several calibrated cameras.
#[derive(Parser)]
#[command(name = "mvtop-cli", version, about)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand)]
pub enum Command {
    /// Find the objects in the images of a rig, and their poses
    Infer(Infer),
    /// Compare predictions with the truth over a folder of samples
    Eval(Eval),
    /// Check a data set
    #[command(subcommand)]
    Audit(Audit),
    /// Say what was found of ONNX Runtime and the model, and what to do
    Doctor(Network),
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  All cameras of the rig, in its order:
    mvtop-cli infer --rig rig.json left.png right.png
  Some cameras, poses in the frame of one of them, with pictures:
    mvtop-cli infer --rig rig.json left=a.png top=b.png --reference top --overlay out
  For a program to read:
    mvtop-cli infer --rig rig.json left.png right.png --json > poses.json")]
pub struct Infer {
    /// Rig file: the cameras, their lenses and where they are
    #[arg(long, value_name = "FILE")]
    pub rig: PathBuf,

    /// PNG, JPEG, TIFF or BMP images: one for each camera in the rig's order, or ID=PATH for some cameras
    #[arg(required = true, value_name = "IMAGE")]
    pub images: Vec<PathBuf>,

    /// Camera in whose frame poses are given [default: the rig's]
    #[arg(long, value_name = "ID")]
    pub reference: Option<String>,

    /// Use the boxes in this file instead of detecting objects
    #[arg(long, value_name = "FILE", conflicts_with = "min_views")]
    pub boxes: Option<PathBuf>,

    #[command(flatten)]
    pub detection: Detection,

    /// Print JSON instead of a table
    #[arg(long, conflicts_with = "truth")]
    pub json: bool,

    /// Print the known poses in this file (truth.json) beside the predicted ones; in pictures, thin
    /// white axes
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,

    /// Draw the poses onto copies of the images, in this folder
    #[arg(long, value_name = "DIR")]
    pub overlay: Option<PathBuf>,

    /// Overwrite pictures that exist
    #[arg(long, requires = "overlay")]
    pub force: bool,

    #[command(flatten)]
    pub network: Network,
}

#[derive(Args)]
#[command(after_help = "\
A sample is a folder with rig.json, truth.json and one image for each camera, <ID>.png or .jpg.
The last line on stdout is one line of JSON; docs/output.md says what it holds, and what --out
and the noise are exactly.

Examples:
  Detected boxes, all views; one line of JSON per object of the truth to look into:
    mvtop-cli eval --samples out/eval --out results.jsonl
  One view of the same samples:
    mvtop-cli eval --samples out/eval --views 1
  A calibration that is off by 0.5 degrees and 5 mm:
    mvtop-cli eval --samples out/eval --rig-noise-deg 0.5 --rig-noise-mm 5
  True boxes, each side off by 5 % of the box's size:
    mvtop-cli eval --samples out/eval --true-boxes --box-noise 0.05
  A split of a data set in BOP's layout, two frames of a scene at a time (docs/bop.md); the same
  command goes on after an interruption:
    mvtop-cli eval --dataset ycbv --split test --views 2 --report out/ycbv
  All cameras of a frame:
    mvtop-cli eval --dataset ipd --split val --grouping frame --report out/ipd")]
pub struct Eval {
    /// Folder of sample folders
    #[arg(long, value_name = "DIR", required_unless_present = "dataset")]
    pub samples: Option<PathBuf>,

    #[command(flatten)]
    pub split: Split,

    /// Use the true boxes instead of detecting objects
    #[arg(long, conflicts_with = "min_views")]
    pub true_boxes: bool,

    #[command(flatten)]
    pub detection: Detection,

    /// Use only the reference camera and those that follow it, this many [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub views: Option<u32>,

    /// Move each side of the true boxes at random: standard deviation, as a share of the box's size
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = not_negative)]
    #[arg(requires = "true_boxes")]
    pub box_noise: f64,

    /// Turn every camera but the reference by this angle about a random axis through its center
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = not_negative)]
    pub rig_noise_deg: f64,

    /// Move the center of every camera but the reference by this distance in a random direction
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = not_negative)]
    pub rig_noise_mm: f64,

    /// Which random axes and directions: the same seed gives the same ones, scaled, for any noise
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub noise_seed: u64,

    /// Largest rotation error of a pose that counts as resolved
    #[arg(long, value_name = "DEG", default_value_t = 15.0, value_parser = not_negative)]
    pub resolved_deg: f64,

    /// Write one line of JSON for each object of the truth to this file
    #[arg(
        long,
        value_name = "FILE.jsonl",
        group = "written",
        conflicts_with = "dataset"
    )]
    pub out: Option<PathBuf>,

    /// Overwrite the file if it exists; with --report, begin anew
    #[arg(long, requires = "written")]
    pub force: bool,

    #[command(flatten)]
    pub network: Network,
}

/// A split of a data set in BOP's layout, and how to go through it.
#[derive(Args)]
pub struct Split {
    /// Folder of a data set in BOP's layout, instead of --samples
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with = "samples",
        requires = "report"
    )]
    pub dataset: Option<PathBuf>,

    /// Folder of the data set that holds the scenes
    #[arg(
        long,
        value_name = "NAME",
        default_value = "test",
        requires = "dataset"
    )]
    pub split: String,

    /// What is seen together: frames of a `scene`, or the cameras of a `frame`
    #[arg(long, value_name = "WHAT", default_value_t, requires = "dataset")]
    pub grouping: Grouping,

    /// Camera files whose images are references: CAM of scene_camera_CAM.json [default: the first]
    #[arg(long, value_name = "CAM", requires = "dataset")]
    pub sensor: Option<String>,

    /// BOP's test targets, a multi-view list, or pairs.json [default: every image]
    #[arg(long, value_name = "FILE", requires = "dataset")]
    pub targets: Option<PathBuf>,

    /// How far a surface may lie behind the measured one and still count as seen, for VSD (only of
    /// data sets with depth images); BOP's, but for ITODD 5
    #[arg(long, value_name = "MM", default_value_t = 15.0, value_parser = not_negative)]
    #[arg(requires = "dataset")]
    pub vsd_delta_mm: f64,

    /// Ids of the objects to evaluate [default: those the model knows]
    #[arg(
        long,
        value_name = "ID,...",
        value_delimiter = ',',
        requires = "dataset"
    )]
    pub objects: Option<Vec<u32>>,

    /// Folder for the results: CSV in BOP's format, JSON, and a page with plots
    #[arg(long, value_name = "DIR", group = "written", requires = "dataset")]
    pub report: Option<PathBuf>,
}

#[derive(Args)]
pub struct Detection {
    /// Leave out objects that are detected in fewer images: 2 spares nearly all false ones, and
    /// costs those that only one image shows
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub min_views: u32,
}

#[derive(Args)]
pub struct Network {
    /// Model bundle [default: $MVTOP_MODEL, else models/mvball here or above the executable]
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

/// A number that noise can have as its size.
fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && number >= 0.0 => Ok(number),
        _ => Err("expected a number of 0 or more".into()),
    }
}

impl Network {
    pub fn options(&self) -> Options {
        Options {
            ort_lib: self.ort_lib.clone(),
            session: SessionOptions {
                provider: self.provider,
                threads: self.threads,
            },
        }
    }
}
