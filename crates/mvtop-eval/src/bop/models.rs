//! Object models: `models_info.json` and the PLY or OBJ files beside it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use mvtop_core::mesh::{Mesh, load_ply};
use mvtop_core::symmetry::{self, Symmetry};
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use serde::Deserialize;

use super::json::{MM, motion, read_numbered};
use super::obj::load_obj;
use crate::metrics::{BOP_MAX_STEP, ContinuousSymmetry, Surface, Symmetries};
use crate::{Error, Result};

/// Objects of a data set none of which is as large as this, a millimetre, are given in metres.
const LEAST_LARGEST_MM: f64 = 1.0;

/// An object, ready for measuring poses of it.
#[derive(Debug)]
pub struct Model {
    /// Number of the object.
    pub id: u32,
    /// mvtop's own data sets have names, BOP's do not.
    pub name: Option<String>,
    /// Largest distance of two points, metres.
    pub diameter_m: f64,
    /// Motions that do not change how it looks, metres.
    pub symmetries: Symmetries,
    /// The same without steps; of several axes the first one.
    pub symmetry: Symmetry,
    /// Its file.
    pub path: PathBuf,
    /// Metres.
    pub mesh: Mesh,
    /// The mesh's vertices.
    pub surface: Surface,
}

/// What `models_info.json` says of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelInfo {
    /// mvtop's own data sets have names, BOP's do not.
    pub name: Option<String>,
    /// Largest distance of two points, metres.
    pub diameter_m: f64,
    /// Least and greatest coordinates, metres; `None` where the file does not have them all.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Motions that do not change how it looks, metres.
    pub discrete: Vec<Isometry3<f64>>,
    /// Axes about which no turn changes how it looks, metres.
    pub continuous: Vec<ContinuousSymmetry>,
}

#[derive(Deserialize)]
struct Info {
    diameter: f64,
    name: Option<String>,
    min_x: Option<f64>,
    min_y: Option<f64>,
    min_z: Option<f64>,
    size_x: Option<f64>,
    size_y: Option<f64>,
    size_z: Option<f64>,
    #[serde(default)]
    symmetries_discrete: Vec<[f64; 16]>,
    #[serde(default)]
    symmetries_continuous: Vec<Axis>,
}

#[derive(Deserialize)]
struct Axis {
    axis: [f64; 3],
    offset: [f64; 3],
}

/// Reads `models_info.json`, by object.
///
/// # Errors
/// [`Error::Geometry`] where it cannot be read, [`Error::Geometry`] or [`Error::Data`] where it holds
/// something else.
pub fn load_infos(path: &Path) -> Result<BTreeMap<u32, ModelInfo>> {
    let infos: BTreeMap<u32, Info> = read_numbered(
        path,
        "{OBJECT: {\"diameter\": mm, ...}} as in BOP's models_info.json",
    )?;
    let checked = |(id, info): (u32, Info)| {
        let place = format!("{}: object {id}", path.display());
        Ok((id, info.checked(&place)?))
    };
    infos.into_iter().map(checked).collect()
}

/// Reads the models of some objects; those that the folder does not list are not among them.
///
/// - `folder`: with `models_info.json`, or of the data set; there `models_eval/`, else `models/`
/// - `wanted`: which objects
///
/// # Errors
/// [`Error::Geometry`] where a file is missing, [`Error::Geometry`] or [`Error::Data`] where one holds
/// something else.
pub fn load_models(folder: &Path, wanted: impl Fn(u32) -> bool) -> Result<BTreeMap<u32, Model>> {
    let folders = ["", "models_eval", "models"].map(|name| folder.join(name));
    let listed = |dir: &&PathBuf| dir.join("models_info.json").is_file();
    let Some(folder) = folders.iter().find(listed) else {
        return Err(Error::Data(format!(
            "{}: expected models_info.json there, or in models_eval/ or models/, got none; give the \
             folder of the models, or that of the data set, in which it lies beside the splits",
            folder.display()
        )));
    };
    let file = folder.join("models_info.json");
    let infos = load_infos(&file)?;
    let model = |(id, info): (u32, ModelInfo)| Ok((id, info.model(id, folder)?));
    let models = infos.into_iter().filter(|(id, _)| wanted(*id)).map(model);
    let models: BTreeMap<u32, Model> = models.collect::<Result<_>>()?;
    let largest = models.values().map(|model| model.diameter_m / MM);
    let largest = largest.fold(0.0, f64::max);
    if !models.is_empty() && largest < LEAST_LARGEST_MM {
        return Err(Error::Data(format!(
            "{}: expected diameters in millimetres, got {largest:.3} at most, which look like metres, as do the \
             models' coordinates; multiply both by 1000",
            file.display()
        )));
    }
    Ok(models)
}

impl Info {
    fn checked(self, place: &str) -> Result<ModelInfo> {
        if !(self.diameter.is_finite() && self.diameter > 0.0) {
            return Err(Error::Data(format!(
                "{place}: expected a diameter in millimetres, got {}",
                self.diameter
            )));
        }
        let discrete = self.symmetries_discrete.iter().enumerate();
        let discrete = discrete.map(|(i, m)| {
            let r = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
            let place = format!("{place}: symmetries_discrete {i}");
            motion(&place, &r, &[m[3], m[7], m[11]])
        });
        let continuous = self.symmetries_continuous.iter().map(|symmetry| {
            let axis = Unit::try_new(Vector3::from(symmetry.axis), 1e-9).ok_or_else(|| {
                Error::Data(format!(
                    "{place}: symmetries_continuous: expected an axis, got {:?}",
                    symmetry.axis
                ))
            })?;
            let offset = Point3::from(symmetry.offset) * MM;
            Ok(ContinuousSymmetry { axis, offset })
        });
        let ranges = [
            self.min_x.zip(self.size_x),
            self.min_y.zip(self.size_y),
            self.min_z.zip(self.size_z),
        ];
        let bounds = if let [Some(x), Some(y), Some(z)] = ranges {
            let axes = [x, y, z];
            Some([
                axes.map(|(min, _)| min * MM),
                axes.map(|(min, size)| (min + size) * MM),
            ])
        } else {
            None
        };
        Ok(ModelInfo {
            discrete: discrete.collect::<Result<_>>()?,
            continuous: continuous.collect::<Result<_>>()?,
            name: self.name,
            diameter_m: self.diameter * MM,
            bounds,
        })
    }
}

impl ModelInfo {
    fn model(self, id: u32, folder: &Path) -> Result<Model> {
        let [ply, obj] = ["ply", "obj"].map(|end| folder.join(format!("obj_{id:06}.{end}")));
        // Where there is neither, the one that BOP has is missing.
        let (path, mesh) = match !ply.is_file() && obj.is_file() {
            true => (obj.clone(), load_obj(&obj, MM)?),
            false => (ply.clone(), load_ply(&ply, MM)?),
        };
        check_diameter(&path, mesh.vertices(), self.diameter_m)?;
        let axis = self.continuous.first().map(|continuous| symmetry::Axis {
            direction: continuous.axis,
            point: continuous.offset,
        });
        Ok(Model {
            id,
            name: self.name,
            diameter_m: self.diameter_m,
            symmetries: Symmetries::new(&self.discrete, &self.continuous, BOP_MAX_STEP)?,
            symmetry: Symmetry {
                discrete: self.discrete,
                axis,
            },
            surface: Surface::new(mesh.vertices())?,
            path,
            mesh,
        })
    }
}

/// Refuses a diameter that is not the points', as of another unit or object; it is a rule of thumb, as
/// what some data sets say is some percent off.
fn check_diameter(path: &Path, points: &[Point3<f64>], diameter: f64) -> Result<()> {
    let corner = |pick: fn(f64, f64) -> f64| {
        let points = points.iter().copied();
        points.reduce(|a, b| Point3::from(a.coords.zip_map(&b.coords, pick)))
    };
    let (Some(low), Some(high)) = (corner(f64::min), corner(f64::max)) else {
        return Ok(());
    };
    // The points' own diameter is between the box's longest side and its diagonal.
    let (side, diagonal) = ((high - low).amax(), (high - low).norm());
    if diameter >= side / 2.0 && diameter <= 2.0 * diagonal {
        return Ok(());
    }
    Err(Error::Data(format!(
        "{}: expected points {:.1} mm apart at most, the diameter in models_info.json, got a box of \
         {:.1} mm; both must be in millimetres and of the same object",
        path.display(),
        diameter / MM,
        diagonal / MM
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_wholly_in_metres_are_refused() {
        let load = |size: f64| {
            let folder = tempfile::tempdir().unwrap();
            let ply = format!(
                "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                 property float z\nelement face 1\nproperty list uchar int vertex_indices\n\
                 end_header\n0 0 0\n{size} 0 0\n0 {size} 0\n3 0 1 2\n"
            );
            let diameter = size * 2f64.sqrt();
            let info = format!(r#"{{"000001": {{"diameter": {diameter}}}}}"#);
            std::fs::write(folder.path().join("obj_000001.ply"), ply).unwrap();
            std::fs::write(folder.path().join("models_info.json"), info).unwrap();
            load_models(folder.path(), |_| true)
        };
        assert_eq!(load(100.0).unwrap().len(), 1);
        let error = load(0.1).unwrap_err().to_string();
        assert!(
            error.contains("got 0.141 at most, which look like metres"),
            "{error}"
        );
    }
}
