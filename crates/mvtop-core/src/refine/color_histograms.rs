//! Color histograms of the segments of an object and of the background around it.

use nalgebra::Vector3;

use super::contour::EdgePoint;
use super::crop_pixels::{BINS, CropPixels, LEVELS, UNKNOWN};
use super::mesh_model::BACKGROUND;
use super::raster::Raster;
use super::view_state::ViewState;

/// Share of a color that a histogram does not contain.
const FLOOR: f32 = 1e-5;

/// Color histogram of each segment.
#[derive(Default)]
pub struct ColorHistograms {
    /// By segment, then by bin; the sum over the bins is 1.
    shares: Vec<Vec<f32>>,
    /// Their logarithms.
    logs: Vec<Vec<f32>>,
    /// Mean chromaticity of each segment, and the number of its pixels.
    pub chromaticities: Vec<(Vector3<f32>, f32)>,
    scratch: Vec<f32>,
    /// Segment of each pixel, as counted.
    counted: Vec<u8>,
    /// By segment, then by bin: its pixels, but none of the background.
    counts: Vec<Vec<f32>>,
}

impl ColorHistograms {
    /// Counts for the segments in a raster: again those pixels alone whose segment is another one.
    ///
    /// - `pixels`: the same at each call
    /// - `segments`: their number, the background included
    /// - `background`: bins of the background's pixels
    pub fn count(
        &mut self,
        pixels: &CropPixels,
        raster: &Raster,
        segments: usize,
        background: impl Iterator<Item = usize>,
    ) {
        self.chromaticities.clear();
        self.chromaticities
            .resize(segments, (Vector3::zeros(), 0.0));
        self.recount(pixels, raster, segments);
        self.shares.resize_with(segments, Vec::new);
        for (share, counts) in self.shares.iter_mut().zip(&self.counts) {
            share.clone_from(counts);
        }
        // Chromaticities only distinguish segments of the object.
        for (segment, run) in raster.runs().filter(|_| segments > 2) {
            let sum: Vector3<f32> = pixels.chromaticities()[run].iter().sum();
            let mean = &mut self.chromaticities[usize::from(segment)];
            // The shares of each pixel add up to 1.
            *mean = (mean.0 + sum, mean.1 + sum.sum());
        }
        for (mean, count) in &mut self.chromaticities {
            *mean /= count.max(1.0);
        }
        background.for_each(|bin| self.shares[usize::from(BACKGROUND)][bin] += 1.0);
        self.logs.resize_with(segments, Vec::new);
        for (share, logs) in self.shares.iter_mut().zip(&mut self.logs) {
            smooth(share, &mut self.scratch);
            let sum: f32 = share.iter().sum();
            if sum > 0.0 {
                share.iter_mut().for_each(|x| *x /= sum);
            }
            let none = FLOOR.ln();
            let log = |share: &f32| match *share > 0.0 {
                true => (share + FLOOR).ln(),
                false => none,
            };
            logs.clear();
            logs.extend(share.iter().map(log));
        }
    }

    /// Brings `counts` to the segments in a raster.
    fn recount(&mut self, pixels: &CropPixels, raster: &Raster, segments: usize) {
        const MANY: usize = 32;
        let labels = raster.labels();
        if self.counted.len() != labels.len() || self.counts.len() != segments {
            self.counted = vec![BACKGROUND; labels.len()];
            self.counts = vec![vec![0.0; BINS]; segments];
        }
        let old = self.counted.chunks_mut(MANY);
        let many = labels.chunks(MANY).zip(old).zip(pixels.bins.chunks(MANY));
        for ((labels, counted), bins) in many {
            if labels == counted {
                continue;
            }
            for ((&label, counted), &bin) in labels.iter().zip(counted).zip(bins) {
                let before = std::mem::replace(counted, label);
                if before == label || bin == UNKNOWN {
                    continue;
                }
                for (segment, by) in [(before, -1.0), (label, 1.0)] {
                    if segment != BACKGROUND {
                        self.counts[usize::from(segment)][usize::from(bin)] += by;
                    }
                }
            }
        }
    }

    /// Probability that a color belongs to the object rather than to the background.
    fn of_object(&self, bin: usize) -> f64 {
        let (background, segments) = (&self.shares[0], &self.shares[1..]);
        let most = segments.iter().map(|share| share[bin]).fold(0.0, f32::max) + FLOOR;
        f64::from(most / (most + background[bin] + FLOOR))
    }
}

impl ViewState<'_> {
    /// Bins of the background's pixels in a band around the outline.
    pub fn background_bins(&self) -> impl Iterator<Item = usize> {
        let band = self.refiner.config.background_band_px;
        background_bins(&self.pixels, &self.raster, &self.points, band)
    }

    /// Log-odds that a pixel belongs to the first of two segments: by the histograms, and between
    /// segments of the object also by their chromaticities.
    pub fn log_odds(&self, index: usize, sides: [u8; 2]) -> f64 {
        let histograms = &self.histograms;
        let bin = usize::from(self.pixels.bins[index]);
        let [a, b] = sides.map(|s| f64::from(histograms.logs[usize::from(s)][bin]));
        let odds = a - b;
        if sides.contains(&BACKGROUND) {
            return odds;
        }
        // The image gives the larger segment's chromaticity under its light. The mesh gives the
        // direction in which the other one differs.
        let [first, second] = sides.map(usize::from);
        let means = &histograms.chromaticities;
        let (known, other, sign) = match means[first].1 > means[second].1 {
            true => (first, second, -1.0),
            false => (second, first, 1.0),
        };
        let of_mesh = &self.refiner.mesh.chromaticities;
        let direction = (of_mesh[other] - of_mesh[known]).normalize();
        let pixel = self.pixels.chromaticities()[index];
        if pixel == Vector3::zeros() {
            return odds;
        }
        let along = (pixel - means[known].0).dot(&direction);
        let [equal, most] = self.refiner.config.chromaticity;
        let equal = equal as f32;
        let by_chromaticity = f64::from((along - equal) / equal).clamp(-1.0, 1.0) * most;
        // NaN if the mesh's chromaticities are equal.
        odds + if by_chromaticity.is_finite() {
            sign * by_chromaticity
        } else {
            0.0
        }
    }

    /// Mean probability of belonging to the object, by color, of the silhouette's pixels less that of
    /// the background's: 1 if colors separate them everywhere. `None` without an outline.
    pub fn color_separation(&self) -> Option<f64> {
        let of_object = |bin: usize| self.histograms.of_object(bin);
        let pixels = self.pixels.bins.iter().zip(self.raster.labels());
        let within = pixels.filter(|(bin, label)| **bin != UNKNOWN && **label != BACKGROUND);
        let within = mean(within.map(|(&bin, _)| of_object(usize::from(bin))))?;
        Some(within - mean(self.background_bins().map(of_object))?)
    }
}

/// See [`ViewState::background_bins`].
pub fn background_bins<'a>(
    pixels: &'a CropPixels,
    raster: &'a Raster,
    points: &'a [EdgePoint],
    band: usize,
) -> impl Iterator<Item = usize> + 'a {
    let outline = points.iter().filter(|point| point.is_outline());
    let places = outline
        .flat_map(move |point| (1..=band).map(|step| point.pixel + point.normal * step as f64));
    places.filter_map(|at| {
        let index = raster.index(at)?;
        let known = pixels.bins[index] != UNKNOWN && raster.label(index) == BACKGROUND;
        known.then(|| usize::from(pixels.bins[index]))
    })
}

/// Smooths a histogram along each channel.
fn smooth(bins: &mut Vec<f32>, scratch: &mut Vec<f32>) {
    smooth_along::<1>(bins, scratch);
    smooth_along::<LEVELS>(bins, scratch);
    smooth_along::<{ LEVELS * LEVELS }>(bins, scratch);
}

/// Smooths along the channel whose levels are `STRIDE` bins apart.
fn smooth_along<const STRIDE: usize>(bins: &mut Vec<f32>, scratch: &mut Vec<f32>) {
    scratch.resize(bins.len(), 0.0);
    let channels = bins.chunks_exact(STRIDE * LEVELS);
    for (from, to) in channels.zip(scratch.chunks_exact_mut(STRIDE * LEVELS)) {
        for level in 0..LEVELS {
            let of_level = |level: usize| &from[level * STRIDE..][..STRIDE];
            let (below, own) = (of_level(level.saturating_sub(1)), of_level(level));
            let above = of_level((level + 1).min(LEVELS - 1));
            for (i, to) in to[level * STRIDE..][..STRIDE].iter_mut().enumerate() {
                *to = 0.25 * below[i] + 0.5 * own[i] + 0.25 * above[i];
            }
        }
    }
    std::mem::swap(bins, scratch);
}

/// `None` without numbers.
fn mean(numbers: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = numbers.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}
