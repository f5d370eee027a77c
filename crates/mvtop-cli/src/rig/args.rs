//! The arguments of `rig`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use mvtop_import::{Direction, Format, ImageSize, Options, Unit};

use crate::args::positive;

#[derive(Subcommand)]
pub enum Rig {
    /// Make a rig file from the calibration files of another program
    Import(Import),
    /// Say where cameras stand and look, and which share a view; with a picture
    Show(Show),
    /// The same, and fail where what is seen cannot be meant
    Check(Show),
}

#[derive(Args)]
#[command(after_help = "\
The format is recognised where it can be. What a file cannot say is asked for by the flag's name;
what a rig file cannot express is refused, or fitted with the error in px. docs/calibrations.md says
what to type, by format.

Examples:
  A stereo pair of OpenCV, calibrated with squares of 25 mm, images of 1280 x 720:
    mvtop-cli rig import intrinsics.yml extrinsics.yml --scale 0.025 --image-size 1280x720 -o rig.json
  ROS, one camera_info each, and the transforms:
    mvtop-cli rig import left.yaml right.yaml tf_static.yaml -o rig.json
  COLMAP, whose model is 0.173 m to the unit:
    mvtop-cli rig import sparse/0 --scale 0.173 -o rig.json")]
pub struct Import {
    /// Calibration files of one rig; of COLMAP, the folder will do
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// Rig file to write
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,

    /// Format of the files: opencv, ros, kalibr, colmap, bop, nerf, callab, halcon or euroc [default:
    /// recognised]
    #[arg(long, value_name = "FORMAT", value_parser = format)]
    pub from: Option<Format>,

    /// Metres per unit of the file's lengths: the side of a square of OpenCV's board, say
    #[arg(long, value_name = "METRES", value_parser = positive, conflicts_with = "unit")]
    pub scale: Option<f64>,

    /// Unit of the file's lengths: m, cm or mm
    #[arg(long, value_name = "UNIT", value_parser = unit)]
    pub unit: Option<Unit>,

    /// Size of the images, where the file does not say it: of all cameras, or ID=WxH of one
    #[arg(long, value_name = "WxH", value_parser = image_size)]
    pub image_size: Vec<ImageSize>,

    /// What poses map to what, where the file does not say it: world_from_cam is the pose of the
    /// camera, cam_from_world its inverse
    #[arg(long, value_name = "DIRECTION", value_parser = direction)]
    pub direction: Option<Direction>,

    /// Lens, where the file does not name it: pinhole or fisheye
    #[arg(long, value_name = "MODEL", value_parser = ["pinhole", "fisheye"])]
    pub model: Option<String>,

    /// BOP: the image whose cameras make the rig
    #[arg(long, value_name = "N")]
    pub image: Option<u32>,

    /// ROS: the images are rectified (image_rect) rather than raw
    #[arg(long)]
    pub rectified: bool,

    /// Overwrite a rig file that exists
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Show {
    /// Rig file
    #[arg(value_name = "RIG")]
    pub rig: PathBuf,

    /// Draw cameras, axes and distances to this file, SVG
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,

    /// Overwrite a picture that exists
    #[arg(long, requires = "picture")]
    pub force: bool,
}

impl Import {
    pub fn options(&self) -> Options {
        Options {
            format: self.from,
            scale: self.scale,
            unit: self.unit,
            image_sizes: self.image_size.clone(),
            direction: self.direction,
            model: self.model.clone(),
            image: self.image,
            rectified: self.rectified,
        }
    }
}

fn format(text: &str) -> Result<Format, String> {
    let names = || Format::ALL.map(Format::name).join(", ");
    Format::named(text).ok_or_else(|| format!("expected one of {}", names()))
}

fn unit(text: &str) -> Result<Unit, String> {
    Unit::named(text).ok_or_else(|| "expected m, cm or mm".into())
}

fn image_size(text: &str) -> Result<ImageSize, String> {
    ImageSize::parse(text).ok_or_else(|| "expected WxH as 640x480, or ID=WxH".into())
}

fn direction(text: &str) -> Result<Direction, String> {
    Direction::named(text).ok_or_else(|| "expected world_from_cam or cam_from_world".into())
}
