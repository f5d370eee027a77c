//! Object models: `models_info.json` and the PLY files beside it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Point3, Unit, Vector3};
use serde::Deserialize;

use super::json::{MM, motion, read};
use super::ply::load_ply;
use crate::metrics::{BOP_MAX_STEP, ContinuousSymmetry, Mesh, Surface, Symmetries};
use crate::{Error, Result};

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
    /// Metres.
    pub mesh: Mesh,
    /// The mesh's vertices.
    pub surface: Surface,
}

#[derive(Deserialize)]
struct Info {
    diameter: f64,
    name: Option<String>,
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

/// Reads the models of some objects; those that the folder does not list are not among them.
///
/// - `folder`: with `models_info.json`, or of the data set; there `models_eval/`, else `models/`
/// - `wanted`: which objects
///
/// # Errors
/// [`Error::Read`] where a file is missing, [`Error::Json`], [`Error::Data`] or
/// [`Error::Transform`] where one holds something else.
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
    let infos: BTreeMap<u32, Info> = read(
        &file,
        "{OBJECT: {\"diameter\": mm, ...}} as in BOP's models_info.json",
    )?;
    let model = |(id, info): (u32, Info)| {
        let place = format!("{}: object {id}", file.display());
        Ok((id, info.model(id, &place, folder)?))
    };
    infos
        .into_iter()
        .filter(|(id, _)| wanted(*id))
        .map(model)
        .collect()
}

impl Info {
    fn model(self, id: u32, place: &str, folder: &Path) -> Result<Model> {
        if !(self.diameter.is_finite() && self.diameter > 0.0) {
            return Err(Error::Data(format!(
                "{place}: expected a diameter in millimetres, got {}",
                self.diameter
            )));
        }
        let discrete: Vec<Isometry3<f64>> = self
            .symmetries_discrete
            .iter()
            .enumerate()
            .map(|(i, m)| {
                let r = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
                let place = format!("{place}: symmetries_discrete {i}");
                motion(&place, &r, &[m[3], m[7], m[11]])
            })
            .collect::<Result<_>>()?;
        let continuous: Vec<ContinuousSymmetry> = self
            .symmetries_continuous
            .iter()
            .map(|symmetry| {
                let axis = Unit::try_new(Vector3::from(symmetry.axis), 1e-9).ok_or_else(|| {
                    Error::Data(format!(
                        "{place}: symmetries_continuous: expected an axis, got {:?}",
                        symmetry.axis
                    ))
                })?;
                let offset = Point3::from(symmetry.offset) * MM;
                Ok(ContinuousSymmetry { axis, offset })
            })
            .collect::<Result<_>>()?;
        let mesh = load_ply(&folder.join(format!("obj_{id:06}.ply")), MM)?;
        Ok(Model {
            id,
            name: self.name,
            diameter_m: self.diameter * MM,
            symmetries: Symmetries::new(&discrete, &continuous, BOP_MAX_STEP)?,
            surface: Surface::new(mesh.vertices())?,
            mesh,
        })
    }
}
