//! Poses that are near each other, but for symmetries.

use nalgebra::{Isometry3, Matrix4, Quaternion, UnitQuaternion, Vector3};

use crate::prediction::{Hypothesis, Sigma};
use crate::symmetry::Symmetry;

/// The most probable hypothesis first, in groups: each is within `merge_deg` of its group's first.
pub fn groups(
    mut all: Vec<Hypothesis>,
    symmetry: &Symmetry,
    diameter_m: f64,
    merge_deg: f64,
) -> Vec<Vec<Hypothesis>> {
    all.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let mut groups: Vec<Vec<Hypothesis>> = Vec::new();
    for one in all {
        let near = |group: &&mut Vec<Hypothesis>| {
            let first = &group[0].world_from_obj;
            symmetry.apart_deg(first, &one.world_from_obj, diameter_m) < merge_deg
        };
        match groups.iter_mut().find(near) {
            Some(group) => group.push(one),
            None => groups.push(vec![one]),
        }
    }
    groups
}

/// Of poses within `merge_deg` of each other the first, at most so many.
///
/// - `pose`: of one of them
pub fn distinct<T>(
    all: impl IntoIterator<Item = T>,
    pose: impl Fn(&T) -> Isometry3<f64>,
    symmetry: &Symmetry,
    diameter_m: f64,
    merge_deg: f64,
    most: usize,
) -> Vec<T> {
    let mut kept: Vec<T> = Vec::new();
    for one in all {
        let near =
            |other: &T| symmetry.apart_deg(&pose(other), &pose(&one), diameter_m) < merge_deg;
        if kept.len() < most && !kept.iter().any(near) {
            kept.push(one);
        }
    }
    kept
}

/// The weighted mean of each group, as probable as all of it.
pub fn means(groups: &[Vec<Hypothesis>], symmetry: &Symmetry, diameter_m: f64) -> Vec<Hypothesis> {
    let means = groups.iter().map(|group| mean(group, symmetry, diameter_m));
    let mut means: Vec<Hypothesis> = means.collect();
    means.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    means
}

/// The mean of hypotheses, weighted by their probabilities; of their expected errors likewise.
///
/// Equivalent poses are first brought near the first one; the mean is the canonical pose
/// ([`Symmetry::canonical`]).
///
/// - `poses`: at least one
pub fn mean(poses: &[Hypothesis], symmetry: &Symmetry, diameter_m: f64) -> Hypothesis {
    let first = &poses[0].world_from_obj;
    let total: f64 = poses.iter().map(|pose| pose.probability).sum();
    let weighted: Vec<(f64, Isometry3<f64>)> = poses
        .iter()
        .map(|pose| {
            let near = symmetry.nearest(&pose.world_from_obj, first, diameter_m);
            (pose.probability / total, near)
        })
        .collect();
    let translation: Vector3<f64> = weighted
        .iter()
        .map(|(share, pose)| pose.translation.vector * *share)
        .sum();
    let rotation = mean_rotation(weighted.iter().map(|(share, pose)| (*share, pose.rotation)));
    let mean_of = Isometry3::from_parts(translation.into(), rotation);
    let mean = |number: fn(&Sigma) -> f64| {
        let each = poses
            .iter()
            .map(|pose| number(&pose.sigma) * pose.probability / total);
        each.sum::<f64>()
    };
    Hypothesis {
        world_from_obj: symmetry.canonical(&mean_of),
        sigma: Sigma {
            rot_deg: mean(|sigma| sigma.rot_deg),
            t_m: mean(|sigma| sigma.t_m),
        },
        probability: total,
    }
}

/// The rotation with the least weighted sum of squared chordal distances (Markley et al., Averaging
/// Quaternions, 2007); nalgebra's `mean_of` mixes up the components (0.35).
pub fn mean_rotation(
    rotations: impl Iterator<Item = (f64, UnitQuaternion<f64>)>,
) -> UnitQuaternion<f64> {
    let sum: Matrix4<f64> = rotations
        .map(|(weight, q)| q.as_vector() * q.as_vector().transpose() * weight)
        .sum();
    let eigen = sum.symmetric_eigen();
    let main = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    UnitQuaternion::from_quaternion(Quaternion::from_vector(main.into_owned()))
}

/// The expected error of the first hypothesis, as another one may be right.
///
/// - `found`: at least one; probabilities sum up to 1
pub fn expected_error(found: &[Hypothesis], symmetry: &Symmetry, diameter_m: f64) -> Sigma {
    let first = &found[0].world_from_obj;
    let (mut rot_deg, mut square) = (0.0, 0.0);
    for one in found {
        let away = symmetry.apart_deg(first, &one.world_from_obj, diameter_m);
        let shift = first.translation.vector - one.world_from_obj.translation.vector;
        rot_deg += one.probability * one.sigma.rot_deg.hypot(away);
        square += one.probability * (one.sigma.t_m.powi(2) + shift.norm_squared() / 3.0);
    }
    Sigma {
        rot_deg: rot_deg.min(180.0),
        t_m: square.sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn near_hypotheses_become_their_mean_with_the_summed_probability() {
        // 90 degrees is the most probable single one; 0 and 10 together are more probable.
        let all = vec![turned(90.0, 0.4), turned(0.0, 0.3), turned(10.0, 0.3)];
        let none = Symmetry::default();
        let found = means(&groups(all, &none, 0.1, 25.0), &none, 0.1);
        let [first, other] = &found[..] else {
            panic!("{found:?}")
        };
        assert!((degrees(&first.world_from_obj) - 5.0).abs() < 1e-6);
        assert!((first.probability - 0.6).abs() < 1e-12 && first.sigma.rot_deg == 3.0);
        assert!((degrees(&other.world_from_obj) - 90.0).abs() < 1e-6);
        assert!((other.probability - 0.4).abs() < 1e-12);
        // It may be the other one, 85 degrees away.
        let expected = 0.6 * 3.0 + 0.4 * 3.0_f64.hypot(85.0);
        let sigma = expected_error(&found, &none, 0.1);
        assert!((sigma.rot_deg - expected).abs() < 1e-6);
    }

    #[test]
    fn opposite_quaternions_have_the_mean_between_their_rotations() {
        let axis = Vector3::new(0.6, 0.0, 0.8);
        let middle = UnitQuaternion::from_scaled_axis(Vector3::new(2.0, -1.0, 0.5));
        let around = |degrees: f64| {
            let turn = middle * UnitQuaternion::from_scaled_axis(axis * degrees.to_radians());
            match degrees > 0.0 {
                true => UnitQuaternion::new_unchecked(-turn.into_inner()),
                false => turn,
            }
        };
        for angles in [
            &[0.0][..],
            &[-20.0, 20.0],
            &[-35.0, 0.0, 35.0],
            &[-50.0, -9.0, 9.0, 50.0],
        ] {
            let mean = mean_rotation(angles.iter().map(|&degrees| (0.5, around(degrees))));
            assert!(mean.angle_to(&middle) < 1e-9, "{angles:?}");
        }
    }
}
