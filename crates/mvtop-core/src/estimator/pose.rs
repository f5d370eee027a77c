//! Poses as the decoder gives them, and their mean.

use nalgebra::{Isometry3, Matrix4, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use ndarray::{ArrayView1, s};

use super::view::View;
use crate::bundle::Class;
use crate::network::Decoded;
use crate::pose::rotation_from_6d;
use crate::prediction::{Hypothesis, Sigma};
use crate::symmetry::Symmetry;
use crate::{Error, Result};

/// An object's pose, and which others it may have.
#[derive(Debug, Clone)]
pub struct DecodedPose {
    pub world_from_obj: Isometry3<f64>,
    /// How far it is expected to be off, as it may be another of the hypotheses.
    pub sigma: Sigma,
    /// See [`crate::prediction::ObjectPose::support`].
    pub support: Option<f64>,
    /// All of them, this one first, then by their probability.
    pub hypotheses: Vec<Hypothesis>,
}

impl Hypothesis {
    /// Those of query `q`, from the anchor's frame into the world.
    pub fn of_query(
        world_from_anchor: &Isometry3<f64>,
        decoded: &Decoded,
        q: usize,
    ) -> Result<Vec<Self>> {
        let Some(several) = &decoded.hypotheses else {
            let [rotation, t, sigma] = [&decoded.rotation_6d, &decoded.translation, &decoded.sigma]
                .map(|array| array.row(q));
            return Ok(vec![Self::new(
                world_from_anchor,
                [rotation, t, sigma],
                1.0,
            )?]);
        };
        let scores = several.score.row(q).mapv(f64::from);
        let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let odds = scores.mapv(|score| (score - most).exp());
        let one = |(k, odd): (usize, &f64)| {
            let numbers = [&several.rotation_6d, &several.translation, &several.sigma]
                .map(|array| array.slice(s![q, k, ..]));
            Self::new(world_from_anchor, numbers, odd / odds.sum())
        };
        odds.iter().enumerate().map(one).collect()
    }

    /// - `numbers`: rotation, translation and sigma, in the anchor's frame
    fn new(
        world_from_anchor: &Isometry3<f64>,
        [rotation, t, sigma]: [ArrayView1<f32>; 3],
        probability: f64,
    ) -> Result<Self> {
        let number = |array: ArrayView1<f32>, i: usize| f64::from(array[i]);
        let t = [0, 1, 2].map(|i| number(t, i));
        let sigma = Sigma {
            rot_deg: number(sigma, 0),
            t_m: number(sigma, 1),
        };
        let all = t.iter().chain([&sigma.rot_deg, &sigma.t_m, &probability]);
        if !all.copied().all(f64::is_finite) {
            return Err(Error::Pose(format!(
                "decoder: expected a finite pose, got translation {t:?} and {sigma:?}"
            )));
        }
        if sigma.rot_deg < 0.0 || sigma.t_m < 0.0 {
            return Err(Error::Pose(format!(
                "decoder: expected errors of 0 or more, got {sigma:?}"
            )));
        }
        let rotation = rotation_from_6d([0, 1, 2, 3, 4, 5].map(|i| number(rotation, i)))?;
        let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
        let anchor_from_obj = Isometry3::from_parts(Translation3::from(t), rotation);
        Ok(Self {
            world_from_obj: world_from_anchor * anchor_from_obj,
            sigma,
            probability,
        })
    }
}

/// Objects farther away than this, in diameters, are less than a pixel wide in any image.
pub const FARTHEST: f64 = 1e4;

impl DecodedPose {
    /// Refuses a pose that is too far from all cameras that gave an image to be seen.
    pub fn check_near(&self, views: &[View], class: &Class) -> Result<()> {
        let distance = |view: &View| {
            let camera = view.camera.world_from_cam().translation.vector;
            (self.world_from_obj.translation.vector - camera).norm()
        };
        let nearest = views.iter().map(distance).fold(f64::INFINITY, f64::min);
        if nearest <= FARTHEST * class.diameter_m {
            return Ok(());
        }
        Err(Error::Pose(format!(
            "decoder: expected objects near enough to be seen, got `{}` of {} m at {nearest:.0} m",
            class.name, class.diameter_m
        )))
    }

    /// Refuses a pose behind all cameras that gave an image; a fisheye may see what is behind it.
    pub fn check_in_front(&self, views: &[View]) -> Result<()> {
        let origin = Point3::from(self.world_from_obj.translation.vector);
        let behind = |view: &View| {
            let in_cam = view
                .camera
                .world_from_cam()
                .inverse_transform_point(&origin);
            let family = view.camera.intrinsics().projection().family();
            family == "pinhole" && in_cam.z <= 0.0
        };
        match views.iter().all(behind) {
            false => Ok(()),
            true => Err(Error::Pose(format!(
                "decoder: expected objects in front of a camera, got one behind all {} of them",
                views.len()
            ))),
        }
    }
}

/// The mean of some poses of one object, at least one, each by its probability; of their expected
/// errors likewise. It is as probable as all of them.
///
/// Of poses that look alike those near the first are averaged, and one and the same is given
/// ([`Symmetry::canonical`]).
pub fn mean_pose(poses: &[Hypothesis], symmetry: &Symmetry, diameter: f64) -> Hypothesis {
    let first = &poses[0].world_from_obj;
    let alike = |pose: &Hypothesis| symmetry.nearest(&pose.world_from_obj, first, diameter);
    let total: f64 = poses.iter().map(|pose| pose.probability).sum();
    let alike: Vec<(f64, Isometry3<f64>)> = poses
        .iter()
        .map(|pose| (pose.probability / total, alike(pose)))
        .collect();
    let translation: Vector3<f64> = alike
        .iter()
        .map(|(share, p)| p.translation.vector * *share)
        .sum();
    let rotation = mean_rotation(alike.iter().map(|(share, pose)| (*share, pose.rotation)));
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

/// The rotation with the least sum of squared chordal distances to those given, each with its weight
/// (Markley et al., Averaging Quaternions, 2007); not nalgebra's `mean_of`, which mixes up the
/// components (0.35).
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_of_rotations_by_hand() {
        let axis = Vector3::new(0.6, 0.0, 0.8);
        let middle = UnitQuaternion::from_scaled_axis(Vector3::new(2.0, -1.0, 0.5));
        let around = |degrees: f64| {
            let turn = middle * UnitQuaternion::from_scaled_axis(axis * degrees.to_radians());
            // The same rotation by the opposite quaternion.
            if degrees > 0.0 {
                UnitQuaternion::new_unchecked(-turn.into_inner())
            } else {
                turn
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
