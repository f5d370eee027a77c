//! The arguments of `eval`.

use std::path::PathBuf;

use clap::{ArgGroup, Args, Subcommand};
use mvtop_core::Estimator;
use mvtop_eval::bop::Grouping;
use mvtop_eval::runner::bop::{Options, Split};
use mvtop_eval::runner::{Bounds, Conditions, Noise};

use crate::failure::Result;
use crate::options::{
    Detection, NetworkArgs, Refinement, knows_confidence, not_negative, probability,
};

#[derive(Subcommand)]
pub enum Eval {
    /// Evaluate samples: folders with a rig, its images and the truth
    Samples(SamplesArgs),
    /// Evaluate a split of a data set in BOP's layout
    Bop(BopArgs),
}

#[derive(Args)]
#[command(after_help = "\
A sample is a folder with rig.json, truth.json and one image for each camera, <ID>.png or .jpg.
docs/reference/json.md says what --json and --out hold, and what the noise is.

Examples:
  Detected boxes, all views; one line of JSON per object of the truth to look into:
    mvtop-cli eval samples out/eval --out results.jsonl
  Only poses that are right with 90 %, by their own confidence:
    mvtop-cli eval samples out/eval --min-confidence 0.9
  One view of the same samples:
    mvtop-cli eval samples out/eval --views 1
  A calibration that is off by 0.5 degrees and 5 mm:
    mvtop-cli eval samples out/eval --rig-noise-deg 0.5 --rig-noise-mm 5
  True boxes, each side off by 5 % of the box's size; for a program to read:
    mvtop-cli eval samples out/eval --true-boxes --box-noise 0.05 --json")]
pub struct SamplesArgs {
    /// Folder of sample folders
    #[arg(value_name = "FOLDER")]
    pub folder: PathBuf,

    /// Print one line of JSON instead of text
    #[arg(long)]
    pub json: bool,

    /// Write one line of JSON per true object to this file
    #[arg(long, value_name = "FILE.jsonl")]
    pub out: Option<PathBuf>,

    /// Overwrite an existing file
    #[arg(long, requires = "out")]
    pub force: bool,

    #[command(flatten)]
    pub trial: Trial,
}

#[derive(Args)]
#[command(group = ArgGroup::new("results"))]
#[command(after_help = "\
docs/how-to/evaluate-on-bop.md says what is read, which views go together, what is written, and what
the metrics are. The same command goes on after an interruption.

Examples:
  Two frames of a scene at a time, and a page with plots of the results:
    mvtop-cli eval bop --dataset ycbv --split test --views 2 --report out/ycbv
  BOP's test targets, four views; results for programs only:
    mvtop-cli eval bop --dataset ycbv --views 4 --targets ycbv/test_targets_bop19.json \\
      --out out/ycbv
  All cameras of a frame, as BOP-Industrial lists them:
    mvtop-cli eval bop --dataset ipd --targets ipd/test_targets_multiview_bop25.json --out out/ipd
  Results of any program in BOP's format; no network is needed:
    mvtop-cli eval bop --dataset ycbv --targets ycbv/test_targets_bop19.json \\
      --predictions cosypose_ycbv-test.csv gdrnpp_ycbv-test.csv")]
pub struct BopArgs {
    #[command(flatten)]
    pub split: SplitArgs,

    /// Score these results in BOP's format, side by side, instead of predicting
    #[arg(long, value_name = "FILE.csv", num_args = 1..)]
    #[arg(conflicts_with_all = ["views", "min_views", "min_confidence", "true_boxes", "boxes", "rig_deg",
        "rig_mm", "model", "ort_lib", "provider", "threads", "grouping"])]
    pub predictions: Vec<PathBuf>,

    /// Object id of a class of the model, or of a name in --predictions [default: its number]
    #[arg(long, value_name = "NAME=ID", value_parser = name_and_id)]
    pub map: Vec<(String, u32)>,

    /// Print one line of JSON instead of text
    #[arg(long)]
    pub json: bool,

    /// Write results (BOP's CSV, JSON) to this folder
    #[arg(long, value_name = "DIR", group = "results")]
    pub out: Option<PathBuf>,

    /// Write the files of --out and report.html, a page with plots and pictures
    #[arg(long, value_name = "DIR", group = "results")]
    pub report: Option<PathBuf>,

    /// Replace existing results instead of resuming
    #[arg(long)]
    pub force: bool,

    /// Visibility tolerance of VSD, for data sets with depth images; BOP uses 5 for ITODD
    #[arg(long, value_name = "MM", default_value_t = 15.0, value_parser = not_negative)]
    pub vsd_delta_mm: f64,

    #[command(flatten)]
    pub trial: Trial,
}

/// A split of a data set in BOP's layout, and how to go through it.
#[derive(Args)]
pub struct SplitArgs {
    /// Folder of the data set
    #[arg(long, value_name = "DIR")]
    pub dataset: PathBuf,

    /// Its folder of scenes
    #[arg(long, value_name = "NAME", default_value = "test")]
    pub split: String,

    /// Views of a group: frames of a `scene`, or cameras of a `frame` [default: by number of cameras]
    #[arg(long, value_name = "WHAT")]
    pub grouping: Option<Grouping>,

    /// Reference cameras: CAM of scene_camera_CAM.json [default: BOP's, or the first]
    #[arg(long, value_name = "CAM")]
    pub sensor: Option<String>,

    /// BOP's test targets, a multi-view list, or pairs.json [default: every image]
    #[arg(long, value_name = "FILE")]
    pub targets: Option<PathBuf>,

    /// Ids of the objects to evaluate [default: those the model knows]
    #[arg(long, value_name = "ID,...", value_delimiter = ',')]
    pub objects: Option<Vec<u32>>,
}

/// What the network is shown, what is wrong with it, and what counts as right.
#[derive(Args)]
#[command(next_help_heading = "Conditions")]
pub struct Trial {
    /// Number of cameras used, from the reference on [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub views: Option<u32>,

    #[command(flatten)]
    pub detection: Detection,

    #[command(flatten)]
    pub refinement: Refinement,

    /// Leave out poses of lower confidence
    #[arg(long, value_name = "P", value_parser = probability, conflicts_with = "no_refine")]
    pub min_confidence: Option<f64>,

    /// Use the true boxes instead of the detector's
    #[arg(long, conflicts_with = "min_views")]
    pub true_boxes: bool,

    #[command(flatten)]
    pub noise: NoiseArgs,

    /// Largest rotation error of a resolved pose
    #[arg(long, value_name = "DEG", default_value_t = 15.0, value_parser = not_negative)]
    pub resolved_deg: f64,

    /// Largest rotation error of a correct pose
    #[arg(long, value_name = "DEG", default_value_t = 5.0, value_parser = not_negative)]
    pub right_deg: f64,

    /// Largest translation error of a correct pose
    #[arg(long, value_name = "MM", default_value_t = 5.0, value_parser = not_negative)]
    pub right_mm: f64,

    #[command(flatten)]
    pub network: NetworkArgs,
}

impl Trial {
    /// The network that is evaluated.
    pub fn load(&self) -> Result<Estimator> {
        let estimator = self.network.load(&self.network.bundle()?)?;
        if self.min_confidence.is_some() {
            knows_confidence(estimator.bundle())?;
        }
        Ok(estimator)
    }
}

// A plain comment, as clap would take it for the command's own: how much is added, and which draw.
#[derive(Args)]
pub struct NoiseArgs {
    /// Move each side of the true boxes at random: standard deviation, as a share of the box's size
    #[arg(long = "box-noise", value_name = "SHARE", default_value_t = 0.0)]
    #[arg(value_parser = not_negative, requires = "true_boxes")]
    pub boxes: f64,

    /// Turn every camera but the reference by this angle about a random axis through its center
    #[arg(long = "rig-noise-deg", value_name = "DEG", default_value_t = 0.0)]
    #[arg(value_parser = not_negative)]
    pub rig_deg: f64,

    /// Move the center of every camera but the reference by this distance in a random direction
    #[arg(long = "rig-noise-mm", value_name = "MM", default_value_t = 0.0)]
    #[arg(value_parser = not_negative)]
    pub rig_mm: f64,

    /// Which random axes and directions: the same seed gives the same ones, scaled, for any noise
    #[arg(long = "noise-seed", value_name = "N", default_value_t = 0)]
    pub seed: u64,
}

fn name_and_id(text: &str) -> std::result::Result<(String, u32), String> {
    let parsed = text
        .rsplit_once('=')
        .and_then(|(name, id)| Some((name.to_owned(), id.parse().ok()?)));
    parsed.ok_or_else(|| "expected NAME=ID, as in mug=3".into())
}

impl Trial {
    pub fn conditions(&self) -> Conditions {
        Conditions {
            views: self.views,
            min_views: self.detection.min_views,
            refine: self.refinement.wanted(),
            min_confidence: self.min_confidence,
            true_boxes: self.true_boxes,
            noise: Noise {
                boxes: self.noise.boxes,
                rig_deg: self.noise.rig_deg,
                rig_mm: self.noise.rig_mm,
                seed: self.noise.seed,
            },
            bounds: Bounds {
                resolved_deg: self.resolved_deg,
                right_deg: self.right_deg,
                right_mm: self.right_mm,
            },
        }
    }
}

impl BopArgs {
    pub fn options(&self) -> Options {
        let SplitArgs {
            dataset,
            split,
            grouping,
            sensor,
            targets,
            objects,
        } = &self.split;
        Options {
            split: Split {
                dataset: dataset.clone(),
                split: split.clone(),
                grouping: *grouping,
                sensor: sensor.clone(),
                targets: targets.clone(),
                objects: objects.clone(),
            },
            predictions: self.predictions.clone(),
            map: self.map.clone(),
            vsd_delta_mm: self.vsd_delta_mm,
            force: self.force,
            conditions: self.trial.conditions(),
        }
    }
}
