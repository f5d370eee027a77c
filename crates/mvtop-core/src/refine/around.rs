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
/// Those as near to where the steps lead from the pose itself are the same.
const OWN_DEG: f64 = 1.5;
/// How much less probable than that one they may be, as a logarithm.
const FAINTER: f64 = 1.0;

impl Refiner {
    /// Poses that small close-ups show about as well as the one that they show best near this one, of
    /// those that are turned by some degrees about the object's center, to all sides; the best first.
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
        let turned = |axis: Vector3<f64>| {
            let axis = world_from_obj.rotation * axis;
            let turn = UnitQuaternion::from_scaled_axis(axis * degrees.to_radians());
            Isometry3::rotation_wrt_point(turn, center) * world_from_obj
        };
        let sigma = Sigma {
            rot_deg: sigma.rot_deg.max(1.5 * degrees),
            ..sigma
        };
        // All starts have the object's center where it is, so that one close-up shows them all.
        let working = self.working(views, world_from_obj, COARSE);
        let shown = |start: &Isometry3<f64>| {
            let mut working = working.clone();
            let prior = Prior::new(*start, sigma);
            let mut pose = *start;
            for step in STEPS {
                pose = self.stepped(&mut working, &prior, &pose, step)?.0;
            }
            let fit = self.fit(&mut working, &pose)?;
            Some((self.quality_of(&working, &fit, &pose).score(), pose))
        };
        let starts: Vec<Isometry3<f64>> = [*world_from_obj]
            .into_iter()
            .chain(axes().map(turned))
            .collect();
        let found: Vec<Option<(f64, Isometry3<f64>)>> = starts.par_iter().map(shown).collect();
        let Some(&Some((least, own))) = found.first() else {
            return Vec::new();
        };
        let apart =
            |a: &Isometry3<f64>, b: &Isometry3<f64>| a.rotation.angle_to(&b.rotation).to_degrees();
        let mut others: Vec<(f64, Isometry3<f64>)> = found.into_iter().flatten().collect();
        others.retain(|(score, pose)| *score > least - FAINTER && apart(pose, &own) > OWN_DEG);
        others.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut kept: Vec<Isometry3<f64>> = Vec::new();
        for (_, pose) in others {
            if kept.iter().all(|other| apart(&pose, other) > SAME_DEG) {
                kept.push(pose);
            }
        }
        kept
    }
}

/// Both ways about each of three.
fn axes() -> [Vector3<f64>; 6] {
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
    [x, -x, y, -y, z, -z]
}
