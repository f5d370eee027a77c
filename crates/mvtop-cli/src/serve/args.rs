//! The arguments of `serve`.

use std::path::PathBuf;

use clap::Args;

use crate::options::{RuntimeArgs, probability};

#[derive(Args)]
#[command(after_help = "\
Examples:
  Where this machine's programs and its browser reach it:
    mvtop-cli serve --model models/ycbv4 --rig rig.json
    curl -F left=@left.png -F right=@right.png http://127.0.0.1:8080/v1/predict
  For a cell, with a token, keeping what was not certain:
    mvtop-cli serve --host 0.0.0.0 --token-file token --model parts=runs/parts/bundle \\
      --rig cell=rig.json --record doubtful
  For a robot controller that knows TCP alone, images written to a folder by a camera program:
    mvtop-cli serve --rig rig.json --base base.json --line-port 9000 --line-images shots")]
pub struct Serve {
    /// Model bundle, repeatable with names; the first is the default of requests [default: as of
    /// `infer`]
    #[arg(long = "model", value_name = "[NAME=]DIR")]
    pub models: Vec<String>,

    /// Rig file, likewise
    #[arg(
        long = "rig",
        value_name = "[NAME=]FILE",
        required_unless_present = "example"
    )]
    pub rigs: Vec<String>,

    /// Serve the shipped example's rig
    #[arg(long)]
    pub example: bool,

    /// Where the robot's base is: a file with `T_base_world`, rows of the matrix in metres
    #[arg(long, value_name = "FILE")]
    pub base: Option<PathBuf>,

    /// Interface to listen on; 0.0.0.0 opens it to the network
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    pub host: String,

    /// Port of HTTP; 0: any free one
    #[arg(long, value_name = "N", default_value_t = 8080)]
    pub port: u16,

    /// File with the token that requests must show [default: $MVTOP_TOKEN, else none]
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,

    /// Exposures that may wait; further ones are refused with a time to retry
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(..=1000))]
    pub waiting: u32,

    /// Largest body of a request, MiB
    #[arg(long, value_name = "MIB", default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub max_body_mb: u32,

    /// Longest time to receive a request
    #[arg(long, value_name = "S", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=3600))]
    pub body_seconds: u32,

    /// Longest time to answer, with waiting
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=3600))]
    pub request_seconds: u32,

    /// Memory for the page's images, MiB
    #[arg(long, value_name = "MIB", default_value_t = 128, value_parser = clap::value_parser!(u32).range(..=65536))]
    pub history_mb: u32,

    /// Keep exposures that failed, found nothing or are doubtful, in this folder
    #[arg(long, value_name = "DIR")]
    pub record: Option<PathBuf>,

    /// Most exposures kept; the oldest are removed
    #[arg(long, value_name = "N", default_value_t = 1000, requires = "record", value_parser = clap::value_parser!(u32).range(1..))]
    pub record_most: u32,

    /// Most space for them, MiB
    #[arg(long, value_name = "MIB", default_value_t = 2048, requires = "record", value_parser = clap::value_parser!(u32).range(1..))]
    pub record_most_mb: u32,

    /// Keep exposures with a pose of lower confidence, if the request names none
    #[arg(long, value_name = "P", default_value_t = 0.8, requires = "record", value_parser = probability)]
    pub record_below: f64,

    /// Port of the line protocol for robots; 0: any free one
    #[arg(long, value_name = "N")]
    pub line_port: Option<u16>,

    /// Folder of its images, named after cameras
    #[arg(long, value_name = "DIR", requires = "line_port")]
    pub line_images: Option<PathBuf>,

    #[command(flatten)]
    pub runtime: RuntimeArgs,
}
