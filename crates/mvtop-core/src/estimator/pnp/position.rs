//! Position of an object before its rotation is known.

use nalgebra::{Matrix3, Vector3};

use super::{Correspondence, Correspondences};
use crate::config::PnpConfig;

/// The object's position, world frame, metres, by least squares: each crop contributes its central ray,
/// and a distance from the apparent size.
///
/// Cameras near each other measure the distance by size; cameras far apart, by where their rays meet.
pub fn position(config: &PnpConfig, all: &Correspondences) -> Option<Vector3<f64>> {
    let across = (config.start_sigma[0] * all.diameter).powi(-2);
    let by_size = config.start_sigma[1];
    let (mut information, mut sum) = (Matrix3::zeros(), Vector3::zeros());
    for crop in 0..all.crops.len() {
        let cells = all.list.iter().filter(|one| one.crop == crop);
        let cells: Vec<&Correspondence> = cells.collect();
        let Some(Middle {
            origin,
            ahead,
            distance,
            weight,
        }) = Middle::of(&cells)
        else {
            continue;
        };
        let along = (by_size * distance).powi(-2);
        let known = Matrix3::identity() * across + ahead * ahead.transpose() * (along - across);
        information += known * weight;
        // Without a distance from the size it is infinite, and `along` 0.
        sum += (known * origin + ahead / (by_size.powi(2) * distance)) * weight;
    }
    Some(information.try_inverse()? * sum)
}

/// The central ray of what a crop shows.
struct Middle {
    origin: Vector3<f64>,
    /// Unit vector.
    ahead: Vector3<f64>,
    /// From the origin, metres; infinite where it is not known.
    distance: f64,
    weight: f64,
}

impl Middle {
    fn of(cells: &[&Correspondence]) -> Option<Self> {
        let weight: f64 = cells.iter().map(|one| one.weight).sum();
        let mean = |of: &dyn Fn(&Correspondence) -> Vector3<f64>| {
            let sum: Vector3<f64> = cells.iter().map(|one| of(one) * one.weight).sum();
            sum / weight
        };
        let spread = |of: &dyn Fn(&Correspondence) -> Vector3<f64>| {
            let middle = mean(of);
            let squares = cells
                .iter()
                .map(|one| (of(one) - middle).norm_squared() * one.weight);
            squares.sum::<f64>() / weight
        };
        let ahead = mean(&|one| one.direction).try_normalize(0.0)?;
        let aside = spread(&|one| one.direction / one.direction.dot(&ahead));
        // Points spread along three axes, two of which are across the ray.
        let across = spread(&|one| one.point.coords) * 2.0 / 3.0;
        let distance = (across / aside).sqrt();
        Some(Self {
            origin: cells.first()?.origin.coords,
            ahead,
            distance: if distance > 0.0 {
                distance
            } else {
                f64::INFINITY
            },
            weight,
        })
    }
}
