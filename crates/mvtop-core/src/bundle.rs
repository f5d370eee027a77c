//! A model bundle: a folder with `model.json`, the networks and the points of the objects.

use crate::rays::LosEncoding;
use crate::{Error, Result};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, HashSet};
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

/// The name and version in `model.json` that this crate reads.
const FORMAT: &str = "mvtop-model";
const VERSION: u32 = 1;

/// Turn between neighbours on a spiral that covers a sphere evenly, radians.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// Largest side of the network input and largest stride, px: a bundle cannot ask for more memory
/// than a machine has.
const MAX_SIDE: u32 = 16_384;

/// A checked model bundle.
#[derive(Debug, Clone, PartialEq)]
pub struct Bundle {
    /// The folder.
    pub dir: PathBuf,
    /// Name of the training preset.
    pub preset: String,
    pub input: Input,
    /// Cell sizes of the feature levels, px of the network input, finest first.
    pub strides: Vec<usize>,
    pub los_encoding: LosEncoding,
    /// The objects, in the order of the network's class index.
    pub classes: Vec<Class>,
    pub detector: Detector,
    /// `None`: poses are decoded from the whole images.
    pub closeup: Option<CloseUps>,
    /// On whole images. Absolute or relative to the current folder, like `dir`.
    pub features: PathBuf,
    /// Likewise.
    pub decoder: PathBuf,
    /// Whether the graphs use standard operators only.
    pub portable: bool,
    /// Where the bundle comes from, in free form.
    pub provenance: serde_json::Value,
}

/// How poses are decoded from close-ups, see [`crate::closeup`].
#[derive(Debug, Clone, PartialEq)]
pub struct CloseUps {
    /// Side of the pictures, px.
    pub size: u32,
    /// Of the feature levels that are used of them, px, finest first.
    pub strides: Vec<usize>,
    /// The graph that runs on them. Absolute or relative to the current folder.
    pub graph: PathBuf,
}

/// What the images are brought to.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Input {
    /// px
    pub width: u32,
    /// px
    pub height: u32,
    /// Of each channel R, G, B scaled to 0..1.
    pub mean: [f32; 3],
    /// Likewise.
    pub std: [f32; 3],
}

/// One object class.
#[derive(Debug, Clone, PartialEq)]
pub struct Class {
    pub id: i64,
    pub name: String,
    /// Largest distance between two surface points, metres.
    pub diameter_m: f64,
    /// Points on the surface.
    pub points: Vec<SurfacePoint>,
}

/// A coloured point on the surface of an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Object frame, metres.
    pub position: [f64; 3],
    /// R, G, B.
    pub color: [u8; 3],
}

/// Settings of the detector.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Detector {
    /// Least score of an object. Views that agree on one have a higher score together than each.
    pub score_threshold: f32,
    /// Least score of a box in one view; below `score_threshold` it counts only where another view
    /// agrees. Equal to `score_threshold` where the bundle does not say.
    #[serde(default)]
    pub agree_threshold: Option<f32>,
    /// Overlap (intersection over union) above which the weaker of two boxes is dropped.
    pub nms_iou: f32,
}

/// `model.json` as written.
#[derive(Deserialize)]
struct Manifest {
    preset: String,
    input: Input,
    strides: Vec<u32>,
    los_encoding: LosEncoding,
    classes: Vec<ManifestClass>,
    detector: Detector,
    #[serde(default)]
    closeup: Option<ManifestCloseUp>,
    graphs: Graphs,
    portable: bool,
    files: BTreeMap<String, FileRecord>,
    #[serde(default)]
    provenance: serde_json::Value,
}

/// Read before the rest, which may differ in another version.
#[derive(Deserialize)]
struct Header {
    format: String,
    version: u32,
}

#[derive(Deserialize)]
struct ManifestClass {
    id: i64,
    name: String,
    diameter_m: f64,
    points: String,
}

#[derive(Deserialize)]
struct ManifestCloseUp {
    size: u32,
    strides: Vec<u32>,
}

#[derive(Deserialize)]
struct Graphs {
    features: String,
    #[serde(default)]
    closeup: Option<String>,
    decoder: String,
}

#[derive(Deserialize)]
struct FileRecord {
    sha256: String,
    bytes: u64,
}

#[derive(Deserialize)]
struct PointsFile {
    unit: String,
    points: Vec<[f64; 6]>,
}

impl Class {
    /// Least and greatest half width of the object over all directions, metres: no box around it
    /// shows less or more, however it is turned.
    pub fn half_widths(&self) -> [f64; 2] {
        let half_width = |direction: [f64; 3]| {
            let heights = self.points.iter().map(|point| {
                let [x, y, z] = point.position;
                x * direction[0] + y * direction[1] + z * direction[2]
            });
            let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| {
                (low.min(h), high.max(h))
            });
            (high - low) / 2.0
        };
        // A spiral over half the sphere, within 3 degrees of any direction.
        let spiral = (0..2000).map(|i| {
            let z = (f64::from(i) + 0.5) / 2000.0;
            let (sin, cos) = (f64::from(i) * GOLDEN_ANGLE).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            [radius * cos, radius * sin, z]
        });
        let least = spiral.map(half_width).fold(f64::INFINITY, f64::min);
        [least.max(0.0), self.diameter_m / 2.0]
    }
}

impl Bundle {
    /// Loads the bundle in the folder `dir` and checks every file of it.
    ///
    /// # Errors
    /// [`Error::Bundle`] when the folder is no bundle, is of another version, says something
    /// impossible, or a file is missing or differs from its checksum.
    pub fn load(dir: &Path) -> Result<Self> {
        let path = dir.join("model.json");
        let refuse = |problem: String| Error::Bundle {
            path: path.clone(),
            problem,
        };
        let text = std::fs::read_to_string(&path).map_err(|e| {
            refuse(format!(
                "cannot be read ({e}), expected a model bundle there"
            ))
        })?;
        let header: Header = serde_json::from_str(&text)
            .map_err(|e| refuse(format!("is not the description of a model bundle: {e}")))?;
        if header.format != FORMAT || header.version != VERSION {
            return Err(refuse(format!(
                "is `{}` version {}, expected `{FORMAT}` version {VERSION}, get a bundle made for \
                 this release",
                header.format, header.version
            )));
        }
        let manifest: Manifest =
            serde_json::from_str(&text).map_err(|e| refuse(format!("is not valid: {e}")))?;
        manifest.check().map_err(refuse)?;
        for (name, record) in &manifest.files {
            record.check(&dir.join(name))?;
        }
        let classes = manifest
            .classes
            .into_iter()
            .map(|class| {
                let points = read_points(&dir.join(&class.points))?;
                let ManifestClass {
                    id,
                    name,
                    diameter_m,
                    ..
                } = class;
                Ok(Class {
                    id,
                    name,
                    diameter_m,
                    points,
                })
            })
            .collect::<Result<_>>()?;
        Ok(Self {
            dir: dir.to_owned(),
            preset: manifest.preset,
            input: manifest.input,
            strides: manifest.strides.iter().map(|&s| s as usize).collect(),
            los_encoding: manifest.los_encoding,
            classes,
            detector: manifest.detector,
            closeup: manifest
                .closeup
                .zip(manifest.graphs.closeup)
                .map(|(closeup, graph)| CloseUps {
                    size: closeup.size,
                    strides: closeup.strides.iter().map(|&s| s as usize).collect(),
                    graph: dir.join(graph),
                }),
            features: dir.join(manifest.graphs.features),
            decoder: dir.join(manifest.graphs.decoder),
            portable: manifest.portable,
            provenance: manifest.provenance,
        })
    }

    /// Index of the class `name`, as the network counts them.
    pub fn class_index(&self, name: &str) -> Option<usize> {
        self.classes.iter().position(|class| class.name == name)
    }
}

impl Manifest {
    /// What serde cannot check; the text is the problem.
    fn check(&self) -> Result<(), String> {
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
        match (&self.closeup, &self.graphs.closeup) {
            (None, None) => {}
            (Some(ManifestCloseUp { size, strides }), Some(_)) => {
                let fits = |&stride: &u32| stride > 0 && size.is_multiple_of(stride);
                if !(1..=MAX_SIDE).contains(size)
                    || strides.is_empty()
                    || !strides.is_sorted_by(|a, b| a < b)
                    || !strides.iter().all(fits)
                {
                    return Err(format!(
                        "closeup is {size} px a side with strides {strides:?}, expected 1 to \
                         {MAX_SIDE} px and rising strides that divide it"
                    ));
                }
            }
            _ => return Err("closeup: expected its size and its graph, got one of them".into()),
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

impl FileRecord {
    fn check(&self, path: &Path) -> Result<()> {
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
fn digest(path: &Path) -> std::io::Result<(u64, String)> {
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

fn read_points(path: &Path) -> Result<Vec<SurfacePoint>> {
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
            // Rounded, since the file may hold averaged colours.
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

#[cfg(test)]
mod tests;
