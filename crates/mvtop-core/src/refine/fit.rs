//! How well the images fit a pose: enough to choose between two that are near each other, and, of the
//! one that is chosen, its quality.

use nalgebra::Isometry3;
use rayon::prelude::*;

use super::working::Working;
use super::{Quality, Refiner, ViewQuality, explained, region};

/// An edge that is found within this of where it is expected is supported, px.
const SUPPORTED: f64 = 1.5;
/// An edge is not supported where its place is less certain than this, px².
const UNSURE: f64 = 4.0;
/// Step at which poses are compared, px.
const COMPARED: f64 = 1.5;
/// How much worse one kind of edges may fit where another fits better, bits.
const WORSE: f64 = 0.05;

/// How well the images fit a pose.
pub struct Fit {
    /// Of all views, bits: by the outline, and by what lies within it.
    separation: [f64; 2],
    /// Of the views that show the outline; at least one.
    shown: Vec<Shown>,
}

/// How well one view does.
struct Shown {
    /// Its place among those at work.
    place: usize,
    /// Share of the edge points that are where they should be.
    supported: f64,
    /// Mean distance of the edges, px of the close-up.
    residual_px: f64,
}

impl Fit {
    /// Whether it fits better than another pose nearby.
    pub fn is_better(&self, other: &Self) -> bool {
        // What lies within may not be given up for the outline, nor the other way round.
        let better = |i: usize| self.separation[i] - other.separation[i];
        better(0) + better(1) > 0.0 && better(0).min(better(1)) > -WORSE
    }

    /// Share of the edge points that the images show, mean over views.
    pub fn supported(&self) -> f64 {
        self.mean(|view| view.supported)
    }

    /// Mean distance of the edges from where the images show them, px of the close-ups.
    pub fn residual_px(&self) -> f64 {
        self.mean(|view| view.residual_px)
    }

    fn mean(&self, number: impl Fn(&Shown) -> f64) -> f64 {
        self.shown.iter().map(number).sum::<f64>() / self.shown.len() as f64
    }
}

impl Refiner {
    /// Looks at a pose; `None` where no outline can be seen.
    pub(super) fn fit(&self, working: &mut [Working], pose: &Isometry3<f64>) -> Option<Fit> {
        let tints = &self.part.tints;
        let views: Vec<(Shown, [Option<f64>; 2])> = working
            .par_iter_mut()
            .enumerate()
            .map(|(place, view)| {
                view.look(self, pose, 1.0);
                let Working {
                    picture,
                    colors,
                    raster,
                    points,
                    rows,
                    ..
                } = &*view;
                let count = rows.len().max(1) as f64;
                let near = rows
                    .iter()
                    .filter(|row| is_supported(row.offset, row.variance));
                let shown = Shown {
                    place,
                    supported: near.count() as f64 / count,
                    residual_px: rows.iter().map(|row| row.offset.abs()).sum::<f64>() / count,
                };
                let bits = region::separation(picture, colors, raster, points, COMPARED, tints);
                (shown, bits)
            })
            .collect();
        let separation = [0, 1].map(|i| {
            let known = || views.iter().filter_map(|(_, bits)| bits[i]);
            known().sum::<f64>() / known().count().max(1) as f64
        });
        let shown = views.into_iter().filter(|(_, bits)| bits[0].is_some());
        let shown: Vec<Shown> = shown.map(|(view, _)| view).collect();
        (!shown.is_empty()).then_some(Fit { separation, shown })
    }

    /// - `fit`: of the pose that the views looked at last
    pub(super) fn quality_of(
        &self,
        working: &[Working],
        fit: &Fit,
        pose: &Isometry3<f64>,
    ) -> Quality {
        let tints = &self.part.tints;
        let of_view = |shown: &Shown| {
            let view = &working[shown.place];
            let Working {
                picture,
                colors,
                raster,
                points,
                ..
            } = view;
            ViewQuality {
                view: view.index,
                supported: shown.supported,
                residual_px: shown.residual_px / view.scale,
                overlap: region::overlap(picture, colors, raster, points).unwrap_or(0.0),
                explained: explained::explained(picture, colors, raster, points, tints),
                print: self.print.as_ref().and_then(|print| print.seen(view, pose)),
            }
        };
        Quality {
            views: fit.shown.par_iter().map(of_view).collect(),
        }
    }
}

/// Whether an edge that was found so far off and so exactly, px and px², is where it should be.
pub fn is_supported(offset: f64, variance: f64) -> bool {
    offset.abs() < SUPPORTED && variance < UNSURE
}
