//! Options that say which of the objects are wanted, and in which frame.

use std::path::{Path, PathBuf};

use clap::Args;
use mvtop_core::request::{Request, WorldBox};
use mvtop_core::{annotations, file, json};
use serde::Deserialize;

use crate::args::Infer;
use crate::failure::Result;

/// Largest file of a request that is read, bytes.
const MAX_FILE_BYTES: u64 = 1 << 24;

#[derive(Args)]
#[command(next_help_heading = "What is wanted")]
pub struct Choice {
    /// Look for objects of these classes alone
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub classes: Option<Vec<String>>,

    /// Give at most this many objects, the most probable ones
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub most: Option<u32>,

    /// Give only objects whose middle is in this box of the world frame: its least and its greatest
    /// corner, metres
    #[arg(long, value_name = "M", num_args = 6, value_names = ["X0", "Y0", "Z0", "X1", "Y1", "Z1"], allow_negative_numbers = true)]
    pub region: Option<Vec<f64>>,

    /// Give poses in this frame as well, as `T_frame_obj`: `world`, `base` or a camera
    #[arg(long, value_name = "NAME", requires = "json")]
    pub frame: Option<String>,

    /// Where the robot's base is: a file with `T_base_world`, rows of the matrix in metres
    #[arg(long, value_name = "FILE")]
    pub base: Option<PathBuf>,

    /// Give the grasps of the model's grasps.json with each object
    #[arg(long, requires = "json")]
    pub grasps: bool,

    /// For each class without an object, report the nearest candidate and the check that it failed
    #[arg(long)]
    pub why: bool,

    /// Read the request from this file, as `serve --record` keeps it: priors, planes, classes; other options override it
    #[arg(long, value_name = "FILE")]
    pub request: Option<PathBuf>,
}

impl Choice {
    /// What the arguments ask for.
    pub fn request(&self, args: &Infer) -> Result<Request> {
        let mut request = match &self.request {
            Some(path) => Request::from_json(&file::read_text(path, MAX_FILE_BYTES)?)?,
            None => Request::default(),
        };
        if let Some(path) = &args.boxes {
            request.boxes = Some(annotations::load_boxes(path)?);
        }
        if let Some(min_views) = args.detection.given() {
            request.min_views = Some(min_views);
        }
        request.refine = args.refinement.wanted().or(request.refine);
        request.min_confidence = args.min_confidence.or(request.min_confidence);
        request.most = self.most.map(|most| most as usize).or(request.most);
        request.grasps |= self.grasps;
        request.why |= self.why;
        if let Some([x0, y0, z0, x1, y1, z1]) = self.region.as_deref() {
            request.region = Some(WorldBox {
                min_m: [*x0, *y0, *z0],
                max_m: [*x1, *y1, *z1],
            });
        }
        if let Some(path) = &self.base {
            request.base_from_world = Some(base(path)?);
        }
        for (given, kept) in [
            (&args.reference, &mut request.reference),
            (&self.frame, &mut request.frame),
        ] {
            if given.is_some() {
                kept.clone_from(given);
            }
        }
        if self.classes.is_some() {
            request.classes.clone_from(&self.classes);
        }
        Ok(request)
    }
}

/// The transform from the world to the robot's base, of a file.
pub fn base(path: &Path) -> Result<[[f64; 4]; 4]> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Base {
        #[serde(rename = "T_base_world")]
        base_from_world: [[f64; 4]; 4],
    }
    let base: Base = json::read(path, r#"{"T_base_world": 4x4 rows in metres}"#)?;
    Ok(base.base_from_world)
}
