//! How likely a pixel's color is in each part of the picture, and where along a line one part ends.

use std::sync::LazyLock;

use nalgebra::Vector3;

use super::contour::EdgePoint;
use super::part::BACKGROUND;
use super::picture::{BINS, LEVELS, Picture, UNKNOWN};
use super::raster::Raster;

/// How far from the outline the background is looked at, px.
pub const AROUND: usize = 24;
/// How far, in shares of the brightness, a tint is from another part's where either is as likely.
const TINTED: f32 = 0.06;
/// Greatest odds by the tint, as a logarithm.
const BY_TINT: f64 = 2.0;
/// Steps of a line to each side.
pub const REACH: i32 = 8;
/// Steps to each side within which the edge is searched for.
pub const SEARCHED: i32 = 5;
const PLACES: usize = 2 * SEARCHED as usize + 1;
/// Square of the change of color, of 1, that counts as much as none: noise has some.
const FLAT: f64 = 1e-4;
/// The same on lines of longer steps than this, px: they cross other edges as well, so what changes
/// counts less there.
const FLAT_LONG: f64 = 1e-3;
const SHORT: f64 = 2.5;
/// Share of a color that is not seen in a part.
const UNSEEN: f32 = 1e-5;
/// How sure a pixel's color is at most of its part: lines are never certain of themselves.
const SURE: f64 = 0.43;

/// How likely a pixel is of the side within, by how many steps farther out the edge is, from
/// `-REACH - SEARCHED` on.
static INNER: LazyLock<[f64; 2 * (REACH + SEARCHED) as usize + 1]> = LazyLock::new(|| {
    std::array::from_fn(|i| 0.5 + SURE * (i as f64 - f64::from(REACH + SEARCHED)).tanh())
});

/// What is found along a line across an edge.
#[derive(Debug, Clone, Copy)]
pub struct Found {
    /// How far outwards of where it was expected the edge is, px.
    pub offset: f64,
    /// Variance of that, px².
    pub variance: f64,
}

/// How often each color is seen in each part.
#[derive(Default, Clone)]
pub struct Colors {
    /// By label, then by bin; the sum over the bins is 1.
    shares: Vec<Vec<f32>>,
    /// Their logarithms.
    logs: Vec<Vec<f32>>,
    /// By label: mean tint of what shows it, and of how many pixels.
    pub tints: Vec<(Vector3<f32>, f32)>,
    scratch: Vec<f32>,
}

impl Colors {
    /// Counts anew where the parts are now.
    ///
    /// - `labels`: how many there are
    pub fn count(
        &mut self,
        picture: &Picture,
        raster: &Raster,
        points: &[EdgePoint],
        labels: usize,
    ) {
        self.tints.clear();
        self.tints.resize(labels, (Vector3::zeros(), 0.0));
        self.shares.resize_with(labels, Vec::new);
        for share in &mut self.shares {
            share.clear();
            share.resize(BINS, 0.0);
        }
        for (label, pixels) in raster.runs() {
            // Only parts are told from each other by them.
            if labels > 2 {
                let sum: Vector3<f32> = picture.tints()[pixels.clone()].iter().sum();
                let tints = &mut self.tints[usize::from(label)];
                // The shares of each pixel are 1 together.
                *tints = (tints.0 + sum, tints.1 + sum.sum());
            }
            let share = &mut self.shares[usize::from(label)];
            for &bin in picture.bins[pixels].iter().filter(|bin| **bin != UNKNOWN) {
                share[usize::from(bin)] += 1.0;
            }
        }
        for (tint, count) in &mut self.tints {
            *tint /= count.max(1.0);
        }
        let background = &mut self.shares[usize::from(BACKGROUND)];
        for bin in beside(picture, raster, points) {
            background[bin] += 1.0;
        }
        for share in &mut self.shares {
            spread(share, &mut self.scratch);
            let sum: f32 = share.iter().sum();
            if sum > 0.0 {
                share.iter_mut().for_each(|x| *x /= sum);
            }
        }
        self.logs.resize_with(labels, Vec::new);
        let none = UNSEEN.ln();
        for (logs, share) in self.logs.iter_mut().zip(&self.shares) {
            let log = |share: &f32| {
                if *share > 0.0 {
                    (share + UNSEEN).ln()
                } else {
                    none
                }
            };
            logs.clear();
            logs.extend(share.iter().map(log));
        }
    }

    /// Odds that a pixel is of the first of two parts, as a logarithm: by where colors are seen, and
    /// between two parts of the object by the colors that these have.
    fn odds(&self, picture: &Picture, index: usize, sides: [u8; 2], tints: &[Vector3<f32>]) -> f64 {
        let bin = usize::from(picture.bins[index]);
        let [a, b] = sides.map(|s| f64::from(self.logs[usize::from(s)][bin]));
        let odds = a - b;
        if sides.contains(&BACKGROUND) {
            return odds;
        }
        // The larger part's tint is known from the image, whatever light there is; the other one's
        // differs from it in a direction that the mesh says.
        let [first, second] = sides.map(usize::from);
        let (known, other, sign) = match self.tints[first].1 > self.tints[second].1 {
            true => (first, second, -1.0),
            false => (second, first, 1.0),
        };
        let apart = (tints[other] - tints[known]).normalize();
        let tint = picture.tints()[index];
        if tint == Vector3::zeros() {
            return odds;
        }
        let along = (tint - self.tints[known].0).dot(&apart);
        let by_tint = f64::from((along - TINTED) / TINTED).clamp(-1.0, 1.0) * BY_TINT;
        // Not a number where the mesh's tints are one.
        odds + if by_tint.is_finite() {
            sign * by_tint
        } else {
            0.0
        }
    }
}

/// Bins of the background's pixels next to the outline.
fn beside<'a>(
    picture: &'a Picture,
    raster: &'a Raster,
    points: &'a [EdgePoint],
) -> impl Iterator<Item = usize> + 'a {
    let outline = points.iter().filter(|point| point.is_outline());
    let places =
        outline.flat_map(|point| (1..=AROUND).map(|step| point.pixel + point.normal * step as f64));
    places.filter_map(|at| {
        let index = raster.index(at)?;
        let shown = picture.bins[index] != UNKNOWN && raster.label(index) == BACKGROUND;
        shown.then(|| usize::from(picture.bins[index]))
    })
}

/// Shares some of each bin's count with its neighbours, so that few pixels tell of more colors.
fn spread(bins: &mut Vec<f32>, scratch: &mut Vec<f32>) {
    spread_along::<1>(bins, scratch);
    spread_along::<LEVELS>(bins, scratch);
    spread_along::<{ LEVELS * LEVELS }>(bins, scratch);
}

/// Along one channel, whose levels are `STRIDE` bins apart.
fn spread_along<const STRIDE: usize>(bins: &mut Vec<f32>, scratch: &mut Vec<f32>) {
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

/// Where the edge is along the line through a point: where the color changes, and by the regions to
/// both sides of it, where these differ.
///
/// Source: Stoiber et al., "SRT3D: A Sparse Region-Based 3D Object Tracking Approach for the Real
/// World", 2022, for regions: the probability of every place of the edge, given the pixels.
///
/// - `step`: px between what is looked at
/// - `tints`: of the mesh, by label
pub fn find(
    picture: &Picture,
    colors: &Colors,
    raster: &Raster,
    point: &EdgePoint,
    step: f64,
    tints: &[Vector3<f32>],
) -> Option<Found> {
    debug_assert_eq!(picture.size, raster.size);
    let mut weights = picture
        .changes::<PLACES>(point.pixel, point.normal, step)
        .map(|change| match point.parts_regions() && step > SHORT {
            true => (change + FLAT_LONG).sqrt(),
            false => change + FLAT,
        });
    if point.parts_regions() {
        let within = line(picture, colors, raster, point, step, tints)?;
        let inner = &*INNER;
        for (i, p) in within.iter().enumerate() {
            let Some(p) = p else {
                continue;
            };
            let farther = &inner[2 * REACH as usize - i..];
            for (weight, inner) in weights.iter_mut().zip(farther) {
                *weight *= inner * p + (1.0 - inner) * (1.0 - p);
            }
        }
    }
    let sum: f64 = weights.iter().sum();
    let places = || (-SEARCHED..=SEARCHED).map(f64::from).zip(&weights);
    let mean = places().map(|(place, weight)| place * weight).sum::<f64>() / sum;
    let off = |place: f64| (place - mean) * (place - mean);
    let variance = places()
        .map(|(place, weight)| off(place) * weight)
        .sum::<f64>()
        / sum;
    let found = Found {
        offset: mean * step,
        // No line is more exact than its steps.
        variance: (variance + 0.1) * step * step,
    };
    found.offset.is_finite().then_some(found)
}

/// Along a line, from within outwards: the probability that a step shows the side within; `None`
/// where it is of neither side, by the pose as it is, or off the image.
fn line(
    picture: &Picture,
    colors: &Colors,
    raster: &Raster,
    point: &EdgePoint,
    step: f64,
    tints: &[Vector3<f32>],
) -> Option<[Option<f64>; 2 * REACH as usize + 1]> {
    let mut within = [None; 2 * REACH as usize + 1];
    let middle = REACH as usize;
    let mut known = 0;
    let pixels = step.ceil() as i32;
    for (direction, side) in [(-1, point.sides[0]), (1, point.sides[1])] {
        'side: for i in 0..=REACH {
            if i == 0 && direction == 1 {
                continue;
            }
            // The mean of what lies between this step and the next, as odds.
            let (mut odds, mut count) = (0.0, 0);
            for j in 0..pixels {
                let along = f64::from(i) * f64::from(direction)
                    + (f64::from(j) + 0.5) / f64::from(pixels)
                    - 0.5;
                let Some(index) = raster.index(point.pixel + point.normal * (along * step)) else {
                    break 'side;
                };
                // Next to the edge the other side's pixels are expected as well.
                if i > 1 && raster.label(index) != side {
                    break 'side;
                }
                let bin = picture.bins[index];
                if bin != UNKNOWN {
                    odds += colors.odds(picture, index, point.sides, tints);
                    count += 1;
                }
            }
            if count > 0 {
                let odds = odds / f64::from(count);
                let place = middle as i32 + i * direction;
                within[place as usize] = Some(1.0 / (1.0 + (-odds).exp()));
                known += 1;
            }
        }
    }
    (known >= 4).then_some(within)
}

/// How well colors tell the two sides of the edges apart, in bits per pixel looked at: 1 where they
/// do so everywhere, 0 or less where they do not. Of the outline, and of what lies within it.
pub fn separation(
    picture: &Picture,
    colors: &Colors,
    raster: &Raster,
    points: &[EdgePoint],
    step: f64,
    tints: &[Vector3<f32>],
) -> [Option<f64>; 2] {
    [true, false].map(|outline| {
        let (mut bits, mut count) = (0.0, 0.0);
        let wanted = |point: &&EdgePoint| point.parts_regions() && point.is_outline() == outline;
        for point in points.iter().filter(wanted) {
            let Some(within) = line(picture, colors, raster, point, step, tints) else {
                continue;
            };
            for (i, p) in (-REACH..=REACH).zip(within) {
                if let Some(p) = p
                    && i != 0
                {
                    let right = if i < 0 { p } else { 1.0 - p };
                    bits += 1.0 + right.max(1e-3).log2();
                    count += 1.0;
                }
            }
        }
        (count > 0.0).then(|| bits / count)
    })
}

/// How well colors tell the object from what is next to it: how likely a pixel within its outline is
/// of the object, less how likely one next to it is; 1 where they do so everywhere, 0 where they do
/// not. `None` where no outline is seen.
pub fn overlap(
    picture: &Picture,
    colors: &Colors,
    raster: &Raster,
    points: &[EdgePoint],
) -> Option<f64> {
    let (background, parts) = colors.shares.split_first()?;
    let of_object = |bin: usize| {
        let most = parts.iter().map(|share| share[bin]).fold(0.0, f32::max) + UNSEEN;
        f64::from(most / (most + background[bin] + UNSEEN))
    };
    let within = picture.bins.iter().zip(raster.labels());
    let within = within.filter(|(bin, label)| **bin != UNKNOWN && **label != BACKGROUND);
    let within = mean(within.map(|(&bin, _)| of_object(usize::from(bin))))?;
    Some(within - mean(beside(picture, raster, points).map(of_object))?)
}

/// `None` of nothing.
fn mean(numbers: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = numbers.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}
