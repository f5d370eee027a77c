//! Mutual information of segment and color. It compares poses that are far from each other, whose
//! edges may match by chance.

use nalgebra::Vector3;

use super::crop_pixels::{BINS, LEVELS, UNKNOWN};
use super::mesh_model::BACKGROUND;
use super::view_state::ViewState;

/// Levels of each channel: half as many as for single edges.
const COARSE: usize = LEVELS / 2;

impl ViewState<'_> {
    /// Mutual information of segment and color, bits per pixel: for object and background along the
    /// outline, plus for the segments of the object. A segment counts negatively if its chromaticity
    /// differs from the largest one's in another direction than on the mesh.
    pub fn mutual_information(&self) -> f64 {
        let of_mesh = &self.refiner.mesh.chromaticities;
        let mut counts = vec![vec![0.0; COARSE * COARSE * COARSE]; of_mesh.len()];
        for (segment, run) in self.raster.runs() {
            let counts = &mut counts[usize::from(segment)];
            for &bin in self.pixels.bins[run].iter().filter(|bin| **bin != UNKNOWN) {
                counts[coarse(usize::from(bin))] += 1.0;
            }
        }
        let background = &mut counts[usize::from(BACKGROUND)];
        self.background_bins()
            .for_each(|bin| background[coarse(bin)] += 1.0);
        let (background, segments) = counts.split_at(1);
        let mut object = vec![0.0; background[0].len()];
        for segment in segments {
            object
                .iter_mut()
                .zip(segment)
                .for_each(|(sum, x)| *sum += x);
        }
        let outline: f64 = contributions(&[&background[0], &object]).iter().sum();
        let segments: Vec<&Vec<f64>> = segments.iter().collect();
        let agreement = chromaticity_agreement(&self.histograms.chromaticities, of_mesh);
        let inner = contributions(&segments).into_iter().zip(agreement);
        outline + inner.map(|(bits, agreement)| bits * agreement).sum::<f64>()
    }
}

fn coarse(bin: usize) -> usize {
    debug_assert!(bin < BINS);
    let level = |stride: usize| bin / stride % LEVELS * COARSE / LEVELS;
    (level(LEVELS * LEVELS) * COARSE + level(LEVELS)) * COARSE + level(1)
}

/// Contribution of each segment to the mutual information of segment and color, bits, corrected for
/// the bias of finite counts (Miller 1955).
fn contributions(counts: &[&Vec<f64>]) -> Vec<f64> {
    let sums: Vec<f64> = counts.iter().map(|segment| segment.iter().sum()).collect();
    let total: f64 = sums.iter().sum();
    let of_bin: Vec<f64> = (0..counts[0].len())
        .map(|bin| counts.iter().map(|segment| segment[bin]).sum())
        .collect();
    let one = |(segment, sum): (&&Vec<f64>, &f64)| {
        let (mut bits, mut used) = (0.0, 0.0);
        for (count, all) in segment
            .iter()
            .zip(&of_bin)
            .filter(|(count, _)| **count > 0.0)
        {
            bits += count / total * ((count / sum) / (all / total)).log2();
            used += 1.0;
        }
        bits - used / (2.0 * total.max(1.0) * std::f64::consts::LN_2)
    };
    counts.iter().zip(&sums).map(one).collect()
}

/// Cosine of each segment's chromaticity difference from the largest segment, between image and
/// mesh; 1 for the largest segment and for unknown differences.
///
/// - `seen`: means in the image, and numbers of pixels
fn chromaticity_agreement(seen: &[(Vector3<f32>, f32)], of_mesh: &[Vector3<f32>]) -> Vec<f64> {
    let segments = || 1..of_mesh.len();
    let Some(main) = segments().max_by(|a, b| seen[*a].1.total_cmp(&seen[*b].1)) else {
        return Vec::new();
    };
    let cosine = |segment: usize| {
        let shown = seen[segment].0 - seen[main].0;
        let expected = of_mesh[segment] - of_mesh[main];
        let cosine = shown.dot(&expected) / (shown.norm() * expected.norm());
        if segment == main || seen[segment].1 < 1.0 || !cosine.is_finite() {
            1.0
        } else {
            f64::from(cosine)
        }
    };
    segments().map(cosine).collect()
}
