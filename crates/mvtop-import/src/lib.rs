//! Rigs from the calibration files of other programs: OpenCV, ROS, Kalibr, COLMAP, BOP, NeRF, DLR
//! CalLab, HALCON, EuRoC, aniposelib, EasyMocap, camodocal, OpenMVG, AliceVision, Open3D, Metashape,
//! multical, MC-Calib, MATLAB, ZED and DepthAI.
//!
//! Files differ in axes, direction, unit, order of quaternions, half a pixel and names of lenses. What
//! a file says decides; what it cannot say is asked for by name ([`Options`]); what a rig cannot
//! express is refused, or fitted with the error of the fit in a note. Nothing is guessed.

#![deny(missing_docs)]

mod alicevision;
mod anipose;
mod bop;
mod callab;
mod camodocal;
mod colmap;
mod depthai;
mod draft;
mod easymocap;
mod euroc;
mod format;
mod halcon;
mod kalibr;
mod lens;
mod matlab;
mod mccalib;
mod metashape;
mod multical;
mod names;
mod nerf;
mod node;
mod open3d;
mod opencv;
mod openmvg;
mod options;
mod ros;
mod source;
mod unread;
mod xml;
mod yaml;
mod zed;

use std::path::PathBuf;

pub use format::Format;
pub use options::{Direction, ImageSize, Options, Unit};

use mvtop_geometry::{Error, Result, Rig};

/// A rig, and what there is to know of how it came about.
#[derive(Debug)]
#[non_exhaustive]
pub struct Imported {
    /// In metres.
    pub rig: Rig,
    /// The format that was read.
    pub format: Format,
    /// The files that were read, also those of a folder.
    pub files: Vec<PathBuf>,
    /// Sentences: what was taken for what, and the errors of lenses that were fitted.
    pub notes: Vec<String>,
}

/// A sentence about what is wrong, without the file's name.
type Checked<T> = std::result::Result<T, String>;

/// Reads the calibration files of one rig.
///
/// - `paths`: in the order in which their cameras are wanted; of COLMAP the folder will do
///
/// # Errors
/// [`Error::Read`] where a file cannot be read; [`Error::Rig`] for a file that is none of the format,
/// that leaves open what `options` do not say, or whose cameras a rig cannot express.
///
/// ```no_run
/// use mvtop_import::{Options, Unit, import};
///
/// let options = Options { unit: Some(Unit::Millimetre), ..Options::default() };
/// let imported = import(&["intrinsics.yml".into(), "extrinsics.yml".into()], &options)?;
/// println!("{}", imported.rig.to_json());
/// # Ok::<(), mvtop_geometry::Error>(())
/// ```
pub fn import(paths: &[PathBuf], options: &Options) -> Result<Imported> {
    let sources = source::read(paths)?;
    let of = |origin: String| {
        move |problem: String| {
            // Of one file, the name is there already.
            let named = problem.strip_prefix(&format!("{origin}: "));
            Error::Rig {
                problem: named.map(str::to_owned).unwrap_or(problem),
                origin,
                cause: None,
            }
        }
    };
    let all = sources.iter().map(|s| s.name.as_str()).collect::<Vec<_>>();
    let all = all.join(", ");
    let format = match options.format {
        Some(format) => format,
        None => format::recognise(&sources).map_err(of(all.clone()))?,
    };
    options.check().map_err(of(all.clone()))?;
    let read = match format {
        Format::OpenCv => opencv::read,
        Format::Ros => ros::read,
        Format::Kalibr => kalibr::read,
        Format::Colmap => colmap::read,
        Format::Bop => bop::read,
        Format::Nerf => nerf::read,
        Format::CalLab => callab::read,
        Format::Halcon => halcon::read,
        Format::Euroc => euroc::read,
        Format::Anipose => anipose::read,
        Format::EasyMocap => easymocap::read,
        Format::Camodocal => camodocal::read,
        Format::OpenMvg => openmvg::read,
        Format::AliceVision => alicevision::read,
        Format::Open3d => open3d::read,
        Format::Metashape => metashape::read,
        Format::Multical => multical::read,
        Format::McCalib => mccalib::read,
        Format::Matlab => matlab::read,
        Format::Zed => zed::read,
        Format::DepthAi => depthai::read,
    };
    let (rig, notes) = read(&sources, options)
        .and_then(|draft| draft.finish(options))
        .map_err(of(all))?;
    let files = sources.into_iter().map(|source| source.path).collect();
    Ok(Imported {
        rig,
        format,
        files,
        notes,
    })
}
