//! Where an object is about, before its pose is known.

use nalgebra::{Matrix3, Vector3};

use super::cells::{Evidence, Seen};

/// How far beside the object's middle a view may see it, in diameters: it shows one side.
const ASIDE: f64 = 0.1;
/// How far off a distance may be that is told by how large places look, as a share of it.
const BY_SIZE: f64 = 0.3;

/// Where all views see the object, world frame, metres: each on the line of sight in the middle of
/// what it shows, as far away as the places would have to be to look as large as they do.
///
/// So cameras that stand near each other tell the distance as one of them does, and others, whose
/// lines of sight cross, by where these meet.
pub fn position(evidence: &Evidence) -> Option<Vector3<f64>> {
    let across = (ASIDE * evidence.diameter).powi(-2);
    let (mut information, mut sum) = (Matrix3::zeros(), Vector3::zeros());
    for view in 0..evidence.views.len() {
        let cells = evidence.cells.iter().filter(|cell| cell.view == view);
        let cells: Vec<&Seen> = cells.collect();
        let Some(Middle {
            origin,
            ahead,
            distance,
            weight,
        }) = Middle::of(&cells)
        else {
            continue;
        };
        let along = (BY_SIZE * distance).powi(-2);
        let known = Matrix3::identity() * across + ahead * ahead.transpose() * (along - across);
        information += known * weight;
        // Where size tells no distance, it is infinite and `along` 0.
        sum += (known * origin + ahead / (BY_SIZE.powi(2) * distance)) * weight;
    }
    Some(information.try_inverse()? * sum)
}

/// The middle of what a view shows.
struct Middle {
    origin: Vector3<f64>,
    /// Unit vector.
    ahead: Vector3<f64>,
    /// From the origin; infinite where it is not known.
    distance: f64,
    weight: f64,
}

impl Middle {
    fn of(cells: &[&Seen]) -> Option<Self> {
        let weight: f64 = cells.iter().map(|one| one.weight).sum();
        let mean = |of: &dyn Fn(&Seen) -> Vector3<f64>| {
            let sum: Vector3<f64> = cells.iter().map(|one| of(one) * one.weight).sum();
            sum / weight
        };
        let spread = |of: &dyn Fn(&Seen) -> Vector3<f64>| {
            let middle = mean(of);
            let squares = cells
                .iter()
                .map(|one| (of(one) - middle).norm_squared() * one.weight);
            squares.sum::<f64>() / weight
        };
        let ahead = mean(&|one| one.direction).try_normalize(0.0)?;
        let aside = spread(&|one| one.direction / one.direction.dot(&ahead));
        // Two of the three axes along which places spread are across the line of sight.
        let across = spread(&|one| one.place.coords) * 2.0 / 3.0;
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
