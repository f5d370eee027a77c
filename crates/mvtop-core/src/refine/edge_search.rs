//! Search for an edge along a correspondence line: by color gradients and by the regions beside it.
//!
//! Source of the region term: Stoiber et al., "SRT3D: A Sparse Region-Based 3D Object Tracking Approach
//! for the Real World", 2022.

use super::contour::EdgePoint;
use super::crop_pixels::UNKNOWN;
use super::view_state::ViewState;

/// Samples of a line to each side of the projected edge.
const REACH: i32 = 8;
/// Samples to each side among which the edge is searched for: 11 places (M3T's
/// `distribution_length`, 12 there).
const SEARCHED: i32 = 5;
const PLACES: usize = 2 * SEARCHED as usize + 1;
const SAMPLES: usize = 2 * REACH as usize + 1;

/// Smoothed step function: the probability of the inner side by the distance of the edge, in samples
/// from `-REACH - SEARCHED` on.
pub type StepFunction = [f64; 2 * (REACH + SEARCHED) as usize + 1];

/// Smoothed step of SRT3D with M3T's `function_slope` of 0.5.
pub fn step_function(amplitude: f64) -> StepFunction {
    std::array::from_fn(|i| 0.5 + amplitude * (i as f64 - f64::from(REACH + SEARCHED)).tanh())
}

/// Place of an edge on its correspondence line.
#[derive(Debug, Clone, Copy)]
pub struct EdgeMatch {
    /// Displacement from the projected edge, outwards, px.
    pub displacement: f64,
    /// Variance of the displacement, px².
    pub variance: f64,
}

impl EdgeMatch {
    /// Whether the edge lies at its projection.
    ///
    /// - `limits`: [`super::RefineConfig::inlier_px`]
    pub fn is_inlier(&self, [displacement, sigma]: [f64; 2]) -> bool {
        self.displacement.abs() < displacement && self.variance < sigma * sigma
    }
}

impl ViewState<'_> {
    /// Mean and variance of the edge's place along a line, given the pixels on it.
    ///
    /// - `step`: px between samples
    pub fn match_edge(&self, point: &EdgePoint, step: f64) -> Option<EdgeMatch> {
        debug_assert_eq!(self.pixels.size, self.raster.size);
        let config = &self.refiner.config;
        let [floor, long_floor] = config.gradient_floor;
        let by_region = point.separates_segments();
        // Long lines cross other edges, so their gradients count less beside regions.
        let mut weights = self
            .pixels
            .squared_gradients::<PLACES>(point.pixel, point.normal, step)
            .map(|change| match by_region && config.is_long(step) {
                true => (change + long_floor).sqrt(),
                false => change + floor,
            });
        if by_region {
            let within = self.side_probabilities(point, step)?;
            for (i, p) in within.iter().enumerate() {
                let Some(p) = p else {
                    continue;
                };
                let inner = &self.refiner.step_function[2 * REACH as usize - i..];
                for (weight, inner) in weights.iter_mut().zip(inner) {
                    *weight *= inner * p + (1.0 - inner) * (1.0 - p);
                }
            }
        }
        let sum: f64 = weights.iter().sum();
        let places = || (-SEARCHED..=SEARCHED).map(f64::from).zip(&weights);
        let mean = places().map(|(place, weight)| place * weight).sum::<f64>() / sum;
        let squared = places().map(|(place, weight)| (place - mean) * (place - mean) * weight);
        let variance = squared.sum::<f64>() / sum;
        let displacement = mean * step;
        displacement.is_finite().then_some(EdgeMatch {
            displacement,
            // 0.1: no line is more exact than its sampling.
            variance: (variance + 0.1) * step * step,
        })
    }

    /// Probability of each sample of a line, from within outwards, that it shows the inner side;
    /// `None` for samples of a third segment or outside the image.
    fn side_probabilities(&self, point: &EdgePoint, step: f64) -> Option<[Option<f64>; SAMPLES]> {
        let mut within = [None; SAMPLES];
        let mut known = 0;
        let pixels = step.ceil() as i32;
        for (direction, side) in [(-1, point.sides[0]), (1, point.sides[1])] {
            'side: for i in 0..=REACH {
                if i == 0 && direction == 1 {
                    continue;
                }
                // Mean log-odds of the pixels of this sample.
                let (mut odds, mut count) = (0.0, 0);
                for j in 0..pixels {
                    let along = f64::from(i) * f64::from(direction)
                        + (f64::from(j) + 0.5) / f64::from(pixels)
                        - 0.5;
                    let at = point.pixel + point.normal * (along * step);
                    let Some(index) = self.raster.index(at) else {
                        break 'side;
                    };
                    // Samples next to the edge may show either side.
                    if i > 1 && self.raster.label(index) != side {
                        break 'side;
                    }
                    if self.pixels.bins[index] != UNKNOWN {
                        odds += self.log_odds(index, point.sides);
                        count += 1;
                    }
                }
                if count > 0 {
                    let odds = odds / f64::from(count);
                    within[(REACH + i * direction) as usize] = Some(1.0 / (1.0 + (-odds).exp()));
                    known += 1;
                }
            }
        }
        (known >= 4).then_some(within)
    }

    /// Mean log-likelihood of the sides of the edges by color, bits per sample over chance: 1 if
    /// colors separate all sides, 0 if they do not. For the outline, and for inner edges.
    pub fn edge_separation(&self, step: f64) -> [Option<f64>; 2] {
        [true, false].map(|outline| {
            let (mut bits, mut count) = (0.0, 0.0);
            let wanted = |p: &&EdgePoint| p.separates_segments() && p.is_outline() == outline;
            for point in self.points.iter().filter(wanted) {
                let Some(within) = self.side_probabilities(point, step) else {
                    continue;
                };
                for (i, p) in (-REACH..=REACH).zip(within) {
                    if let Some(p) = p
                        && i != 0
                    {
                        let correct = if i < 0 { p } else { 1.0 - p };
                        bits += 1.0 + correct.max(1e-3).log2();
                        count += 1.0;
                    }
                }
            }
            (count > 0.0).then(|| bits / count)
        })
    }
}
