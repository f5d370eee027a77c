//! How much of a picture's colors a pose explains: to choose among poses that are far from each
//! other, of which the edges alone may fit by chance.

use nalgebra::Vector3;

use super::contour::EdgePoint;
use super::part::BACKGROUND;
use super::picture::{BINS, LEVELS, Picture, UNKNOWN};
use super::raster::Raster;
use super::region::{AROUND, Colors};

/// Colors are counted in half as many levels as for single edges.
const COARSE: usize = LEVELS / 2;

/// What knowing the part tells of a pixel's color (mutual information), bits per pixel: of object and
/// background along the outline, and of the parts of the object. Parts whose tint differs from the
/// largest one's in another direction than the mesh's do count against the pose.
///
/// - `colors`: counted on the raster
/// - `tints`: of the mesh, by label
pub fn explained(
    picture: &Picture,
    colors: &Colors,
    raster: &Raster,
    points: &[EdgePoint],
    tints: &[Vector3<f32>],
) -> f64 {
    let mut counts = vec![vec![0.0; COARSE * COARSE * COARSE]; tints.len()];
    let mut count = |label: u8, index: usize| {
        if picture.bins[index] != UNKNOWN {
            counts[usize::from(label)][coarse(picture.bins[index])] += 1.0;
        }
    };
    for (label, pixels) in raster.runs() {
        pixels.for_each(|index| count(label, index));
    }
    for point in points.iter().filter(|point| point.is_outline()) {
        for step in 1..=AROUND {
            let at = point.pixel + point.normal * step as f64;
            if let Some(index) = raster.index(at)
                && raster.label(index) == BACKGROUND
            {
                count(BACKGROUND, index);
            }
        }
    }
    let (around, parts) = counts.split_at(1);
    let mut object = vec![0.0; around[0].len()];
    for part in parts {
        object.iter_mut().zip(part).for_each(|(sum, x)| *sum += x);
    }
    let outline: f64 = told(&[&around[0], &object]).iter().sum();
    let parts: Vec<&Vec<f64>> = parts.iter().collect();
    let within = told(&parts).into_iter().zip(alike(colors, tints));
    outline + within.map(|(bits, alike)| bits * alike).sum::<f64>()
}

fn coarse(bin: u16) -> usize {
    debug_assert!(usize::from(bin) < BINS);
    let bin = usize::from(bin);
    let level = |stride: usize| bin / stride % LEVELS * COARSE / LEVELS;
    (level(LEVELS * LEVELS) * COARSE + level(LEVELS)) * COARSE + level(1)
}

/// What each part adds to the mutual information of part and color, bits: how far its colors are from
/// those of all together, by its share of the pixels. Less what as many pixels would seem to tell by
/// chance (Miller 1955).
fn told(counts: &[&Vec<f64>]) -> Vec<f64> {
    let sums: Vec<f64> = counts.iter().map(|part| part.iter().sum()).collect();
    let total: f64 = sums.iter().sum();
    let of_bin: Vec<f64> = (0..counts[0].len())
        .map(|bin| counts.iter().map(|part| part[bin]).sum())
        .collect();
    let part = |(part, sum): (&&Vec<f64>, &f64)| {
        let (mut bits, mut used) = (0.0, 0.0);
        for (count, all) in part.iter().zip(&of_bin).filter(|(count, _)| **count > 0.0) {
            bits += count / total * ((count / sum) / (all / total)).log2();
            used += 1.0;
        }
        bits - used / (2.0 * total.max(1.0) * std::f64::consts::LN_2)
    };
    counts.iter().zip(&sums).map(part).collect()
}

/// Of each part of the object, whether its tint differs from the largest one's in the direction in
/// which the mesh's does, as a cosine; 1 for the largest and where nothing is known.
fn alike(colors: &Colors, tints: &[Vector3<f32>]) -> Vec<f64> {
    let seen = &colors.tints;
    let parts = || 1..tints.len();
    let Some(main) = parts().max_by(|a, b| seen[*a].1.total_cmp(&seen[*b].1)) else {
        return Vec::new();
    };
    let cosine = |label: usize| {
        let (shown, meant) = (seen[label].0 - seen[main].0, tints[label] - tints[main]);
        let cosine = shown.dot(&meant) / (shown.norm() * meant.norm());
        if label == main || seen[label].1 < 1.0 || !cosine.is_finite() {
            1.0
        } else {
            f64::from(cosine)
        }
    };
    parts().map(cosine).collect()
}
