//! `model.json` and the files that it lists.

use std::collections::{BTreeMap, HashSet};
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path};

use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::{CloseUps, Detector, Input, PoseInput, SurfacePoint};
use crate::rays::LosEncoding;
use crate::{Error, Result};

/// Largest side of the network input and largest stride, px: a bundle cannot ask for more memory
/// than a machine has.
const MAX_SIDE: u32 = 16_384;

/// `model.json` as written.
#[derive(Deserialize)]
pub(super) struct Manifest {
    pub preset: String,
    pub input: Input,
    pub strides: Vec<u32>,
    pub los_encoding: LosEncoding,
    pub classes: Vec<ManifestClass>,
    pub detector: Detector,
    #[serde(default)]
    pub closeup: Option<ManifestCloseUp>,
    pub graphs: Graphs,
    pub portable: bool,
    pub files: BTreeMap<String, FileRecord>,
    #[serde(default)]
    pub provenance: serde_json::Value,
}

/// Read before the rest, which may differ in another version.
#[derive(Deserialize)]
pub(super) struct Header {
    pub format: String,
    pub version: u32,
}

#[derive(Deserialize)]
pub(super) struct ManifestClass {
    pub id: i64,
    pub name: String,
    pub diameter_m: f64,
    pub points: String,
}

#[derive(Deserialize)]
pub(super) struct ManifestCloseUp {
    pub size: u32,
    pub strides: Vec<u32>,
}

#[derive(Deserialize)]
pub(super) struct Graphs {
    pub features: String,
    #[serde(default)]
    pub closeup: Option<String>,
    pub decoder: String,
}

#[derive(Deserialize)]
pub(super) struct FileRecord {
    pub sha256: String,
    pub bytes: u64,
}

#[derive(Deserialize)]
pub(super) struct PointsFile {
    pub unit: String,
    pub points: Vec<[f64; 6]>,
}

impl Manifest {
    /// What serde cannot check; the text is the problem.
    pub fn check(&self) -> Result<(), String> {
        let Input {
            width,
            height,
            mean,
            std,
        } = &self.input;
        if !(1..=MAX_SIDE).contains(width) || !(1..=MAX_SIDE).contains(height) {
            return Err(format!(
                "input is {width} x {height} px, expected 1 to {MAX_SIDE} a side"
            ));
        }
        if !mean.iter().all(|m| m.is_finite()) || !std.iter().all(|s| s.is_finite() && *s > 0.0) {
            return Err(format!(
                "input has mean {mean:?} and std {std:?}, expected std above 0"
            ));
        }
        if self.strides.is_empty() || !self.strides.is_sorted_by(|a, b| a < b) {
            return Err(format!(
                "strides are {:?}, expected them rising",
                self.strides
            ));
        }
        // Coarser levels may have a last cell that sticks out: 480 / 64 makes 8 rows.
        let stride = self.strides[0];
        if stride == 0 || width % stride != 0 || height % stride != 0 {
            return Err(format!(
                "stride {stride} does not divide the input {width} x {height}"
            ));
        }
        let Detector {
            score_threshold,
            agree_threshold,
            nms_iou,
        } = self.detector;
        let agree_threshold = agree_threshold.unwrap_or(score_threshold);
        if ![score_threshold, agree_threshold, nms_iou]
            .iter()
            .all(|x| (0.0..=1.0).contains(x))
        {
            return Err(format!(
                "detector has {:?}, expected numbers from 0 to 1",
                self.detector
            ));
        }
        if self.classes.is_empty() {
            return Err("classes are empty, expected at least one".into());
        }
        let (mut ids, mut names) = (HashSet::new(), HashSet::new());
        for class in &self.classes {
            if !ids.insert(class.id) || !names.insert(&class.name) {
                return Err(format!(
                    "class `{}` with id {} comes twice",
                    class.name, class.id
                ));
            }
            if !(class.diameter_m.is_finite() && class.diameter_m > 0.0) {
                return Err(format!(
                    "class `{}` has the diameter {} m, expected it above 0",
                    class.name, class.diameter_m
                ));
            }
        }
        for name in self.files.keys() {
            let mut parts = Path::new(name).components();
            if name.is_empty() || !parts.all(|part| matches!(part, Component::Normal(_))) {
                return Err(format!("file `{name}` lies outside the bundle"));
            }
        }
        let Graphs {
            features,
            closeup,
            decoder,
        } = &self.graphs;
        let points = self.classes.iter().map(|class| &class.points);
        if let Some(name) = [features, decoder]
            .into_iter()
            .chain(closeup)
            .chain(points)
            .find(|n| !self.files.contains_key(*n))
        {
            return Err(format!("file `{name}` is used but not listed in `files`"));
        }
        Ok(())
    }
}

impl Manifest {
    /// What poses are decoded from; the text is the problem.
    ///
    /// - `dir`: the bundle's folder
    pub fn poses(&self, dir: &Path) -> Result<PoseInput, String> {
        let cells = |strides: &[u32]| strides.iter().map(|&stride| stride as usize).collect();
        let (ManifestCloseUp { size, strides }, graph) = match (&self.closeup, &self.graphs.closeup)
        {
            (None, None) => {
                let strides = cells(&self.strides);
                return Ok(PoseInput::WholeImages { strides });
            }
            (Some(closeup), Some(graph)) => (closeup, graph),
            _ => return Err("closeup: expected its size and its graph, got one of them".into()),
        };
        let fits = |&stride: &u32| stride > 0 && size.is_multiple_of(stride);
        if !(1..=MAX_SIDE).contains(size)
            || strides.is_empty()
            || !strides.is_sorted_by(|a, b| a < b)
            || !strides.iter().all(fits)
        {
            return Err(format!(
                "closeup is {size} px a side with strides {strides:?}, expected 1 to {MAX_SIDE} px \
                 and rising strides that divide it"
            ));
        }
        Ok(PoseInput::CloseUps(CloseUps {
            size: *size,
            strides: cells(strides),
            graph: dir.join(graph),
        }))
    }
}

impl FileRecord {
    pub fn check(&self, path: &Path) -> Result<()> {
        let refuse = |problem: String| Error::Bundle {
            path: path.to_owned(),
            problem,
        };
        let (bytes, sha256) = digest(path).map_err(|e| refuse(format!("cannot be read: {e}")))?;
        if bytes != self.bytes {
            return Err(refuse(format!(
                "has {bytes} bytes, expected {}; the bundle is incomplete or changed, get it again",
                self.bytes
            )));
        }
        if !sha256.eq_ignore_ascii_case(&self.sha256) {
            return Err(refuse(format!(
                "has sha256 {sha256}, expected {}; the bundle was changed, get it again",
                self.sha256
            )));
        }
        Ok(())
    }
}

/// Length and SHA-256 of a file, in hexadecimal.
pub(super) fn digest(path: &Path) -> std::io::Result<(u64, String)> {
    let mut file = File::open(path)?;
    let (mut hash, mut bytes) = (Sha256::new(), 0);
    let mut buffer = vec![0; 1 << 16];
    loop {
        let read = file.read(&mut buffer)?;
        if read == 0 {
            break;
        }
        hash.update(&buffer[..read]);
        bytes += read as u64;
    }
    let hex = hash
        .finalize()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    Ok((bytes, hex))
}

pub(super) fn read_points(path: &Path) -> Result<Vec<SurfacePoint>> {
    let refuse = |problem: String| Error::Bundle {
        path: path.to_owned(),
        problem,
    };
    let text = std::fs::read_to_string(path).map_err(|e| refuse(format!("cannot be read: {e}")))?;
    let file: PointsFile =
        serde_json::from_str(&text).map_err(|e| refuse(format!("is not a points file: {e}")))?;
    if file.unit != "m" {
        return Err(refuse(format!(
            "is in `{}`, expected metres (`m`)",
            file.unit
        )));
    }
    if file.points.is_empty() {
        return Err(refuse("holds no points".into()));
    }
    file.points
        .iter()
        .enumerate()
        .map(|(i, &[x, y, z, r, g, b])| {
            let color = [r, g, b];
            let valid = [x, y, z].iter().all(|v| v.is_finite())
                && color.iter().all(|c| (0.0..=255.0).contains(c));
            // Rounded, since the file may hold averaged colors.
            let point = SurfacePoint {
                position: [x, y, z],
                color: color.map(|c| c.round() as u8),
            };
            valid.then_some(point).ok_or_else(|| {
                refuse(format!(
                    "point {i}: expected finite x, y, z and r, g, b from 0 to 255"
                ))
            })
        })
        .collect()
}
