//! The arguments of `rig`.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use mvtop_core::calibration::Expected;
use mvtop_import::{Direction, Format, ImageSize, Options, Unit};

use crate::options::{NetworkArgs, positive};

#[derive(Subcommand)]
pub enum Rig {
    /// Make a rig file from another program's calibration
    Import(Import),
    /// Describe a rig: poses, shared views, a picture
    Show(Show),
    /// Check a rig for implausible poses and, with images, for cameras that are off
    Check(Check),
    /// Correct the poses of cameras by images
    Refine(Refine),
    /// Make a rig file from images of a board, all cameras at once (in the Python wheel)
    Calibrate(Wheel),
    /// Print a board for it, PDF or SVG (in the Python wheel)
    Board(Wheel),
    /// Bring a rig into the frame of the robot's base (in the Python wheel)
    HandEye(Wheel),
}

/// What the wheel's command does before it comes to this one.
#[derive(Args)]
pub struct Wheel {
    #[arg(
        value_name = "ARGUMENT",
        trailing_var_arg = true,
        allow_hyphen_values = true
    )]
    pub arguments: Vec<OsString>,
}

#[derive(Args)]
#[command(after_help = "\
The format is recognised where it can be. What a file cannot say is asked for by the flag's name;
what a rig file cannot express is refused, or fitted with the error in px.
docs/how-to/import-a-calibration.md says what to type, by format.

Examples:
  A stereo pair of OpenCV, calibrated with squares of 25 mm, images of 1280 x 720:
    mvtop-cli rig import intrinsics.yml extrinsics.yml --scale 0.025 --image-size 1280x720 -o rig.json
  ROS, one camera_info each, and the transforms (or robot.urdf):
    mvtop-cli rig import left.yaml right.yaml tf_static.yaml -o rig.json
  COLMAP, whose model is 0.173 m to the unit:
    mvtop-cli rig import sparse/0 --scale 0.173 -o rig.json")]
pub struct Import {
    /// Calibration files of one rig, or COLMAP's folder
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// Rig file to write
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,

    /// Format [default: recognised]
    #[arg(long, value_name = "FORMAT", value_parser = formats())]
    pub from: Option<Format>,

    /// Metres per unit of length, such as the side of OpenCV's square
    #[arg(long, value_name = "METRES", value_parser = positive, conflicts_with = "unit")]
    pub scale: Option<f64>,

    /// Unit of the file's lengths: m, cm or mm
    #[arg(long, value_name = "UNIT", value_parser = unit)]
    pub unit: Option<Unit>,

    /// Image size of all cameras, or ID=WxH of one, if not in the file
    #[arg(long, value_name = "WxH", value_parser = image_size)]
    pub image_size: Vec<ImageSize>,

    /// Direction of poses, if not in the file: world_from_cam (the camera's pose) or cam_from_world
    #[arg(long, value_name = "DIRECTION", value_parser = direction)]
    pub direction: Option<Direction>,

    /// Lens, if not in the file
    #[arg(long, value_name = "MODEL", value_parser = ["pinhole", "fisheye"])]
    pub model: Option<String>,

    /// Largest angle from the optical axis at which the lens is used, degrees
    #[arg(long, value_name = "DEG", value_parser = positive)]
    pub max_angle: Option<f64>,

    /// BOP: the image whose cameras make the rig
    #[arg(long, value_name = "N")]
    pub image: Option<u32>,

    /// ROS: images are rectified (image_rect)
    #[arg(long)]
    pub rectified: bool,

    /// Accept cameras within 2 mm of each other, or more than 100 m apart
    #[arg(long)]
    pub trust_unit: bool,

    /// Key that states neither a lens nor a place nor a size; unknown keys are refused otherwise
    #[arg(long, value_name = "KEY")]
    pub ignore: Vec<String>,

    /// Overwrite an existing rig file
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Show {
    /// Rig file
    #[arg(value_name = "RIG")]
    pub rig: PathBuf,

    /// Draw cameras, axes and distances into this SVG
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,

    /// Overwrite an existing picture
    #[arg(long, requires = "picture")]
    pub force: bool,
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  Where cameras stand and look, without images:
    mvtop-cli rig check rig.json
  With images of objects that the model knows, two sets of a rig of three cameras:
    mvtop-cli rig check rig.json a0.png b0.png c0.png a1.png b1.png c1.png --model models/ycbv4")]
pub struct Check {
    #[command(flatten)]
    pub show: Show,

    /// Images of the model's objects: sets of one per camera, in the rig's order or named after the
    /// cameras; or ID=PATH, where a repeated id begins the next set
    #[arg(value_name = "IMAGE")]
    pub images: Vec<PathBuf>,

    #[command(flatten)]
    pub with: Images,
}

/// What images are compared with a rig by.
#[derive(Args)]
pub struct Images {
    /// Expected rotation error of a camera: standard deviation per axis, degrees
    #[arg(long, value_name = "DEG", value_parser = positive, default_value = "1")]
    pub turn_sd: f64,

    /// Expected translation error of a camera: standard deviation per axis, metres
    #[arg(long, value_name = "METRES", value_parser = positive, default_value = "0.01")]
    pub shift_sd: f64,

    #[command(flatten)]
    pub network: NetworkArgs,
}

#[derive(Args)]
#[command(after_help = "\
Cameras that agree with each other stay where they are; intrinsics and lenses are left as they are. The
objects' meshes say how large they are, and so how far apart the cameras stand.

Example:
    mvtop-cli rig refine rig.json a0.png b0.png c0.png a1.png b1.png c1.png --model models/ycbv4 -o better.json")]
pub struct Refine {
    /// Rig file
    #[arg(value_name = "RIG")]
    pub rig: PathBuf,

    /// Images of the model's objects: sets of one per camera, in the rig's order or named after the
    /// cameras; or ID=PATH, where a repeated id begins the next set
    #[arg(value_name = "IMAGE", required = true)]
    pub images: Vec<PathBuf>,

    /// Rig file to write; not the one that is read
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,

    /// Overwrite an existing rig file
    #[arg(long)]
    pub force: bool,

    #[command(flatten)]
    pub with: Images,
}

impl Images {
    pub fn expected(&self) -> Expected {
        Expected {
            turn_deg: self.turn_sd,
            shift_m: self.shift_sd,
        }
    }
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
            max_angle: self.max_angle,
            image: self.image,
            rectified: self.rectified,
            trust_unit: self.trust_unit,
            ignore: self.ignore.clone(),
        }
    }
}

fn formats() -> impl TypedValueParser<Value = Format> {
    let names = PossibleValuesParser::new(Format::ALL.map(Format::name));
    names.try_map(|name| Format::named(&name).ok_or("an unknown format"))
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
