//! The arguments of `audit`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

#[derive(Subcommand)]
pub enum Audit {
    /// Count the poses of one split that recur in another one, such as test in training
    Leakage(Leakage),
}

#[derive(Args)]
#[command(after_help = "\
A pose of one split recurs in the other where that holds a pose of the same object whose translation
is within --within-mm and which differs by at most
  with --models: --add-percent, the mean distance of the model's points under the two poses (ADD) in
                 percent of the diameter in models_info.json; measured on at most 1000 vertices
  without:       --rot-deg, the angle between the rotations.
Poses that coincide in translation alone are counted in a column of their own. Poses that recur
within their own split are counted as `repeated`, and are no leak.

The histogram of --json and --picture: with --models, ADD of each pose of split a to the nearest of
all poses of its object in b, in bins of 1 % of the diameter; without, the angle to the pose with the
same translation, in bins of 1 degree. docs/audit.md says more.

Examples:
  Does training show poses of the test split? (YCB-V, in the layout of BOP)
    mvtop-cli audit leakage --a ycbv/test --b ycbv/train_synth --models ycbv/models_eval
  With the picture, and a list to look into:
    mvtop-cli audit leakage --a ycbv/test --b ycbv/train_synth --models ycbv/models_eval \\
      --picture leakage.svg --pairs pairs.csv")]
pub struct Leakage {
    /// Split to look for: a folder of scenes that hold scene_gt.json, or one scene
    #[arg(long, value_name = "DIR")]
    pub a: PathBuf,

    /// Split to look in
    #[arg(long, value_name = "DIR")]
    pub b: PathBuf,

    /// Folder with models_info.json and obj_NNNNNN.ply; without it, rotations are compared
    #[arg(long, value_name = "DIR")]
    pub models: Option<PathBuf>,

    /// Largest distance of translations that count as the same
    #[arg(long, value_name = "MM", default_value_t = 0.01, value_parser = positive)]
    pub within_mm: f64,

    /// Largest ADD of poses that count as the same, in percent of the object's diameter
    #[arg(long, value_name = "PERCENT", default_value_t = 1.0, value_parser = positive)]
    #[arg(requires = "models")]
    pub add_percent: f64,

    /// Largest angle of poses that count as the same, where there are no models
    #[arg(long, value_name = "DEG", default_value_t = 1.0, value_parser = positive)]
    #[arg(conflicts_with = "models")]
    pub rot_deg: f64,

    /// Write the counts and the histogram of each object to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,

    /// Draw the histogram of all objects
    #[arg(long, value_name = "FILE.svg", value_parser = svg)]
    pub picture: Option<PathBuf>,

    /// Write one line for each recurring pose of split a, with the pose of b that it recurs as
    #[arg(long, value_name = "FILE.csv")]
    pub pairs: Option<PathBuf>,

    /// Overwrite files that exist
    #[arg(long)]
    pub force: bool,
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && number > 0.0 => Ok(number),
        _ => Err("expected a number above 0".into()),
    }
}

fn svg(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(suffix) if suffix.eq_ignore_ascii_case("svg") => Ok(path),
        _ => Err("expected a name that ends in .svg".into()),
    }
}
