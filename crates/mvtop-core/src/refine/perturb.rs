//! Local perturbations of a pose, to escape from a wrong local optimum.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::gauss_newton::Prior;
use super::{Refiner, View};
use crate::pose::rotation_error_deg;
use crate::prediction::Sigma;

impl Refiner {
    /// Poses near a given one that score about as well on coarse crops as the one that it converges
    /// to, best first. They come from rotations by an angle about axes in all directions.
    ///
    /// - `sigma`: expected error of a rotated pose
    pub fn perturbed(
        &self,
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
        degrees: f64,
    ) -> Vec<Isometry3<f64>> {
        let center = world_from_obj * self.center();
        let rotated = |axis: Vector3<f64>| {
            let axis = world_from_obj.rotation * axis;
            let turn = UnitQuaternion::from_scaled_axis(axis * degrees.to_radians());
            Isometry3::rotation_wrt_point(turn, center) * world_from_obj
        };
        let sigma = Sigma {
            rot_deg: sigma.rot_deg.max(1.5 * degrees),
            ..sigma
        };
        let config = &self.config;
        let Some((last_coarse, first_steps)) = config.coarse.steps_px.split_last() else {
            return Vec::new();
        };
        // The object's center is the same in all starts, so one crop contains them all.
        let states = self.view_states(views, world_from_obj, &config.coarse);
        let iterated = |prior: &Prior, start: &Isometry3<f64>, steps: &[f64]| {
            let (mut states, mut pose) = (states.clone(), *start);
            for &step in steps {
                pose = self
                    .iterate(&mut states, prior, &pose, step)?
                    .world_from_obj;
            }
            Some((pose, states))
        };
        let converge = |start: Isometry3<f64>| {
            let prior = Prior::new(start, sigma);
            Some((iterated(&prior, &start, first_steps)?.0, prior))
        };
        let starts = [*world_from_obj].into_iter();
        let starts: Vec<_> = starts.chain(icosahedron().map(rotated)).collect();
        let mut found: Vec<_> = starts.into_par_iter().filter_map(converge).collect();
        let [first_merge, own_merge, last_merge] = config.perturbation_merge_deg;
        merge(&mut found, first_merge);
        let evaluated = |(pose, prior): &(Isometry3<f64>, Prior)| {
            let steps = [*last_coarse, config.final_step_px()];
            let (pose, mut states) = iterated(prior, pose, &steps)?;
            let fit = self.fit(&mut states, &pose)?;
            Some((pose, self.quality_of(&states, &fit, &pose).score(config)))
        };
        let found: Vec<_> = found.par_iter().map(evaluated).collect();
        let Some(&Some((own, own_score))) = found.first() else {
            return Vec::new();
        };
        let mut others: Vec<(Isometry3<f64>, f64)> = found.into_iter().flatten().collect();
        // Less than a third as probable is not worth a refinement.
        others.retain(|(pose, score)| *score > own_score - 1.0 && angle(pose, &own) > own_merge);
        others.sort_by(|(_, a), (_, b)| b.total_cmp(a));
        merge(&mut others, last_merge);
        others.into_iter().map(|(pose, _)| pose).collect()
    }
}

/// Angle between two poses, degrees.
fn angle(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    rotation_error_deg(&a.rotation, &b.rotation)
}

/// Keeps the first one of poses within some degrees of each other.
fn merge<T>(poses: &mut Vec<(Isometry3<f64>, T)>, degrees: f64) {
    let mut kept: Vec<Isometry3<f64>> = Vec::new();
    poses.retain(|(pose, _)| {
        let is_new = kept.iter().all(|other| angle(pose, other) > degrees);
        if is_new {
            kept.push(*pose);
        }
        is_new
    });
}

/// Unit vectors to the corners of an icosahedron.
fn icosahedron() -> [Vector3<f64>; 12] {
    let long = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let norm = 1.0_f64.hypot(long);
    std::array::from_fn(|i| {
        let sign = |bit: usize| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let (short, long) = (sign(0) / norm, sign(1) * long / norm);
        match i / 4 {
            0 => Vector3::new(0.0, short, long),
            1 => Vector3::new(short, long, 0.0),
            _ => Vector3::new(long, 0.0, short),
        }
    })
}
