//! Poses that recur in another split: all of them found, none invented.

mod by_hand;
mod files;
mod fuzz;

use mvtop_core::mesh::Mesh;
use mvtop_core::symmetry::Symmetry;
use mvtop_eval::bop::Model;
use mvtop_eval::leakage::{PoseRecord, Split};
use mvtop_eval::metrics::{Surface, Symmetries};
use nalgebra::{Point3, Rotation3, Vector3};

const WITHIN_MM: f64 = 0.01;

fn pose(translation_mm: [f64; 3], turn_deg: [f64; 3]) -> PoseRecord {
    let turn = Vector3::from(turn_deg.map(f64::to_radians));
    PoseRecord {
        scene: 0,
        image: 0,
        annotation: 0,
        rotation: Rotation3::new(turn).into_inner(),
        translation_mm: translation_mm.into(),
    }
}

fn split(objects: impl IntoIterator<Item = (u32, Vec<PoseRecord>)>) -> Split {
    Split {
        scenes: vec!["000000".into()],
        objects: objects.into_iter().collect(),
        ..Split::default()
    }
}

/// An object of these points; all lengths are millimetres.
fn model(points: &[Point3<f64>], diameter: f64) -> Model {
    let points: Vec<_> = points.iter().map(|point| point * 1e-3).collect();
    Model {
        id: 1,
        name: None,
        diameter_m: diameter * 1e-3,
        symmetries: Symmetries::default(),
        symmetry: Symmetry::default(),
        surface: Surface::new(&points).unwrap(),
        path: "obj_000001.ply".into(),
        mesh: Mesh::new(points, vec![], vec![]).unwrap(),
    }
}
