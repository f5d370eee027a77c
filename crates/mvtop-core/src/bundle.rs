//! A model bundle: a folder with `model.json`, the networks and the points of the objects.

mod files;
mod graph;
mod manifest;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::Point3;
use serde::Deserialize;

use self::files::read_points;
#[cfg(feature = "onnx")]
pub(crate) use self::graph::OPERATOR_DOMAIN;
use self::manifest::{Header, Manifest, ManifestClass};
use crate::config::InferenceConfig;
use crate::mesh::Mesh;
use crate::rays::LosEncoding;
use crate::scorer::Scorer;
use crate::symmetry::Symmetry;
use crate::{Error, Result, file, json};

/// The name and version in `model.json` that this crate reads.
const FORMAT: &str = "mvtop-model";
const VERSION: u32 = 1;

/// Largest graph, bytes: what ONNX's format can hold.
const MAX_GRAPH_BYTES: u64 = 1 << 31;

/// Turn between neighbours on a spiral that covers a sphere evenly, radians.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// A checked model bundle.
#[derive(Debug, Clone, PartialEq)]
pub struct Bundle {
    /// The folder.
    pub dir: PathBuf,
    /// Name of the training preset.
    pub preset: String,
    /// What the images are brought to.
    pub input: Input,
    /// What the decoder is told of a cell's line of sight.
    pub los_encoding: LosEncoding,
    /// The objects, in the order of the network's class index.
    pub classes: Vec<Class>,
    /// Settings of the detector.
    pub detector: Detector,
    /// How poses are scored; `None` of a bundle that was not calibrated.
    pub scorer: Option<Scorer>,
    /// Numbers that steer inference.
    pub inference: InferenceConfig,
    /// What poses are found in.
    pub closeups: CloseUps,
    /// The graph that runs on whole images, the detector. Absolute or relative to the current folder,
    /// like `dir`.
    pub features: PathBuf,
    /// The graph that decodes poses, likewise; `None` where close-ups give object coordinates, on which
    /// PnP finds the poses.
    pub decoder: Option<PathBuf>,
    /// Whether the graphs use standard operators only.
    pub portable: bool,
    /// What the network answers to one fixed input; bundles of earlier exports have none.
    pub self_test: Option<SelfTest>,
    /// Where the bundle comes from, in free form.
    pub provenance: serde_json::Value,
}

/// What a network answers to one fixed input, see [`crate::Estimator::self_test`].
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SelfTest {
    /// How far an output may be off, as a share of the largest of its group.
    pub tolerance: f64,
    /// Groups of numbers by name.
    pub outputs: BTreeMap<String, Vec<f64>>,
}

/// How poses are found in close-ups, see [`crate::closeup`].
#[derive(Debug, Clone, PartialEq)]
pub struct CloseUps {
    /// Side of the pictures, px.
    pub size: u32,
    /// Cell sizes of the feature levels that are used of them, px, finest first.
    pub strides: Vec<usize>,
    /// The graph that runs on them. Absolute or relative to the current folder.
    pub graph: PathBuf,
}

/// What the images are brought to.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Input {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// Mean of each channel R, G, B, scaled to 0..1.
    pub mean: [f32; 3],
    /// Standard deviation, likewise.
    pub std: [f32; 3],
}

/// One object class.
#[derive(Debug, Clone, PartialEq)]
pub struct Class {
    /// Number in the data set that the network was trained on.
    pub id: i64,
    /// Name, unique in the bundle.
    pub name: String,
    /// Largest distance between two surface points, metres.
    pub diameter_m: f64,
    /// Points on the surface.
    pub points: Vec<SurfacePoint>,
    /// The surface with colors, metres; without it poses cannot be refined.
    pub mesh: Option<Mesh>,
    /// Motions after which it looks the same.
    pub symmetry: Symmetry,
    /// Unit of the object coordinates that the network gives for close-ups, metres; all classes of a
    /// bundle without a decoder have one.
    pub coordinates_extent_m: Option<f64>,
}

/// A colored point on the surface of an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Object frame, metres.
    pub position: [f64; 3],
    /// R, G, B.
    pub color: [u8; 3],
}

/// Settings of the detector.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Detector {
    /// Least score of an object, all views together.
    pub score_threshold: f32,
    /// Least score of a box that another view confirms; `score_threshold` by default.
    #[serde(default)]
    pub agree_threshold: Option<f32>,
    /// IoU above which the weaker of two boxes is dropped.
    pub nms_iou: f32,
}

/// Of `model.json`.
#[cfg(feature = "schema")]
pub(crate) fn schema(generator: schemars::SchemaGenerator) -> schemars::Schema {
    generator.into_root_schema_for::<Manifest>()
}

impl Detector {
    /// Least score of a box that may be an object.
    pub(crate) fn faintest(&self) -> f32 {
        let agree = self.agree_threshold.unwrap_or(self.score_threshold);
        agree.min(self.score_threshold)
    }
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

    /// Middle of the box around the surface points, object frame, metres; the origin without any.
    pub fn middle(&self) -> Point3<f64> {
        let along = |axis: usize| {
            let all = self.points.iter().map(|point| point.position[axis]);
            let ends = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                (low.min(x), high.max(x))
            });
            (ends.0 + ends.1) / 2.0
        };
        match self.points.is_empty() {
            true => Point3::origin(),
            false => Point3::new(along(0), along(1), along(2)),
        }
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
        let unreadable = |e| format!("{e}, expected a model bundle there");
        let text =
            files::read_text(&path, files::MAX_TEXT_BYTES).map_err(|e| refuse(unreadable(e)))?;
        let header: Header = json::from_str(&text)
            .map_err(|e| refuse(format!("is not the description of a model bundle: {e}")))?;
        if header.format != FORMAT || header.version != VERSION {
            return Err(refuse(format!(
                "is `{}` version {}, expected `{FORMAT}` version {VERSION}, get a bundle made for \
                 this release",
                header.format, header.version
            )));
        }
        let manifest: Manifest =
            json::from_str(&text).map_err(|e| refuse(format!("is not valid: {e}")))?;
        manifest.check().map_err(refuse)?;
        let closeups = manifest.closeups(dir).map_err(refuse)?;
        for (name, record) in &manifest.files {
            record.check(dir, name)?;
        }
        for graph in manifest.graphs.files() {
            let path = dir.join(graph);
            let checked = graph::check(&file::read(&path, MAX_GRAPH_BYTES)?);
            checked.map_err(|problem| Error::Bundle { path, problem })?;
        }
        let class = |class: ManifestClass| {
            let points = read_points(&dir.join(&class.points))?;
            class.check_points(&points).map_err(refuse)?;
            Ok(Class {
                symmetry: class.symmetry().map_err(refuse)?,
                mesh: class.read_mesh(dir, &points)?,
                points,
                id: class.id,
                name: class.name,
                diameter_m: class.diameter_m,
                coordinates_extent_m: class.coordinates_extent_m,
            })
        };
        let classes = manifest.classes.into_iter().map(class);
        let classes = classes.collect::<Result<_>>()?;
        Ok(Self {
            dir: dir.to_owned(),
            preset: manifest.preset,
            input: manifest.input,
            los_encoding: manifest.los_encoding,
            classes,
            detector: manifest.detector,
            scorer: manifest.scorer,
            inference: manifest.inference,
            closeups,
            features: dir.join(manifest.graphs.features),
            decoder: manifest.graphs.decoder.map(|name| dir.join(name)),
            portable: manifest.portable,
            self_test: manifest.self_test,
            provenance: manifest.provenance,
        })
    }

    /// Whether the network says which place of the object each cell of a close-up shows.
    pub fn has_coordinates(&self) -> bool {
        self.decoder.is_none()
    }

    /// Index of the class `name`, as the network counts them.
    pub fn class_index(&self, name: &str) -> Option<usize> {
        self.classes.iter().position(|class| class.name == name)
    }
}

#[cfg(test)]
mod tests;
