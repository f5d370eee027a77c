//! `model.json` and the files that it lists.

use std::collections::{BTreeMap, HashSet};
use std::fs::File;
use std::path::{Component, Path};

use nalgebra::{Point3, Unit, Vector3};
use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::{CloseUps, Detector, Input, PoseInput, SurfacePoint};
use crate::rays::LosEncoding;
use crate::symmetry::{Axis, Symmetry};
use crate::transform::from_matrix;
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
    /// Rows of homogeneous matrices, metres, as the next ones.
    #[serde(default)]
    pub coordinates_extent_m: Option<f64>,
    #[serde(default)]
    pub symmetries_discrete: Vec<[[f64; 4]; 4]>,
    #[serde(default)]
    pub symmetries_continuous: Vec<ManifestAxis>,
}

#[derive(Deserialize)]
pub(super) struct ManifestAxis {
    pub axis: [f64; 3],
    pub offset: [f64; 3],
}

impl ManifestClass {
    /// The text is the problem. Of several axes, as a ball has, the first counts.
    pub fn symmetry(&self) -> Result<Symmetry, String> {
        let problem = |what: String| format!("class `{}`: {what}", self.name);
        let discrete = self.symmetries_discrete.iter().map(|rows| {
            from_matrix(rows).map_err(|error| problem(format!("symmetries_discrete: {error}")))
        });
        let axis = self.symmetries_continuous.first().map(|symmetry| {
            let ManifestAxis { axis, offset } = symmetry;
            let direction = Unit::try_new(Vector3::from(*axis), 1e-9);
            let finite = axis.iter().chain(offset).all(|x| x.is_finite());
            let expected = || {
                problem(format!(
                    "symmetries_continuous: expected an axis, got {axis:?}"
                ))
            };
            Ok::<_, String>(Axis {
                direction: direction.filter(|_| finite).ok_or_else(expected)?,
                point: Point3::from(*offset),
            })
        });
        Ok(Symmetry {
            discrete: discrete.collect::<Result<_, String>>()?,
            axis: axis.transpose()?,
        })
    }
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
        let (width, height) = (self.input.width, self.input.height);
        let (mean, std) = (self.input.mean, self.input.std);
        if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
            return Err(format!(
                "input is {width} x {height} px, expected 1 to {MAX_SIDE} a side"
            ));
        }
        if !mean.iter().all(|m| m.is_finite()) || !std.iter().all(|s| s.is_finite() && *s > 0.0) {
            return Err(format!(
                "input has mean {mean:?} and std {std:?}, expected std above 0"
            ));
        }
        let strides = &self.strides;
        if strides.is_empty() || !strides.is_sorted_by(|a, b| a < b) {
            return Err(format!("strides are {strides:?}, expected them rising"));
        }
        // Coarser levels may have a last cell that sticks out: 480 / 64 makes 8 rows.
        let stride = strides[0];
        if stride == 0 || width % stride != 0 || height % stride != 0 {
            return Err(format!(
                "stride {stride} does not divide the input {width} x {height}"
            ));
        }
        let detector = self.detector;
        let shares = [detector.score_threshold, detector.nms_iou];
        let mut shares = shares.into_iter().chain(detector.agree_threshold);
        if !shares.all(|x| (0.0..=1.0).contains(&x)) {
            return Err(format!(
                "detector has {detector:?}, expected numbers from 0 to 1"
            ));
        }
        if self.classes.is_empty() {
            return Err("classes are empty, expected at least one".into());
        }
        let (mut ids, mut names) = (HashSet::new(), HashSet::new());
        for class in &self.classes {
            let (id, name, diameter) = (class.id, &class.name, class.diameter_m);
            if !ids.insert(id) || !names.insert(name) {
                return Err(format!("class `{name}` with id {id} comes twice"));
            }
            if !(diameter.is_finite() && diameter > 0.0) {
                let problem = format!("has the diameter {diameter} m, expected it above 0");
                return Err(format!("class `{name}` {problem}"));
            }
        }
        for class in &self.classes {
            let (name, extent) = (&class.name, class.coordinates_extent_m);
            if extent.is_some() != self.classes[0].coordinates_extent_m.is_some() {
                return Err("coordinates_extent_m: expected for all classes, or for none".into());
            }
            if let Some(extent) = extent
                && !(extent.is_finite() && extent > 0.0)
            {
                let problem = format!("has coordinates_extent_m {extent}, expected it above 0");
                return Err(format!("class `{name}` {problem}"));
            }
        }
        for name in self.files.keys() {
            let mut parts = Path::new(name).components();
            if name.is_empty() || !parts.all(|part| matches!(part, Component::Normal(_))) {
                return Err(format!("file `{name}` lies outside the bundle"));
            }
        }
        let graphs = [&self.graphs.features, &self.graphs.decoder].into_iter();
        let points = self.classes.iter().map(|class| &class.points);
        let mut used = graphs.chain(&self.graphs.closeup).chain(points);
        if let Some(name) = used.find(|name| !self.files.contains_key(*name)) {
            return Err(format!("file `{name}` is used but not listed in `files`"));
        }
        Ok(())
    }

    /// What poses are decoded from; the text is the problem.
    ///
    /// - `dir`: the bundle's folder
    pub fn poses(&self, dir: &Path) -> Result<PoseInput, String> {
        let cells = |strides: &[u32]| strides.iter().map(|&stride| stride as usize).collect();
        let (size, strides, graph) = match (&self.closeup, &self.graphs.closeup) {
            (None, None) => {
                let strides = cells(&self.strides);
                return Ok(PoseInput::WholeImages { strides });
            }
            (Some(closeup), Some(graph)) => (closeup.size, &closeup.strides, graph),
            _ => return Err("closeup: expected its size and its graph, got one of them".into()),
        };
        let fits = |&stride: &u32| stride > 0 && size.is_multiple_of(stride);
        if !(1..=MAX_SIDE).contains(&size)
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
            size,
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
    let mut hash = Sha256::new();
    let bytes = std::io::copy(&mut File::open(path)?, &mut hash)?;
    Ok((bytes, format!("{:x}", hash.finalize())))
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
