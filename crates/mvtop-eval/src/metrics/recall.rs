//! From the errors of many poses to one number.
//!
//! Every function takes one error per true object, [`f64::INFINITY`] where it was not found, and
//! gives `None` for no object. A pose is correct where its error is below a threshold, not at it.
//!
//! There are several areas under the curve of recall over threshold ("AUC"); they differ by up to
//! some hundredths for few poses, and papers seldom say which they mean.

/// BOP's thresholds for MSSD, as shares of the object's diameter.
pub const MSSD_THRESHOLDS: [f64; 10] = [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5];
/// BOP's thresholds for MSSD in its industrial tasks, mm.
pub const MSSD_THRESHOLDS_MM: [f64; 10] = [2., 4., 6., 8., 10., 12., 14., 16., 18., 20.];
/// BOP's thresholds for VSD.
pub const VSD_THRESHOLDS: [f64; 10] = [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5];
/// BOP's thresholds for MSPD, px of an image 640 px wide; others in proportion to their width.
pub const MSPD_THRESHOLDS_PX: [f64; 10] = [5., 10., 15., 20., 25., 30., 35., 40., 45., 50.];

/// Share of errors below a threshold; at 0.1 diameters of ADD or ADD-(S), the usual "ADD recall".
pub fn recall(errors: &[f64], threshold: f64) -> Option<f64> {
    let correct = errors.iter().filter(|&&error| error < threshold).count();
    (!errors.is_empty()).then(|| correct as f64 / errors.len() as f64)
}

/// Mean of the recalls at several thresholds: BOP's average recall (AR) for one kind of error.
pub fn average_recall(errors: &[f64], thresholds: &[f64]) -> Option<f64> {
    let recalls: Option<Vec<f64>> = thresholds.iter().map(|&t| recall(errors, t)).collect();
    let recalls = recalls.filter(|recalls| !recalls.is_empty())?;
    Some(recalls.iter().sum::<f64>() / recalls.len() as f64)
}

/// BOP's average precision at one threshold: the mean, over the recalls 0, 0.01, ..., 1, of the
/// greatest precision at that recall or a greater one.
///
/// - `right`: whether each estimate is right, surest first
/// - `targets`: how many there are to find; `None` for none
///
/// Source: `calc_ap` of bop_toolkit, which has it from COCO.
pub fn average_precision(right: &[bool], targets: usize) -> Option<f64> {
    let mut curve = Vec::with_capacity(right.len());
    let mut count = 0;
    for (i, &right) in right.iter().enumerate() {
        count += usize::from(right);
        let precision = count as f64 / (i + 1) as f64;
        curve.push((count as f64 / targets as f64, precision));
    }
    // From the greatest recall down, so that each point has the best precision from there on.
    let mut best: f64 = 0.0;
    for (_, precision) in curve.iter_mut().rev() {
        best = best.max(*precision);
        *precision = best;
    }
    let at = |step: u32| {
        let reached = curve.partition_point(|&(recall, _)| recall < f64::from(step) * 0.01);
        curve.get(reached).map_or(0.0, |&(_, precision)| precision)
    };
    (targets > 0).then(|| (0..=100).map(at).sum::<f64>() / 101.0)
}

/// Exact area under the recall curve from 0 to `max`, over `max`: the mean of `1 - error / max`,
/// no less than 0 each.
pub fn auc_exact(errors: &[f64], max: f64) -> Option<f64> {
    let area = errors.iter().map(|&error| positive(1.0 - error / max));
    (!errors.is_empty()).then(|| area.sum::<f64>() / errors.len() as f64)
}

/// The area of PoseCNN's and CosyPose's evaluations (YCB-Video toolbox, `VOCap`), `max` there
/// being 0.1 m.
///
/// The recall between two errors is taken to be that at the greater one, which makes the area too
/// large for few poses: by half a step on average.
///
/// Source: Xiang et al., "PoseCNN", 2018, and its YCB_Video_toolbox.
pub fn auc_posecnn(errors: &[f64], max: f64) -> Option<f64> {
    let mut correct: Vec<f64> = errors.iter().copied().filter(|&e| e <= max).collect();
    correct.sort_by(f64::total_cmp);
    let mut area = 0.0;
    let mut before = 0.0;
    for (i, &error) in correct.iter().enumerate() {
        // Of equal errors the first one counts, as there; the others add nothing.
        area += (error - before) * (i + 1) as f64;
        before = error;
    }
    area += (max - before) * correct.len() as f64;
    (!errors.is_empty()).then(|| area / errors.len() as f64 / max)
}

/// The area of PoET's evaluation: Simpson's rule over the recalls at 1000 thresholds from 0 to
/// `0.999 max`, over `max`, which is 0.1 m there.
///
/// PoET leaves out objects that were not found: pass errors of the found ones to compare with it.
/// Simpson's rule needs an even number of intervals, of which there are 999: it is the mean of the
/// rule without the last interval and without the first, with a trapezium in its stead.
///
/// Source: Jantos et al., "PoET", 2022, and its `pose_evaluator.py`, with SciPy's `simps` of then.
pub fn auc_poet(errors: &[f64], max: f64) -> Option<f64> {
    const STEPS: usize = 1000;
    let recalls: Option<Vec<f64>> = (0..STEPS)
        .map(|i| recall(errors, max * i as f64 / STEPS as f64))
        .collect();
    let recalls = recalls?;
    let simpson = |y: &[f64]| {
        let inner = y[1..y.len() - 1].iter().enumerate();
        let inner: f64 = inner
            .map(|(i, y)| if i % 2 == 0 { 4.0 * y } else { 2.0 * y })
            .sum();
        (y[0] + inner + y[y.len() - 1]) / 3.0
    };
    let trapezium = |a: usize, b: usize| (recalls[a] + recalls[b]) / 2.0;
    let without_last = simpson(&recalls[..STEPS - 1]) + trapezium(STEPS - 2, STEPS - 1);
    let without_first = simpson(&recalls[1..]) + trapezium(0, 1);
    Some((without_last + without_first) / 2.0 / STEPS as f64)
}

/// 0 for what is negative or not a number.
fn positive(x: f64) -> f64 {
    if x > 0.0 { x } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    const FIVE: [f64; 5] = [0.03, 0.2, 0.01, 0.08, 0.03];

    #[test]
    fn five_errors_have_the_areas_worked_by_hand() {
        // Exact: (0.9 + 0.7 + 0.7 + 0.2 + 0) / 5.
        assert_abs_diff_eq!(auc_exact(&FIVE, 0.1).unwrap(), 0.5, epsilon = 1e-12);
        // PoseCNN: (0.01 * 0.2 + 0.02 * 0.4 + 0.05 * 0.8 + 0.02 * 0.8) / 0.1.
        assert_abs_diff_eq!(auc_posecnn(&FIVE, 0.1).unwrap(), 0.66, epsilon = 1e-12);
    }

    #[test]
    fn areas_of_many_errors_approach_each_other() {
        let errors: Vec<f64> = (0..400).map(|i| 0.001 + 0.0002 * f64::from(i)).collect();
        let exact = auc_exact(&errors, 0.1).unwrap();
        assert_abs_diff_eq!(exact, 0.591, epsilon = 1e-9);
        assert_abs_diff_eq!(auc_posecnn(&errors, 0.1).unwrap(), 0.59302, epsilon = 1e-9);
        assert_abs_diff_eq!(auc_poet(&errors, 0.1).unwrap(), exact, epsilon = 2e-3);
    }

    #[test]
    fn average_precision_is_the_one_worked_by_hand() {
        // Precisions 1/1, 1/2, 2/3 at recalls 1/4, 1/4, 2/4, so 1 up to 0.25 and 2/3 up to 0.5.
        let expected = (26.0 + 25.0 * 2.0 / 3.0) / 101.0;
        let of = |right: &[bool]| average_precision(right, 4).unwrap();
        assert_abs_diff_eq!(of(&[true, false, true]), expected, epsilon = 1e-12);
        assert_abs_diff_eq!(of(&[true; 4]), 1.0, epsilon = 1e-12);
        assert_eq!((of(&[false; 3]), of(&[])), (0.0, 0.0));
        assert_eq!(average_precision(&[false], 0), None);
    }

    #[test]
    fn poet_counts_perfect_poses_at_all_thresholds_but_the_first() {
        // 998 intervals by Simpson's rule are 998 less 1/3 for the first value, plus 1; or half
        // of the first interval, plus 998.
        let expected = ((998.0 - 1.0 / 3.0 + 1.0) + (0.5 + 998.0)) / 2.0 / 1000.0;
        assert_abs_diff_eq!(auc_poet(&[0.0], 0.1).unwrap(), expected, epsilon = 1e-12);
    }

    #[test]
    fn missed_objects_count_as_wrong() {
        for auc in [auc_exact, auc_posecnn, auc_poet] {
            let found = auc(&[0.02, 0.04], 0.1).unwrap();
            let half = auc(&[0.02, 0.04, f64::INFINITY, f64::INFINITY], 0.1).unwrap();
            assert_abs_diff_eq!(half, found / 2.0, epsilon = 1e-12);
            assert_eq!(auc(&[f64::INFINITY], 0.1), Some(0.0));
            assert_eq!(auc(&[], 0.1), None);
        }
    }

    #[test]
    fn an_error_at_the_threshold_is_not_below_it() {
        assert_eq!(recall(&[0.1, 0.2], 0.1), Some(0.0));
        assert_eq!(recall(&[0.1, 0.2], 0.2), Some(0.5));
        assert_eq!(recall(&[], 0.2), None);
        assert_eq!(average_recall(&[0.1, 0.2], &[0.15, 0.3]), Some(0.75));
        assert_eq!(average_recall(&[0.1], &[]), None);
    }
}
