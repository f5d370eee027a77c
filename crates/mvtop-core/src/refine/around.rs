//! Poses around one that the images do not show well.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::solve::Prior;
use super::working::COARSE;
use super::{Refiner, View};
use crate::pose::rotation_error_deg;
use crate::prediction::Sigma;

/// First and last steps from each start.
const NEAR: [f64; 2] = [4.0, 3.0];
const LAST: [f64; 2] = [2.0, 1.0];
/// Poses that the first steps bring so near to each other are one, degrees.
const ONE_DEG: f64 = 2.0;
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
        let stepped = |prior: &Prior, start: &Isometry3<f64>, steps: [f64; 2]| {
            let (mut working, mut pose) = (working.clone(), *start);
            for step in steps {
                pose = self.stepped(&mut working, prior, &pose, step)?.0;
            }
            Some((pose, working))
        };
        let near = |start: Isometry3<f64>| {
            let prior = Prior::new(start, sigma);
            Some((stepped(&prior, &start, NEAR)?.0, prior))
        };
        let starts: Vec<Isometry3<f64>> = [*world_from_obj]
            .into_iter()
            .chain(axes().map(turned))
            .collect();
        let mut found: Vec<(Isometry3<f64>, Prior)> =
            starts.into_par_iter().filter_map(near).collect();
        keep_apart(&mut found, ONE_DEG);
        let shown = |(pose, prior): &(Isometry3<f64>, Prior)| {
            let (pose, mut working) = stepped(prior, pose, LAST)?;
            let fit = self.fit(&mut working, &pose)?;
            Some((pose, self.quality_of(&working, &fit, &pose).score()))
        };
        let found: Vec<Option<(Isometry3<f64>, f64)>> = found.par_iter().map(shown).collect();
        let Some(&Some((own, least))) = found.first() else {
            return Vec::new();
        };
        let mut others: Vec<(Isometry3<f64>, f64)> = found.into_iter().flatten().collect();
        others.retain(|(pose, score)| *score > least - FAINTER && apart(pose, &own) > OWN_DEG);
        others.sort_by(|(_, a), (_, b)| b.total_cmp(a));
        keep_apart(&mut others, SAME_DEG);
        others.into_iter().map(|(pose, _)| pose).collect()
    }
}

/// Angle between two poses, degrees.
fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    rotation_error_deg(&a.rotation, &b.rotation)
}

/// Of poses nearer to each other than some degrees, only the first stays.
fn keep_apart<T>(poses: &mut Vec<(Isometry3<f64>, T)>, degrees: f64) {
    let mut kept: Vec<Isometry3<f64>> = Vec::new();
    poses.retain(|(pose, _)| {
        let other = kept.iter().all(|other| apart(pose, other) > degrees);
        if other {
            kept.push(*pose);
        }
        other
    });
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
