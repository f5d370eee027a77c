//! Boxes from the detector's score and box maps: local maxima, then non-maximum suppression.

use std::collections::BTreeSet;

use ndarray::{ArrayView2, ArrayView3};

use crate::BBox;

/// Objects of one class kept in one view; bounds the work of [`crate::associate`] on any map.
const MAX_PER_CLASS: usize = 50;

/// One object seen in one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// Index into the bundle's classes.
    pub class: usize,
    /// Between 0 and 1.
    pub score: f64,
    /// Of the network's input in [`peaks`], of the camera's image elsewhere.
    pub bbox: BBox,
}

/// Detections of one view, best first, in pixels of the network's input.
///
/// A cell is taken where its score is at least `score_threshold` and the greatest of its 3x3
/// neighbourhood (of equals, the first in row-major order); of two boxes of a class that overlap
/// by more than `nms_iou`, the better stays. Cells whose score or box is not finite are skipped.
///
/// - `scores`: `[C, h, w]`, 0 to 1
/// - `boxes`: `[4, h, w]`, x0 y0 x1 y1, px of the network's input
pub fn peaks(
    scores: ArrayView3<f32>,
    boxes: ArrayView3<f32>,
    score_threshold: f64,
    nms_iou: f64,
) -> Vec<Detection> {
    let mut kept = Vec::new();
    for (class, map) in scores.outer_iter().enumerate() {
        let mut candidates: Vec<Detection> = local_maxima(map, score_threshold)
            .into_iter()
            .filter_map(|(row, column)| {
                let bbox = BBox::from([0, 1, 2, 3].map(|side| {
                    boxes
                        .get((side, row, column))
                        .map_or(f64::NAN, |&value| f64::from(value))
                }));
                let score = f64::from(map[(row, column)]);
                bbox.is_proper().then_some(Detection { class, score, bbox })
            })
            .collect();
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
        kept.extend(suppress(candidates, nms_iou));
    }
    kept.sort_by(|a, b| b.score.total_cmp(&a.score));
    kept
}

/// Boxes of one view from several pictures of it, best first: of two of a class that overlap by more
/// than `nms_iou`, the better stays.
pub(crate) fn merged(mut boxes: Vec<Detection>, nms_iou: f64) -> Vec<Detection> {
    boxes.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<Detection> = Vec::new();
    for class in boxes.iter().map(|one| one.class).collect::<BTreeSet<_>>() {
        let of_class = boxes.iter().filter(|one| one.class == class).copied();
        kept.extend(suppress(of_class.collect(), nms_iou));
    }
    kept.sort_by(|a, b| b.score.total_cmp(&a.score));
    kept
}

fn local_maxima(map: ArrayView2<f32>, threshold: f64) -> Vec<(usize, usize)> {
    let (rows, columns) = map.dim();
    let beaten = |row: usize, column: usize, score: f32| {
        (row.saturating_sub(1)..(row + 2).min(rows)).any(|r| {
            (column.saturating_sub(1)..(column + 2).min(columns)).any(|c| {
                let other = map[(r, c)];
                other > score || (other == score && (r, c) < (row, column))
            })
        })
    };
    map.indexed_iter()
        .filter(|&((row, column), &score)| {
            score.is_finite() && f64::from(score) >= threshold && !beaten(row, column, score)
        })
        .map(|(cell, _)| cell)
        .collect()
}

/// Greedy non-maximum suppression of boxes sorted best first.
fn suppress(sorted: Vec<Detection>, max_iou: f64) -> Vec<Detection> {
    let mut kept: Vec<Detection> = Vec::new();
    for candidate in sorted {
        if kept.len() == MAX_PER_CLASS {
            break;
        }
        if kept
            .iter()
            .all(|better| better.bbox.iou(&candidate.bbox) <= max_iou)
        {
            kept.push(candidate);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array3, array};

    /// Maps of `h x w` cells where each listed cell holds a score and a box; others are 0.
    fn maps(
        shape: (usize, usize, usize),
        cells: &[(usize, usize, usize, f32, [f32; 4])],
    ) -> (Array3<f32>, Array3<f32>) {
        let mut scores = Array3::zeros(shape);
        let mut boxes = Array3::zeros((4, shape.1, shape.2));
        for &(class, row, column, score, bbox) in cells {
            scores[(class, row, column)] = score;
            for (side, value) in bbox.into_iter().enumerate() {
                boxes[(side, row, column)] = value;
            }
        }
        (scores, boxes)
    }

    #[test]
    fn two_distant_peaks_are_two_detections_best_first() {
        let (scores, boxes) = maps(
            (1, 4, 6),
            &[
                (0, 0, 0, 0.5, [0., 0., 8., 8.]),
                (0, 3, 5, 0.9, [30., 20., 44., 30.]),
            ],
        );
        let found = peaks(scores.view(), boxes.view(), 0.3, 0.5);
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].bbox, [30., 20., 44., 30.].into());
        assert!((found[0].score - 0.9).abs() < 1e-6);
        assert_eq!(found[1].bbox, [0., 0., 8., 8.].into());
    }

    #[test]
    fn neighbour_of_a_peak_and_cell_below_threshold_are_left_out() {
        let (scores, boxes) = maps(
            (1, 4, 6),
            &[
                (0, 1, 1, 0.9, [0., 0., 8., 8.]),
                (0, 2, 2, 0.8, [30., 20., 44., 30.]), // diagonal neighbour
                (0, 0, 5, 0.29, [40., 0., 44., 8.]),
            ],
        );
        let found = peaks(scores.view(), boxes.view(), 0.3, 0.5);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].bbox, [0., 0., 8., 8.].into());
    }

    #[test]
    fn plateau_gives_one_detection() {
        let scores = Array3::from_elem((1, 3, 3), 0.7f32);
        let mut boxes = Array3::zeros((4, 3, 3));
        boxes.slice_mut(ndarray::s![2.., .., ..]).fill(10.0);
        assert_eq!(peaks(scores.view(), boxes.view(), 0.3, 0.5).len(), 1);
    }

    #[test]
    fn overlapping_boxes_of_one_class_merge_and_of_two_classes_stay() {
        let near_twin = [1., 0., 11., 10.]; // shares 90 of 110 px² with the first
        let cells = [
            (0, 0, 0, 0.9, [0., 0., 10., 10.]),
            (0, 0, 4, 0.8, near_twin),
        ];
        let (scores, boxes) = maps((1, 1, 6), &cells);
        assert_eq!(peaks(scores.view(), boxes.view(), 0.3, 0.5).len(), 1);
        assert_eq!(peaks(scores.view(), boxes.view(), 0.3, 0.85).len(), 2);

        let cells = [
            (0, 0, 0, 0.9, [0., 0., 10., 10.]),
            (1, 0, 4, 0.8, near_twin),
        ];
        let (scores, boxes) = maps((2, 1, 6), &cells);
        let found = peaks(scores.view(), boxes.view(), 0.3, 0.5);
        assert_eq!(found.iter().map(|d| d.class).collect::<Vec<_>>(), [0, 1]);
    }

    #[test]
    fn cells_without_a_finite_box_or_score_are_skipped() {
        let (scores, boxes) = maps(
            (1, 1, 8),
            &[
                (0, 0, 0, 0.9, [f32::NAN, 0., 10., 10.]),
                (0, 0, 2, f32::NAN, [0., 0., 10., 10.]),
                (0, 0, 4, f32::INFINITY, [0., 0., 10., 10.]),
                (0, 0, 6, 0.8, [10., 0., 0., 10.]), // right of itself
            ],
        );
        assert!(peaks(scores.view(), boxes.view(), 0.3, 0.5).is_empty());
        // Fewer box planes than four: nothing to read, and no panic.
        let short = Array3::<f32>::zeros((3, 1, 8));
        assert!(peaks(scores.view(), short.view(), 0.3, 0.5).is_empty());
    }

    #[test]
    fn work_is_bounded_on_a_map_full_of_peaks() {
        let mut scores = Array3::zeros((1, 120, 160));
        let mut boxes = Array3::zeros((4, 120, 160));
        for ((_, row, column), score) in scores.indexed_iter_mut() {
            let corner = [column as f32 * 4., row as f32 * 4.];
            let bbox = array![corner[0], corner[1], corner[0] + 3., corner[1] + 3.];
            boxes.slice_mut(ndarray::s![.., row, column]).assign(&bbox);
            *score = if row % 2 == 0 && column % 2 == 0 {
                0.9f32
            } else {
                0.0
            };
        }
        assert_eq!(
            peaks(scores.view(), boxes.view(), 0.3, 0.5).len(),
            MAX_PER_CLASS
        );
    }
}
