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
    /// Model bundle, with a name if there are several; the first one is used where a request names
    /// none; may be repeated [default: as of `infer`]
    #[arg(long = "model", value_name = "[NAME=]DIR")]
    pub models: Vec<String>,

    /// Rig file, likewise
    #[arg(
        long = "rig",
        value_name = "[NAME=]FILE",
        required_unless_present = "example"
    )]
    pub rigs: Vec<String>,

    /// Serve the rig of the example that comes along
    #[arg(long)]
    pub example: bool,

    /// Where the robot's base is: a file with `T_base_world`, rows of the matrix in metres
    #[arg(long, value_name = "FILE")]
    pub base: Option<PathBuf>,

    /// Interface to listen on; 0.0.0.0 for all: then others on the network reach it
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    pub host: String,

    /// Port of HTTP; 0 for any that is free
    #[arg(long, value_name = "N", default_value_t = 8080)]
    pub port: u16,

    /// File with a token that requests must show [default: $MVTOP_TOKEN, else none]
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,

    /// Exposures that may wait while one is worked on; further ones are refused with a time to retry
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(..=1000))]
    pub waiting: u32,

    /// Largest body of a request, MiB
    #[arg(long, value_name = "MIB", default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub max_body_mb: u32,

    /// How long a client may take to send its images
    #[arg(long, value_name = "S", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=3600))]
    pub body_seconds: u32,

    /// How long an answer may take, waiting included
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=3600))]
    pub request_seconds: u32,

    /// Memory for the images of the last exposures, which the page shows, MiB
    #[arg(long, value_name = "MIB", default_value_t = 128, value_parser = clap::value_parser!(u32).range(..=65536))]
    pub history_mb: u32,

    /// Keep exposures that failed, gave nothing or were not certain, in this folder
    #[arg(long, value_name = "DIR")]
    pub record: Option<PathBuf>,

    /// Most exposures that are kept; the oldest make way
    #[arg(long, value_name = "N", default_value_t = 1000, requires = "record", value_parser = clap::value_parser!(u32).range(1..))]
    pub record_most: u32,

    /// Most that they may take, MiB
    #[arg(long, value_name = "MIB", default_value_t = 2048, requires = "record", value_parser = clap::value_parser!(u32).range(1..))]
    pub record_most_mb: u32,

    /// Keep an exposure with a pose of less confidence, where the request names none
    #[arg(long, value_name = "P", default_value_t = 0.8, requires = "record", value_parser = probability)]
    pub record_below: f64,

    /// Port of the line protocol for robot controllers; 0 for any that is free
    #[arg(long, value_name = "N")]
    pub line_port: Option<u16>,

    /// Folder with the images that its FIND looks at, named after cameras
    #[arg(long, value_name = "DIR", requires = "line_port")]
    pub line_images: Option<PathBuf>,

    #[command(flatten)]
    pub runtime: RuntimeArgs,
}
