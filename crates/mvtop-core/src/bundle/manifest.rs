//! `model.json`.

use std::collections::{BTreeMap, HashSet};
use std::path::{Component, Path};

use nalgebra::{Point3, Unit, Vector3};
use serde::Deserialize;

use super::files::FileRecord;
use super::{CloseUps, Detector, Input, SelfTest, SurfacePoint};
use crate::config::{InferenceConfig, PIPELINE_VERSION};
use crate::error::misleads;
use crate::mesh::{Mesh, load_ply_within};
use crate::rays::LosEncoding;
use crate::scorer::Scorer;
use crate::symmetry::{Axis, Symmetry};
use crate::transform::from_matrix;
use crate::{Error, Result};

/// Largest side of the network input and largest stride, px: a bundle cannot ask for more memory
/// than a machine has.
const MAX_SIDE: u32 = 16_384;

/// Most pixels of the network's input or of a close-up: 16 times those of any network so far, and low
/// enough that a picture of them fits into memory.
const MAX_PIXELS: u32 = 1 << 24;
/// Most triangles of a mesh: ten times those that a bundle is written with, and few enough to be
/// drawn some times in each view.
const MAX_TRIANGLES: usize = 20_000;
/// Largest mesh, bytes.
const MAX_MESH_BYTES: u64 = 1 << 23;
/// Each reads its files.
const MAX_CLASSES: usize = 256;
/// Of an object.
const MAX_SYMMETRIES: usize = 1000;

/// `model.json` as written, with `format` and `version` of [`Header`].
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct Manifest {
    /// Kind of network.
    pub preset: String,
    /// Size and normalisation of the images.
    pub input: Input,
    /// Cell sizes of the feature levels, px.
    pub strides: Vec<u32>,
    /// Encoding of the lines of sight.
    pub los_encoding: LosEncoding,
    /// Object classes.
    pub classes: Vec<ManifestClass>,
    /// Thresholds of the detector.
    pub detector: Detector,
    /// Of bundles that were calibrated for an earlier pipeline.
    #[cfg_attr(feature = "schema", schemars(skip))]
    #[serde(default)]
    confidence: Option<serde::de::IgnoredAny>,
    /// Weights of the [confidence](../explanation/confidence.md); null before calibration.
    #[serde(default)]
    pub scorer: Option<Scorer>,
    /// Version that the calibration holds for; others are refused.
    #[serde(default)]
    pipeline_version: Option<u32>,
    /// Replaced [settings](inference.md).
    #[serde(default)]
    pub inference: InferenceConfig,
    /// Crops, which poses are found in.
    pub closeup: ManifestCloseUp,
    /// Files of the network.
    pub graphs: Graphs,
    /// Whether the graphs have standard operators only.
    pub portable: bool,
    /// SHA-256 and size of every file.
    pub files: BTreeMap<String, FileRecord>,
    /// The network's answers to a fixed input; `mvtop-cli doctor` compares.
    #[serde(default)]
    pub self_test: Option<SelfTest>,
    /// Training steps, commit, date.
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct ManifestClass {
    /// Number in the data set.
    pub id: i64,
    /// Unique name.
    pub name: String,
    /// Largest distance of two surface points, metres.
    pub diameter_m: f64,
    /// File of surface points.
    pub points: String,
    /// File with a mesh of at most 2,000 triangles, for refinement.
    #[serde(default)]
    pub mesh: Option<String>,
    /// Unit of the object coordinates, metres, if the network predicts them.
    #[serde(default)]
    pub coordinates_extent_m: Option<f64>,
    /// Rows of homogeneous matrices, metres.
    #[serde(default)]
    pub symmetries_discrete: Vec<[[f64; 4]; 4]>,
    /// Axes about which any turn looks the same.
    #[serde(default)]
    pub symmetries_continuous: Vec<ManifestAxis>,
}

#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct ManifestAxis {
    /// Direction, of any length.
    pub axis: [f64; 3],
    /// A point on it, metres.
    pub offset: [f64; 3],
}

impl ManifestClass {
    /// Refuses points that are farther apart than the diameter, or all within a quarter of it; the
    /// text is the problem.
    pub fn check_points(&self, points: &[SurfacePoint]) -> Result<(), String> {
        let size = [0, 1, 2].map(|axis| {
            let along = points.iter().map(|point| point.position[axis]);
            let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                (low.min(x), high.max(x))
            });
            high - low
        });
        let (side, diagonal) = (Vector3::from(size).amax(), Vector3::from(size).norm());
        // A few points show nothing of the size.
        let least = if points.len() > 3 {
            self.diameter_m / 4.0
        } else {
            0.0
        };
        if side <= 1.05 * self.diameter_m && diagonal >= least {
            return Ok(());
        }
        Err(format!(
            "class `{}` has the diameter {} m, but points in a box of {size:?} m, expected both of \
             one object, in metres",
            self.name, self.diameter_m
        ))
    }

    /// The mesh in a bundle's folder, if it has one.
    ///
    /// - `dir`: the bundle's folder
    /// - `points`: of the same class
    pub fn read_mesh(&self, dir: &Path, points: &[SurfacePoint]) -> Result<Option<Mesh>> {
        let Some(name) = &self.mesh else {
            return Ok(None);
        };
        let path = dir.join(name);
        let refuse = |problem: String| Error::Bundle {
            path: path.clone(),
            problem,
        };
        let mesh = load_ply_within(&path, 1.0, MAX_MESH_BYTES)
            .map_err(|error| refuse(format!("is no mesh: {error}")))?;
        let (count, colored) = (mesh.triangles().len(), !mesh.colors().is_empty());
        if !(1..=MAX_TRIANGLES).contains(&count) || !colored {
            return Err(refuse(format!(
                "has {count} triangles {} colors, expected 1 to {MAX_TRIANGLES} with the color of \
                 each vertex; write it with `mvtop-train mesh`",
                if colored { "with" } else { "without" }
            )));
        }
        let reach = |distances: &mut dyn Iterator<Item = f64>| distances.fold(0.0, f64::max);
        let surface = reach(&mut mesh.vertices().iter().map(|v| v.coords.norm()));
        let known = reach(&mut points.iter().map(|p| Vector3::from(p.position).norm()));
        // A few points show nothing of the size.
        if points.len() > 3 && (surface - known).abs() > 0.1 * self.diameter_m {
            return Err(refuse(format!(
                "reaches {surface} m from the object's origin, but the points of class `{}` reach \
                 {known} m, expected both of one object, in metres",
                self.name
            )));
        }
        Ok(Some(mesh))
    }

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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct ManifestCloseUp {
    /// Side of the crops, px.
    pub size: u32,
    /// Cell sizes of their feature levels, px.
    pub strides: Vec<u32>,
}

#[derive(Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct Graphs {
    /// Backbone and detector on whole images.
    pub features: String,
    /// Crops to features for the decoder, or to object coordinates.
    pub closeup: String,
    /// Features of all views to poses; missing in bundles with object coordinates.
    #[serde(default)]
    pub decoder: Option<String>,
}

impl Graphs {
    pub fn files(&self) -> impl Iterator<Item = &String> {
        [&self.features, &self.closeup]
            .into_iter()
            .chain(&self.decoder)
    }
}

impl Manifest {
    /// Refuses a calibration for another version of the pipeline; the text is the problem.
    fn check_pipeline(&self) -> Result<(), String> {
        let fitted = match (&self.scorer, self.pipeline_version, &self.confidence) {
            (Some(_), version, _) => version.unwrap_or(1),
            (None, _, Some(_)) => 1,
            (None, _, None) => return Ok(()),
        };
        if fitted == PIPELINE_VERSION {
            return Ok(());
        }
        Err(format!(
            "was calibrated for version {fitted} of the pipeline, expected {PIPELINE_VERSION}; calibrate \
             it anew with `mvtop-train calibrate --bundle DIR --data DATA`"
        ))
    }

    /// What serde cannot check; the text is the problem.
    pub fn check(&self) -> Result<(), String> {
        let (width, height) = (self.input.width, self.input.height);
        let (mean, std) = (self.input.mean, self.input.std);
        if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
            return Err(format!(
                "input is {width} x {height} px, expected 1 to {MAX_SIDE} a side"
            ));
        }
        if width * height > MAX_PIXELS {
            return Err(format!(
                "input is {width} x {height} px, expected {MAX_PIXELS} px at most"
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
        self.check_pipeline()?;
        self.inference.check()?;
        self.scorer.as_ref().map_or(Ok(()), Scorer::check)?;
        if !(1..=MAX_CLASSES).contains(&self.classes.len()) {
            let got = self.classes.len();
            return Err(format!("classes are {got}, expected 1 to {MAX_CLASSES}"));
        }
        let most = self
            .classes
            .iter()
            .map(|class| class.symmetries_discrete.len())
            .max();
        if let Some(most) = most.filter(|most| *most > MAX_SYMMETRIES) {
            return Err(format!(
                "symmetries_discrete are {most}, expected {MAX_SYMMETRIES} at most"
            ));
        }
        let written = self.classes.iter().map(|class| &class.name);
        if let Some(text) = written
            .chain([&self.preset])
            .find(|text| text.contains(misleads))
        {
            return Err(format!(
                "{text:?} is a name with control characters, expected none; write it without them"
            ));
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
        let coordinates = self.classes[0].coordinates_extent_m.is_some();
        if coordinates == self.graphs.decoder.is_some() {
            return Err(format!(
                "has graphs {:?} {} coordinates_extent_m, expected either a `decoder` or \
                 coordinates_extent_m; export the bundle again with `mvtop-train export`",
                self.graphs,
                if coordinates { "and" } else { "without" },
            ));
        }
        if let Some(SelfTest { tolerance, .. }) = self.self_test
            && !(0.0..=1.0).contains(&tolerance)
        {
            return Err(format!(
                "self_test has the tolerance {tolerance}, expected a share from 0 to 1"
            ));
        }
        for name in self.files.keys() {
            let mut parts = Path::new(name).components();
            if name.is_empty() || !parts.all(|part| matches!(part, Component::Normal(_))) {
                return Err(format!("file `{name}` lies outside the bundle"));
            }
        }
        let of_classes = self.classes.iter();
        let of_classes =
            of_classes.flat_map(|class| [&class.points].into_iter().chain(&class.mesh));
        let mut used = self.graphs.files().chain(of_classes);
        if let Some(name) = used.find(|name| !self.files.contains_key(*name)) {
            return Err(format!("file `{name}` is used but not listed in `files`"));
        }
        Ok(())
    }

    /// What poses are found in; the text is the problem.
    ///
    /// - `dir`: the bundle's folder
    pub fn closeups(&self, dir: &Path) -> Result<CloseUps, String> {
        let (size, strides) = (self.closeup.size, &self.closeup.strides);
        let fits = |&stride: &u32| stride > 0 && size.is_multiple_of(stride);
        if !(1..=MAX_SIDE).contains(&size)
            || size * size > MAX_PIXELS
            || strides.is_empty()
            || !strides.is_sorted_by(|a, b| a < b)
            || !strides.iter().all(fits)
        {
            return Err(format!(
                "closeup is {size} px a side with strides {strides:?}, expected 1 to {MAX_SIDE} px \
                 and rising strides that divide it"
            ));
        }
        Ok(CloseUps {
            size,
            strides: strides.iter().map(|&stride| stride as usize).collect(),
            graph: dir.join(&self.graphs.closeup),
        })
    }
}
