//! The files that `model.json` lists: their checksums, and those of points.

use std::fs::File;
use std::path::Path;

use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::SurfacePoint;
use crate::{Error, Result, file, json};

/// Largest text of a bundle that is read, bytes.
pub(super) const MAX_TEXT_BYTES: u64 = 1 << 28;
/// Largest file of points, bytes; the training writes 1200 points.
const MAX_POINTS_BYTES: u64 = 1 << 21;

#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct FileRecord {
    /// In hexadecimal digits.
    pub sha256: String,
    /// Size.
    pub bytes: u64,
}

impl FileRecord {
    /// Refuses a file that is not the one that was listed; what is plain from its name and size,
    /// before its bytes are read.
    ///
    /// - `dir`: the bundle's folder
    pub fn check(&self, dir: &Path, name: &str) -> Result<()> {
        let path = &dir.join(name);
        let refuse = |problem: String| Error::Bundle {
            path: path.clone(),
            problem,
        };
        let unreadable = |cause: std::io::Error| refuse(format!("cannot be read: {cause}"));
        let about = path.metadata().map_err(unreadable)?;
        let own = dir.canonicalize().map_err(unreadable)?.join(name);
        if !about.is_file() || path.canonicalize().map_err(unreadable)? != own {
            return Err(refuse(
                "is a link, a folder or a device, expected a file of the bundle's own; copy it there"
                    .into(),
            ));
        }
        let bytes = about.len();
        if bytes != self.bytes {
            return Err(refuse(format!(
                "has {bytes} bytes, expected {}; the bundle is incomplete or changed, get it again",
                self.bytes
            )));
        }
        let sha256 = File::open(path).and_then(digest).map_err(unreadable)?;
        if !sha256.eq_ignore_ascii_case(&self.sha256) {
            return Err(refuse(format!(
                "has sha256 {sha256}, expected {}; the bundle was changed, get it again",
                self.sha256
            )));
        }
        Ok(())
    }
}

#[derive(Deserialize)]
pub(super) struct PointsFile {
    pub unit: String,
    pub points: Vec<[f64; 6]>,
}

/// Text of the bundle; the error is the problem.
pub(super) fn read_text(path: &Path, most: u64) -> Result<String, String> {
    file::read_text(path, most).map_err(|error| match error {
        mvtop_geometry::Error::Read { cause, .. } => format!("cannot be read: {cause}"),
        other => other.to_string(),
    })
}

/// SHA-256 of a file, in hexadecimal.
pub(super) fn digest(mut file: File) -> std::io::Result<String> {
    let mut hash = Sha256::new();
    std::io::copy(&mut file, &mut hash)?;
    Ok(format!("{:x}", hash.finalize()))
}

pub(super) fn read_points(path: &Path) -> Result<Vec<SurfacePoint>> {
    let refuse = |problem: String| Error::Bundle {
        path: path.to_owned(),
        problem,
    };
    let text = read_text(path, MAX_POINTS_BYTES).map_err(refuse)?;
    let file: PointsFile =
        json::from_str(&text).map_err(|e| refuse(format!("is not a points file: {e}")))?;
    if file.unit != "m" {
        let unit = file.unit;
        return Err(refuse(format!("is in `{unit}`, expected metres (`m`)")));
    }
    if file.points.is_empty() {
        return Err(refuse("holds no points".into()));
    }
    let point = |(i, &[x, y, z, r, g, b]): (usize, &[f64; 6])| {
        let (position, color) = ([x, y, z], [r, g, b]);
        let valid = position.iter().all(|v| v.is_finite())
            && color.iter().all(|c| (0.0..=255.0).contains(c));
        // Rounded, since the file may hold averaged colors.
        let color = color.map(|c| c.round() as u8);
        let problem = || format!("point {i}: expected finite x, y, z and r, g, b from 0 to 255");
        let point = valid.then_some(SurfacePoint { position, color });
        point.ok_or_else(|| refuse(problem()))
    };
    file.points.iter().enumerate().map(point).collect()
}
