//! Poses that an object may have, where the views leave it open.
//!
//! A decoder may give several poses of each object, each with a score; anchored in another picture it
//! may give others; and the object coordinates may fit in more ways than one. What lies near each
//! other is one hypothesis. Which of them is right, the images tell ([`super::refined`]).

use super::pose::{DecodedPose, mean_pose};
use crate::prediction::{Hypothesis, Sigma};
use crate::symmetry::Symmetry;

/// Rotations that are nearer to each other are of one hypothesis, degrees.
pub const NEAR_DEG: f64 = 25.0;
/// So many are kept, at most.
pub const MOST: usize = 6;
/// Hypotheses that are less probable are not kept.
const FAINTEST: f64 = 0.02;

/// Those near each other as their mean, and as probable as all of them; the most probable first.
///
/// - `all`: at least one
pub fn combined(all: Vec<Hypothesis>, symmetry: &Symmetry, diameter_m: f64) -> DecodedPose {
    let groups = groups(all, symmetry, diameter_m);
    likeliest(
        groups
            .iter()
            .map(|group| mean_pose(group, symmetry, diameter_m))
            .collect(),
        symmetry,
        diameter_m,
    )
}

/// The most probable first; of those near each other, the more probable one.
///
/// - `all`: at least one
pub fn likeliest(all: Vec<Hypothesis>, symmetry: &Symmetry, diameter_m: f64) -> DecodedPose {
    let firsts = groups(all, symmetry, diameter_m)
        .into_iter()
        .filter_map(|group| group.into_iter().next());
    let mut found: Vec<Hypothesis> = firsts.collect();
    let total: f64 = found.iter().map(|one| one.probability).sum();
    found.retain(|one| one.probability > FAINTEST * total);
    found.truncate(MOST);
    chosen(found, symmetry, diameter_m)
}

/// The most probable first, together with what is near it.
fn groups(mut all: Vec<Hypothesis>, symmetry: &Symmetry, diameter_m: f64) -> Vec<Vec<Hypothesis>> {
    all.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let mut groups: Vec<Vec<Hypothesis>> = Vec::new();
    for one in all {
        let near = |group: &&mut Vec<Hypothesis>| {
            let first = &group[0].world_from_obj;
            symmetry.apart_deg(first, &one.world_from_obj, diameter_m) < NEAR_DEG
        };
        match groups.iter_mut().find(near) {
            Some(group) => group.push(one),
            None => groups.push(vec![one]),
        }
    }
    groups
}

/// The first of them with the error that is expected of it, as it may be another one.
///
/// - `found`: at least one
fn chosen(mut found: Vec<Hypothesis>, symmetry: &Symmetry, diameter_m: f64) -> DecodedPose {
    let total: f64 = found.iter().map(|one| one.probability).sum();
    for one in &mut found {
        one.probability /= total;
    }
    let first = &found[0].world_from_obj;
    let (mut rot_deg, mut square) = (0.0, 0.0);
    for one in &found {
        let away = symmetry.apart_deg(first, &one.world_from_obj, diameter_m);
        let shift = first.translation.vector - one.world_from_obj.translation.vector;
        rot_deg += one.probability * one.sigma.rot_deg.hypot(away);
        square += one.probability * (one.sigma.t_m.powi(2) + shift.norm_squared() / 3.0);
    }
    DecodedPose {
        world_from_obj: *first,
        sigma: Sigma {
            rot_deg: rot_deg.min(180.0),
            t_m: square.sqrt(),
        },
        support: None,
        hypotheses: found,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, UnitQuaternion, Vector3};

    fn turned(degrees: f64, probability: f64) -> Hypothesis {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * degrees.to_radians());
        Hypothesis {
            world_from_obj: Isometry3::from_parts(Vector3::z().into(), turn),
            sigma: Sigma {
                rot_deg: 3.0,
                t_m: 0.001,
            },
            probability,
        }
    }

    fn degrees(pose: &Isometry3<f64>) -> f64 {
        pose.rotation.scaled_axis().z.to_degrees()
    }

    #[test]
    fn poses_near_each_other_are_one_and_together_more_probable() {
        // 90 alone is the most probable one; 0 and 10 together are more so.
        let all = vec![turned(90.0, 0.4), turned(0.0, 0.3), turned(10.0, 0.3)];
        let pose = combined(all, &Symmetry::default(), 0.1);
        assert!((degrees(&pose.world_from_obj) - 5.0).abs() < 1e-6);
        let [first, other] = &pose.hypotheses[..] else {
            panic!("{:?}", pose.hypotheses)
        };
        assert!((first.probability - 0.6).abs() < 1e-12 && first.sigma.rot_deg == 3.0);
        assert!((degrees(&other.world_from_obj) - 90.0).abs() < 1e-6);
        assert!((other.probability - 0.4).abs() < 1e-12);
        // It may be the other one, 85 degrees away.
        let expected = 0.6 * 3.0 + 0.4 * 3.0_f64.hypot(85.0);
        assert!((pose.sigma.rot_deg - expected).abs() < 1e-6);
    }

    #[test]
    fn what_agrees_is_the_mean_alone() {
        let pose = combined(
            vec![turned(4.0, 0.5), turned(-4.0, 0.5)],
            &Symmetry::default(),
            0.1,
        );
        assert!(pose.hypotheses.len() == 1 && degrees(&pose.world_from_obj).abs() < 1e-6);
        assert!((pose.sigma.rot_deg - 3.0).abs() < 1e-12);
    }
}
