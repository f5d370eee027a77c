//! The arguments of `audit`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::options::positive;

#[derive(Subcommand)]
pub enum Audit {
    /// Count poses of one split that recur in another, as of test in training
    Leakage(LeakageArgs),
}

#[derive(Args)]
#[command(after_help = "\
A pose of one split recurs in the other where that holds a pose of the same object whose translation
is within --within-mm and which differs by at most
  with --meshes: --add-percent, the mean distance of the model's points under the two poses (ADD) in
                 percent of the diameter in models_info.json; measured on at most 1000 vertices
  without:       --rot-deg, the angle between the rotations.
Poses that coincide in translation alone are counted in a column of their own. Poses that recur
within their own split are counted as `repeated`, and are no leak.

The histogram: with --meshes, ADD of each pose of split a to the nearest of all poses of its object
in b, in bins of 1 % of the diameter; without, the angle to the pose with the same translation, in
bins of 1 degree. docs/how-to/audit-leakage.md says more.

Examples:
  Does training show poses of the test split? (YCB-V, in the layout of BOP)
    mvtop-cli audit leakage --a ycbv/test --b ycbv/train_synth --meshes ycbv/models_eval
  A page with the histogram, and a list to look into:
    mvtop-cli audit leakage --a ycbv/test --b ycbv/train_synth --meshes ycbv/models_eval \\
      --report out/leakage")]
pub struct LeakageArgs {
    /// First split: a folder of scenes with scene_gt.json, or one scene
    #[arg(long, value_name = "DIR")]
    pub a: PathBuf,

    /// Split to search
    #[arg(long, value_name = "DIR")]
    pub b: PathBuf,

    /// BOP's models folder (models_info.json, obj_NNNNNN.ply); without it, rotations are compared
    #[arg(long, value_name = "DIR")]
    pub meshes: Option<PathBuf>,

    /// Largest distance of equal translations
    #[arg(long, value_name = "MM", default_value_t = 0.01, value_parser = positive)]
    pub within_mm: f64,

    /// Largest ADD of equal poses, in percent of the diameter
    #[arg(long, value_name = "PERCENT", default_value_t = 1.0, value_parser = positive)]
    #[arg(requires = "meshes")]
    pub add_percent: f64,

    /// Largest angle of equal poses, without meshes
    #[arg(long, value_name = "DEG", default_value_t = 1.0, value_parser = positive)]
    #[arg(conflicts_with = "meshes")]
    pub rot_deg: f64,

    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,

    /// Write leakage.json (counts, histograms) and pairs.csv (recurring poses) to this folder
    #[arg(long, value_name = "DIR", group = "results")]
    pub out: Option<PathBuf>,

    /// Write the files of --out, report.html and histogram.svg to this folder
    #[arg(long, value_name = "DIR", group = "results")]
    pub report: Option<PathBuf>,

    /// Overwrite existing files
    #[arg(long, requires = "results")]
    pub force: bool,
}
