//! How parts are grasped: poses of a tool at an object, from a file in the bundle.

use std::path::Path;

use nalgebra::{Isometry3, Point3, Vector3};
use serde::Deserialize;

use crate::bundle::{Bundle, Class};
use crate::error::misleads;
use crate::prediction::ObjectPose;
use crate::report::{ReportedGrasp, rows};
use crate::transform::from_matrix;
use crate::{Error, Result, cancel, json};

/// Name of the file in a bundle's folder.
pub const FILE: &str = "grasps.json";

const FORMAT: &str = "mvtop-grasps";
const VERSION: u32 = 1;
/// Most grasps, and most spheres of a gripper: each is compared with the points of all objects.
const MOST: usize = 1000;
/// Largest opening and radius: larger ones are of another unit.
const LONGEST_M: f64 = 10.0;

/// The grasps of a bundle's classes.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasps {
    /// What the gripper fills, in the tool's frame; empty where it is not known.
    pub gripper: Vec<Sphere>,
    /// In the order of the file.
    pub grasps: Vec<Grasp>,
}

/// A part of a gripper's shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Tool frame, metres.
    pub center: Point3<f64>,
    /// Metres.
    pub radius_m: f64,
}

/// One way to grasp a part.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasp {
    /// Name of the class.
    pub class: String,
    /// To tell it from others.
    pub name: String,
    /// Tool frame to object frame, metres.
    pub obj_from_tool: Isometry3<f64>,
    /// Opening of the gripper, metres.
    pub opening_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    format: String,
    version: u32,
    unit: String,
    #[serde(default)]
    gripper: Vec<WrittenSphere>,
    grasps: Vec<WrittenGrasp>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenSphere {
    center: [f64; 3],
    radius: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenGrasp {
    class: String,
    name: String,
    #[serde(rename = "T_obj_tool")]
    t_obj_tool: [[f64; 4]; 4],
    opening: f64,
}

impl Grasps {
    /// The grasps of a bundle, `None` where its folder has no such file.
    ///
    /// # Errors
    /// [`Error::Geometry`] where the file cannot be read, and [`Error::Data`] where it
    /// says something impossible or names a class that the bundle does not know.
    pub fn of_bundle(bundle: &Bundle) -> Result<Option<Self>> {
        let path = bundle.dir.join(FILE);
        match path.symlink_metadata() {
            Ok(_) => Self::load(&path, bundle).map(Some),
            Err(_) => Ok(None),
        }
    }

    fn load(path: &Path, bundle: &Bundle) -> Result<Self> {
        let expected =
            r#"{"format": "mvtop-grasps", "version": 1, "unit": "m" or "mm", "grasps": [...]}"#;
        let document: Document = json::read(path, expected)?;
        let refuse = |problem: String| Error::Data(format!("{}: {problem}", path.display()));
        if document.format != FORMAT || document.version != VERSION {
            return Err(refuse(format!(
                "expected `{FORMAT}` version {VERSION}, got `{}` version {}",
                document.format, document.version
            )));
        }
        let unit = match document.unit.as_str() {
            "m" => 1.0,
            "mm" => 1e-3,
            other => {
                return Err(refuse(format!("unit: expected `m` or `mm`, got `{other}`")));
            }
        };
        if document.grasps.len() > MOST || document.gripper.len() > MOST {
            return Err(refuse(format!(
                "expected {MOST} grasps and spheres at most, got {} and {}",
                document.grasps.len(),
                document.gripper.len()
            )));
        }
        let sphere = |(i, sphere): (usize, &WrittenSphere)| {
            let finite = sphere.center.iter().all(|x| x.is_finite());
            match finite && sphere.radius.is_finite() && sphere.radius > 0.0 {
                true => Ok(Sphere {
                    center: Point3::from(sphere.center.map(|x| x * unit)),
                    radius_m: sphere.radius * unit,
                }),
                false => Err(refuse(format!(
                    "sphere {i} of the gripper: expected a finite center and a radius above 0, got {:?} and {}",
                    sphere.center, sphere.radius
                ))),
            }
        };
        let grasp = |(i, written): (usize, WrittenGrasp)| {
            let refuse = |problem: String| refuse(format!("grasp {i}: {problem}"));
            if bundle.class_index(&written.class).is_none() {
                let known = bundle.classes.iter().map(|class| class.name.as_str());
                let known: Vec<&str> = known.collect();
                return Err(refuse(format!(
                    "no class `{}` in the model, expected one of: {}",
                    written.class,
                    known.join(", ")
                )));
            }
            if written.name.is_empty() || written.name.chars().any(|c| misleads(c) || c == ' ') {
                return Err(refuse(format!(
                    "expected a name without spaces and control characters, got {:?}",
                    written.name
                )));
            }
            if !(written.opening.is_finite() && written.opening >= 0.0) {
                return Err(refuse(format!(
                    "opening: expected a length of 0 or more, got {}",
                    written.opening
                )));
            }
            let mut matrix = written.t_obj_tool;
            matrix[..3].iter_mut().for_each(|row| row[3] *= unit);
            let pose = from_matrix(&matrix);
            Ok(Grasp {
                obj_from_tool: pose.map_err(|problem| refuse(format!("T_obj_tool: {problem}")))?,
                class: written.class,
                name: written.name,
                opening_m: written.opening * unit,
            })
        };
        let lengths = document.gripper.iter().map(|sphere| sphere.radius);
        let lengths = lengths.chain(document.grasps.iter().map(|grasp| grasp.opening));
        let longest = unit * lengths.fold(0.0, f64::max);
        if longest > LONGEST_M {
            return Err(refuse(format!(
                "expected openings and radii of {LONGEST_M} m at most, got {longest} m; check the unit"
            )));
        }
        let gripper = document.gripper.iter().enumerate().map(sphere);
        let gripper = gripper.collect::<Result<_>>()?;
        let grasps = document.grasps.into_iter().enumerate().map(grasp);
        let grasps = grasps.collect::<Result<_>>()?;
        Ok(Self { gripper, grasps })
    }

    /// The grasps of each object that is given; what was found and is not given is in the way as well.
    ///
    /// - `objects`: all that were found
    /// - `given`: indices of those that are given
    /// - `frame_from_world`: to the frame that the grasps are given in
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(super) fn of_all(
        &self,
        objects: &[ObjectPose],
        given: &[usize],
        bundle: &Bundle,
        frame_from_world: &Isometry3<f64>,
    ) -> Result<Vec<Vec<ReportedGrasp>>> {
        let (gripper, reaches) = (self.bound(), reaches(bundle));
        let place = |object: &usize| given.iter().position(|one| one == object);
        let of_object = |index: usize| {
            let object = &objects[index];
            let own = self
                .grasps
                .iter()
                .filter(|grasp| grasp.class == object.class);
            let grasps = own.map(|grasp| {
                cancel::check()?;
                let world_from_tool = object.world_from_obj * grasp.obj_from_tool;
                let others = (0..objects.len()).filter(|other| *other != index);
                let touched: Vec<usize> = others
                    .filter(|other| {
                        let other = &objects[*other];
                        let Some(class) = bundle.class_index(&other.class) else {
                            return false;
                        };
                        let tool_from_obj = world_from_tool.inverse() * other.world_from_obj;
                        let apart = tool_from_obj * Point3::origin() - gripper.center;
                        if apart.norm() > gripper.radius_m + reaches[class] {
                            return false;
                        }
                        let points = &bundle.classes[class].points;
                        let mut points = points.iter().map(|point| Point3::from(point.position));
                        points.any(|point| self.fills(&(tool_from_obj * point)))
                    })
                    .collect();
                let known = !self.gripper.is_empty();
                Ok(ReportedGrasp {
                    name: grasp.name.clone(),
                    t_frame_tool: rows(&(frame_from_world * world_from_tool)),
                    opening_m: grasp.opening_m,
                    collides: known.then_some(!touched.is_empty()),
                    collides_with: known.then(|| touched.iter().filter_map(place).collect()),
                })
            });
            grasps.collect()
        };
        given.iter().copied().map(of_object).collect()
    }

    /// A sphere around all of the gripper, tool frame.
    fn bound(&self) -> Sphere {
        let count = self.gripper.len().max(1) as f64;
        let sum: Vector3<f64> = self.gripper.iter().map(|one| one.center.coords).sum();
        let center = Point3::from(sum / count);
        let reach = |one: &Sphere| (one.center - center).norm() + one.radius_m;
        Sphere {
            center,
            radius_m: self.gripper.iter().map(reach).fold(0.0, f64::max),
        }
    }

    /// Whether the gripper fills a point of the tool's frame.
    fn fills(&self, point: &Point3<f64>) -> bool {
        let within = |sphere: &Sphere| (point - sphere.center).norm() <= sphere.radius_m;
        self.gripper.iter().any(within)
    }
}

/// The largest distance of a surface point of each class from its origin, metres.
fn reaches(bundle: &Bundle) -> Vec<f64> {
    let reach = |class: &Class| {
        let points = class.points.iter().map(|point| point.position);
        points
            .map(|at| Vector3::from(at).norm())
            .fold(0.0, f64::max)
    };
    bundle.classes.iter().map(reach).collect()
}
