//! Rotation and translation errors of symmetric objects.

use nalgebra::Isometry3;

use super::Symmetries;
use mvtop_core::pose;

/// Least angle between the estimated rotation and a symmetric one of the true, degrees.
///
/// Without symmetries this is `re` of bop_toolkit.
pub fn rotation_error_deg(
    truth: &Isometry3<f64>,
    estimate: &Isometry3<f64>,
    symmetries: &Symmetries,
) -> f64 {
    least(symmetries, |motion| {
        pose::rotation_error_deg(&(truth.rotation * motion.rotation), &estimate.rotation)
    })
}

/// Least distance between the estimated origin and a symmetric one of the true, in the unit of the
/// poses.
///
/// Only symmetries that move the origin make a difference. Without them this is `te` of
/// bop_toolkit.
pub fn translation_error(
    truth: &Isometry3<f64>,
    estimate: &Isometry3<f64>,
    symmetries: &Symmetries,
) -> f64 {
    least(symmetries, |motion| {
        pose::translation_error(&(truth * motion), estimate)
    })
}

fn least(symmetries: &Symmetries, error: impl Fn(&Isometry3<f64>) -> f64) -> f64 {
    let errors = symmetries.motions().iter().map(error);
    errors.fold(f64::INFINITY, f64::min)
}
