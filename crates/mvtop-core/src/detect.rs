//! Boxes from the detector's score and box maps: local maxima, then non-maximum suppression.

use ndarray::{ArrayView2, ArrayView3};

/// Objects of one class kept in one view; bounds the work of [`crate::associate`] on any map.
const MAX_PER_CLASS: usize = 50;

/// Boxes that are thinner than this carry no direction worth reading.
const MIN_SIDE_PX: f64 = 1.0;

/// One object seen in one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// Index into the bundle's classes.
    pub class: usize,
    /// Between 0 and 1.
    pub score: f64,
    /// `[x0, y0, x1, y1]`, px; of the network's input in [`peaks`], of the camera's image elsewhere.
    pub bbox: [f64; 4],
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
                let bbox = [0, 1, 2, 3].map(|side| {
                    boxes
                        .get((side, row, column))
                        .map_or(f64::NAN, |&value| f64::from(value))
                });
                let score = f64::from(map[(row, column)]);
                is_box(&bbox).then_some(Detection { class, score, bbox })
            })
            .collect();
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
        kept.extend(suppress(candidates, nms_iou));
    }
    kept.sort_by(|a, b| b.score.total_cmp(&a.score));
    kept
}

/// The box within the image, or `None` where nothing of it is left.
///
/// The image spans `[-0.5, width - 0.5]` by `[-0.5, height - 0.5]` px, pixel centers being integers.
pub fn clip(bbox: [f64; 4], width: u32, height: u32) -> Option<[f64; 4]> {
    let (right, bottom) = (f64::from(width) - 0.5, f64::from(height) - 0.5);
    let clipped = [
        bbox[0].clamp(-0.5, right),
        bbox[1].clamp(-0.5, bottom),
        bbox[2].clamp(-0.5, right),
        bbox[3].clamp(-0.5, bottom),
    ];
    let wide_enough = clipped[2] - clipped[0] >= MIN_SIDE_PX;
    let high_enough = clipped[3] - clipped[1] >= MIN_SIDE_PX;
    (is_box(&clipped) && wide_enough && high_enough).then_some(clipped)
}

/// Area shared by two boxes over the area they cover together, 0 to 1.
pub fn iou(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    let area = |r: &[f64; 4]| (r[2] - r[0]).max(0.0) * (r[3] - r[1]).max(0.0);
    let shared = area(&[
        a[0].max(b[0]),
        a[1].max(b[1]),
        a[2].min(b[2]),
        a[3].min(b[3]),
    ]);
    let covered = area(a) + area(b) - shared;
    if covered > 0.0 { shared / covered } else { 0.0 }
}

fn is_box(bbox: &[f64; 4]) -> bool {
    bbox.iter().all(|side| side.is_finite()) && bbox[0] < bbox[2] && bbox[1] < bbox[3]
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
            .all(|better| iou(&better.bbox, &candidate.bbox) <= max_iou)
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
        assert_eq!(found[0].bbox, [30., 20., 44., 30.]);
        assert!((found[0].score - 0.9).abs() < 1e-6);
        assert_eq!(found[1].bbox, [0., 0., 8., 8.]);
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
        assert_eq!(found[0].bbox, [0., 0., 8., 8.]);
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
    fn iou_of_half_shifted_squares_is_one_third() {
        let shifted = iou(&[0., 0., 2., 2.], &[1., 0., 3., 2.]);
        assert!((shifted - 1. / 3.).abs() < 1e-12);
        assert_eq!(iou(&[0., 0., 2., 2.], &[2., 0., 4., 2.]), 0.0);
        assert_eq!(iou(&[0., 0., 0., 0.], &[0., 0., 0., 0.]), 0.0);
    }

    #[test]
    fn clip_keeps_the_part_inside_the_image() {
        assert_eq!(clip([-9., 2., 5., 99.], 10, 8), Some([-0.5, 2., 5., 7.5]));
        assert_eq!(clip([20., 2., 30., 5.], 10, 8), None);
        assert_eq!(clip([f64::NAN, 2., 5., 6.], 10, 8), None);
        assert_eq!(clip([3., 2., 3.4, 6.], 10, 8), None);
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
