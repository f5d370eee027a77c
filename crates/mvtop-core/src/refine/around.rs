//! Poses around one that the images do not show well.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::solve::Prior;
use super::working::COARSE;
use super::{Refiner, View};
use crate::prediction::Sigma;

/// Steps from each start.
const STEPS: [f64; 4] = [4.0, 3.0, 2.0, 1.0];
/// Poses that are nearer to each other are one, degrees.
const SAME_DEG: f64 = 3.0;

impl Refiner {
    /// Poses that the images show best on coarse close-ups, of those that are turned by some degrees about
    /// the object's center, to all sides; the best first.
    ///
    /// - `sigma`: how far the pose is expected to be off, once turned
    pub fn around(
        &self,
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
        degrees: f64,
    ) -> Vec<Isometry3<f64>> {
        let center = world_from_obj * self.center();
        let start = |axis: Vector3<f64>| {
            let turn = UnitQuaternion::from_scaled_axis(axis * degrees.to_radians());
            Isometry3::rotation_wrt_point(turn, center) * world_from_obj
        };
        let starts = axes().map(start);
        let sigma = Sigma {
            rot_deg: sigma.rot_deg.max(1.5 * degrees),
            ..sigma
        };
        // All starts have the object's center where it is, so that one close-up shows them all.
        let working = self.working(views, world_from_obj, COARSE);
        let one = |start: &Isometry3<f64>| {
            let mut working = working.clone();
            let prior = Prior::new(*start, sigma);
            let mut pose = *start;
            for step in STEPS {
                pose = self.stepped(&mut working, &prior, &pose, step)?.0;
            }
            let fit = self.fit(&mut working, &pose)?;
            Some((self.quality_of(&working, &fit, &pose).score(), pose))
        };
        let mut found: Vec<(f64, Isometry3<f64>)> = starts.par_iter().filter_map(one).collect();
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut apart: Vec<Isometry3<f64>> = Vec::new();
        for (_, pose) in found {
            let same = |other: &Isometry3<f64>| {
                other.rotation.angle_to(&pose.rotation).to_degrees() < SAME_DEG
            };
            if !apart.iter().any(same) {
                apart.push(pose);
            }
        }
        apart
    }
}

/// Those through the corners of an icosahedron.
fn axes() -> [Vector3<f64>; 12] {
    let long = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let norm = 1.0_f64.hypot(long);
    let mut all = [Vector3::zeros(); 12];
    for (i, axis) in all.iter_mut().enumerate() {
        let sign = |bit: usize| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let (short, long) = (sign(0) / norm, sign(1) * long / norm);
        *axis = match i / 4 {
            0 => Vector3::new(0.0, short, long),
            1 => Vector3::new(short, long, 0.0),
            _ => Vector3::new(long, 0.0, short),
        };
    }
    all
}
