//! The formats, and how a file shows which one it is.

use std::fmt;

use serde_json::Value;

use crate::opencv::keys::{by_camera, has_matrices_in_a_list};
use crate::ros::{frames, hand_eye};
use crate::source::Source;
use crate::{
    Checked, alicevision, anipose, camodocal, depthai, easymocap, matlab, mccalib, metashape,
    multical, nerf, open3d, openmvg, xml, yaml, zed,
};

/// A program's calibration files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// OpenCV's FileStorage (YAML, JSON or XML), and files with its names.
    OpenCv,
    /// ROS: `camera_info`, and TF, a URDF or a list of frames.
    Ros,
    /// Kalibr: a chain of cameras.
    Kalibr,
    /// COLMAP: cameras and images, text or binary.
    Colmap,
    /// BOP: `scene_camera.json`.
    Bop,
    /// NeRF: `transforms.json`.
    Nerf,
    /// DLR CalLab.
    CalLab,
    /// HALCON: camera parameters and poses.
    Halcon,
    /// EuRoC: `sensor.yaml`.
    Euroc,
    /// aniposelib's TOML, as Pose2Sim, Caliscope and FreeMoCap write it, too.
    Anipose,
    /// EasyMocap: `intri.yml` and `extri.yml`.
    EasyMocap,
    /// camodocal's cameras, and VINS' places of these.
    Camodocal,
    /// OpenMVG: `sfm_data.json`.
    OpenMvg,
    /// AliceVision and Meshroom: `cameras.sfm`.
    AliceVision,
    /// Open3D: camera parameters or a trajectory.
    Open3d,
    /// Agisoft Metashape: cameras as XML.
    Metashape,
    /// multical: `calibration.json`.
    Multical,
    /// MC-Calib: `calibrated_cameras_data.yml`.
    McCalib,
    /// MATLAB: camera parameters as JSON.
    Matlab,
    /// ZED: `SN12345678.conf`.
    Zed,
    /// DepthAI: the calibration of an OAK camera.
    DepthAi,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 21] = [
        Self::OpenCv,
        Self::Ros,
        Self::Kalibr,
        Self::Colmap,
        Self::Bop,
        Self::Nerf,
        Self::CalLab,
        Self::Halcon,
        Self::Euroc,
        Self::Anipose,
        Self::EasyMocap,
        Self::Camodocal,
        Self::OpenMvg,
        Self::AliceVision,
        Self::Open3d,
        Self::Metashape,
        Self::Multical,
        Self::McCalib,
        Self::Matlab,
        Self::Zed,
        Self::DepthAi,
    ];

    /// What it is called, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenCv => "opencv",
            Self::Ros => "ros",
            Self::Kalibr => "kalibr",
            Self::Colmap => "colmap",
            Self::Bop => "bop",
            Self::Nerf => "nerf",
            Self::CalLab => "callab",
            Self::Halcon => "halcon",
            Self::Euroc => "euroc",
            Self::Anipose => "anipose",
            Self::EasyMocap => "easymocap",
            Self::Camodocal => "camodocal",
            Self::OpenMvg => "openmvg",
            Self::AliceVision => "alicevision",
            Self::Open3d => "open3d",
            Self::Metashape => "metashape",
            Self::Multical => "multical",
            Self::McCalib => "mccalib",
            Self::Matlab => "matlab",
            Self::Zed => "zed",
            Self::DepthAi => "depthai",
        }
    }

    /// By its name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// The one format that the files look like.
pub fn recognise(sources: &[Source]) -> Checked<Format> {
    let mut formats = Vec::new();
    for source in sources {
        formats.extend(look(source)?.map(|format| (format, source)));
    }
    // BOP's `camera.json` has OpenCV's names.
    if formats.iter().any(|(format, _)| *format == Format::Bop) {
        formats.retain(|(format, source)| {
            !(*format == Format::OpenCv && source.file_name().starts_with("camera"))
        });
    }
    match formats.split_first() {
        Some(((first, _), others)) if others.iter().all(|(other, _)| other == first) => Ok(*first),
        found => {
            let found = match found {
                None => "the format was not recognised".to_owned(),
                Some(_) => {
                    let names = formats.iter().map(|(format, source)| {
                        let name = source.path.file_name().unwrap_or_default();
                        format!("{}: {format}", name.display())
                    });
                    let names: Vec<_> = names.collect();
                    format!("the files look like several formats ({})", names.join(", "))
                }
            };
            let all = Format::ALL.map(Format::name).join(", ");
            Err(format!(
                "{found}; name it as `format` (--from), one of {all} \
                 (docs/how-to/import-a-calibration.md says what each has), \
                 or write a rig.json by hand (docs/reference/rig-file.md)"
            ))
        }
    }
}

/// What a file looks like, if anything that is known.
///
/// # Errors
/// Where it cannot be read at all.
fn look(source: &Source) -> Checked<Option<Format>> {
    let name = source.file_name();
    if ["cameras.bin", "images.bin"].contains(&name.as_str()) {
        return Ok(Some(Format::Colmap));
    }
    let text = source.text()?;
    let lines = || text.lines().take(200).map(str::trim);
    let has = |start: &str| lines().any(|line| line.starts_with(start));
    if name.ends_with("cameras.txt") || name.ends_with("images.txt") || has("#   CAMERA_ID, MODEL")
    {
        return Ok(Some(Format::Colmap));
    }
    if has("ParGroup: Camera") || has("Focus:") || has("# 3D POSE PARAMETERS") {
        return Ok(Some(Format::Halcon));
    }
    if lines().any(|line| line.starts_with("camera.") && line.contains('=')) {
        return Ok(Some(Format::CalLab));
    }
    if xml::is_xml(text) && text.contains("<robot") {
        return Ok(Some(Format::Ros));
    }
    if xml::is_xml(text) && metashape::is_it(text) {
        return Ok(Some(Format::Metashape));
    }
    if zed::is_it(text) {
        return Ok(Some(Format::Zed));
    }
    let documents = yaml::documents(source)?;
    let Some(value) = documents.first() else {
        return Ok(None);
    };
    let has = |key: &str| value.get(key).is_some();
    let any = |what: fn(&Value) -> bool| match value {
        Value::Object(map) => map.values().any(what),
        Value::Array(list) => list.iter().any(what),
        _ => false,
    };
    let in_all = |key: &'static str| match value.as_object() {
        Some(map) if !map.is_empty() => map.values().all(|value| value.get(key).is_some()),
        _ => false,
    };
    Ok(if anipose::is_it(value) {
        Some(Format::Anipose)
    } else if easymocap::is_it(value) {
        Some(Format::EasyMocap)
    } else if camodocal::is_it(value) {
        Some(Format::Camodocal)
    } else if openmvg::is_it(value) {
        Some(Format::OpenMvg)
    } else if alicevision::is_it(value) {
        Some(Format::AliceVision)
    } else if open3d::is_it(value) {
        Some(Format::Open3d)
    } else if multical::is_it(value) {
        Some(Format::Multical)
    } else if mccalib::is_it(value) {
        Some(Format::McCalib)
    } else if matlab::is_it(value) {
        Some(Format::Matlab)
    } else if depthai::is_it(value) {
        Some(Format::DepthAi)
    } else if nerf::is_it(value) {
        Some(Format::Nerf)
    } else if in_all("cam_K") || in_all("cam_model") {
        Some(Format::Bop)
    } else if has("T_BS") {
        Some(Format::Euroc)
    } else if hand_eye::is_it(value)
        || frames::is_it(value)
        || (has("distortion_model") && (has("projection_matrix") || has("P") || has("p")))
    {
        Some(Format::Ros)
    } else if any(|v| v.get("camera_model").is_some() && v.get("intrinsics").is_some()) {
        Some(Format::Kalibr)
    } else if text.starts_with("%YAML:1.0")
        || any(|v| v.get("type_id").is_some())
        || text.contains("opencv-matrix")
        || text.contains("<opencv_storage")
        || crate::opencv::has_camera(&by_camera(value.clone()))
    {
        Some(Format::OpenCv)
    } else if has_matrices_in_a_list(value) {
        return Err(format!(
            "{}: lists of camera matrices by position are not read; give an object of each camera, with its matrix, \
             lens, size and place",
            source.name
        ));
    } else {
        None
    })
}
