//! What pairs of numbers say of each other, as expected and actual errors of poses do.
//!
//! Numbers are finite; slices that belong together have the same length, and of slices that do not,
//! what the longer one has more is left out.

/// Bins of the calibration that is reported and drawn.
pub const CALIBRATION_BINS: usize = 5;
/// Bins of the reliability of confidences, of which the expected calibration error is the mean.
pub const RELIABILITY_BINS: usize = 10;

/// Arithmetic mean; `None` of nothing.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The middle value, of an even number the mean of the two middle ones; `None` of nothing.
pub fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let upper = sorted.get(sorted.len() / 2)?;
    let lower = sorted.get(sorted.len().saturating_sub(1) / 2)?;
    Some((lower + upper) / 2.0)
}

/// Area under the receiver operating characteristic: the probability that of a sample with the
/// label and one without it, the one with it has the greater score, where equal scores count half.
///
/// - `labels`: whether each sample is one of those that should score high
/// - returns: 0 to 1; `None` where all labels are alike
///
/// Source: Hanley and McNeil, "The Meaning and Use of the Area under a ROC Curve", 1982.
pub fn auroc(scores: &[f64], labels: &[bool]) -> Option<f64> {
    let (mut low, mut high) = (0_u64, 0_u64);
    // Twice the number of pairs in order, so that ties stay whole numbers.
    let mut in_order = 0;
    for [without, with] in ties(scores, labels) {
        in_order += with * (2 * low + without);
        (low, high) = (low + without, high + with);
    }
    let pairs = low * high;
    (pairs > 0).then(|| in_order as f64 / (2 * pairs) as f64)
}

/// Points of the receiver operating characteristic of "the score is at least a threshold": false
/// and true positive rate, from `[0, 0]` to `[1, 1]`, one for each threshold among the scores.
///
/// Equal scores fall together, so that [`auroc`] is the area under the straight lines between the
/// points. A rate of no samples is 0.
///
/// - `labels`: as of [`auroc`]
pub fn roc_curve(scores: &[f64], labels: &[bool]) -> Vec<[f64; 2]> {
    let ties = ties(scores, labels);
    let total = |kind: usize| ties.iter().map(|tie| tie[kind]).sum::<u64>().max(1) as f64;
    let totals = [total(0), total(1)];
    let mut above = [0, 0];
    let mut points = vec![[0.0, 0.0]];
    for tie in ties.iter().rev() {
        above = [above[0] + tie[0], above[1] + tie[1]];
        points.push([above[0] as f64 / totals[0], above[1] as f64 / totals[1]]);
    }
    points
}

/// How many samples without and with the label have each score, lowest score first.
fn ties(scores: &[f64], labels: &[bool]) -> Vec<[u64; 2]> {
    let mut samples: Vec<(&f64, &bool)> = scores.iter().zip(labels).collect();
    samples.sort_by(|a, b| a.0.total_cmp(b.0));
    let count = |tie: &[(&f64, &bool)]| {
        let with = tie.iter().filter(|(_, label)| **label).count();
        [(tie.len() - with) as u64, with as u64]
    };
    samples.chunk_by(|a, b| a.0 == b.0).map(count).collect()
}

/// Pearson's correlation coefficient, `Σ (x - x̄)(y - ȳ) / √(Σ (x - x̄)² Σ (y - ȳ)²)`.
///
/// - returns: -1 to 1; `None` where either side does not vary
pub fn correlation(x: &[f64], y: &[f64]) -> Option<f64> {
    let count = x.len().min(y.len());
    let (x, y) = (&x[..count], &y[..count]);
    let (x_mean, y_mean) = (mean(x)?, mean(y)?);
    let sum = |of: fn(f64, f64) -> f64| -> f64 {
        let pairs = x.iter().zip(y);
        pairs.map(|(x, y)| of(x - x_mean, y - y_mean)).sum()
    };
    let spread = (sum(|x, _| x * x) * sum(|_, y| y * y)).sqrt();
    (spread > 0.0).then(|| sum(|x, y| x * y) / spread)
}

/// Samples that were expected to be off by about as much.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bin {
    /// Number of samples.
    pub count: usize,
    /// Mean of what was expected, in its unit.
    pub expected: f64,
    /// Mean of what came.
    pub actual: f64,
}

/// Mean expected and mean actual error in bins of equal count, least expected error first: bin `i`
/// holds the samples from `i n / bins` to `(i + 1) n / bins` in the order of what was expected.
///
/// - `bins`: how many; as many as there are samples where those are fewer
pub fn calibration(expected: &[f64], actual: &[f64], bins: usize) -> Vec<Bin> {
    let actual = actual.iter().copied();
    let mut pairs: Vec<(f64, f64)> = expected.iter().copied().zip(actual).collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let bins = bins.min(pairs.len());
    let cut = |bin: usize| pairs.len() * bin / bins;
    let bin = |i: usize| {
        let pairs = pairs[cut(i)..cut(i + 1)].iter().copied();
        let (expected, actual): (Vec<f64>, Vec<f64>) = pairs.unzip();
        Some(Bin {
            count: expected.len(),
            expected: mean(&expected)?,
            actual: mean(&actual)?,
        })
    };
    (0..bins).filter_map(bin).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Of scores without and scores with the label.
    fn auroc_of(low: &[f64], high: &[f64]) -> Option<f64> {
        let labels = [vec![false; low.len()], vec![true; high.len()]].concat();
        auroc(&[low, high].concat(), &labels)
    }

    #[test]
    fn median_of_an_odd_number_is_the_middle() {
        assert_eq!(median(&[2.0, 9.0, 1.0]), Some(2.0));
        assert_eq!(median(&[4.0]), Some(4.0));
        assert_eq!(median(&[4.0, 1.0]), Some(2.5));
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn auroc_counts_pairs_in_order() {
        assert_eq!(auroc_of(&[1.0, 2.0], &[3.0, 4.0]), Some(1.0));
        assert_eq!(auroc_of(&[3.0, 4.0], &[1.0, 2.0]), Some(0.0));
        assert_eq!(auroc_of(&[5.0, 5.0], &[5.0]), Some(0.5));
        // Of (1,2) (3,2) (1,3) (3,3): in order, not, in order, equal.
        assert_eq!(auroc_of(&[1.0, 3.0], &[2.0, 3.0]), Some(2.5 / 4.0));
        assert_eq!(auroc_of(&[], &[1.0]), None);
        assert_eq!(auroc_of(&[1.0], &[]), None);
    }

    #[test]
    fn curve_has_a_point_for_each_score_and_takes_equal_ones_together() {
        let curve = roc_curve(&[3.0, 1.0, 3.0, 2.0], &[true, false, false, true]);
        assert_eq!(curve, [[0.0, 0.0], [0.5, 0.5], [0.5, 1.0], [1.0, 1.0]]);
        assert_eq!(roc_curve(&[1.0], &[true]), [[0.0, 0.0], [0.0, 1.0]]);
    }

    #[test]
    fn correlation_is_one_on_a_line_and_none_for_a_constant() {
        let (x, y) = ([1.0, 2.0, 4.0], [5.0, 7.0, 11.0]);
        assert!((correlation(&x, &y).unwrap() - 1.0).abs() < 1e-12);
        assert!((correlation(&x, &y.map(|y| -y)).unwrap() + 1.0).abs() < 1e-12);
        assert_eq!(correlation(&[1.0, 1.0], &[2.0, 3.0]), None);
        assert_eq!(correlation(&[], &[]), None);
    }

    #[test]
    fn calibration_has_equal_bins_in_the_order_of_what_was_expected() {
        // Expected 0 to 52 in a shuffled order, actual twice that: no bin may mix.
        let expected: Vec<f64> = (0..53).map(|i| f64::from(i * 20 % 53)).collect();
        let actual: Vec<f64> = expected.iter().map(|x| 2.0 * x).collect();
        let bins = calibration(&expected, &actual, 5);
        let counts: Vec<usize> = bins.iter().map(|bin| bin.count).collect();
        assert_eq!(counts, [10, 11, 10, 11, 11]);
        let first = Bin {
            count: 10,
            expected: 4.5,
            actual: 9.0,
        };
        assert_eq!(bins[0], first);
        assert_eq!(calibration(&[2.0, 1.0], &[5.0, 3.0], 5).len(), 2);
        assert_eq!(calibration(&[], &[], 5), []);
    }

    proptest! {
        #[test]
        fn auroc_is_what_all_pairs_say_and_the_area_under_the_curve(
            samples in prop::collection::vec((0..6u8, any::<bool>()), 0..30),
        ) {
            let (scores, labels): (Vec<f64>, Vec<bool>) =
                samples.iter().map(|&(score, label)| (f64::from(score), label)).unzip();
            let of = |wanted: bool| scores.iter().zip(&labels).filter(move |(_, l)| **l == wanted);
            let mut wins = Vec::new();
            for (high, _) in of(true) {
                for (low, _) in of(false) {
                    wins.push(if high > low { 1.0 } else if high == low { 0.5 } else { 0.0 });
                }
            }
            let area = auroc(&scores, &labels);
            prop_assert_eq!(area, mean(&wins));
            if let Some(area) = area {
                let curve = roc_curve(&scores, &labels);
                let under: f64 = curve
                    .windows(2)
                    .map(|pair| (pair[1][0] - pair[0][0]) * (pair[1][1] + pair[0][1]) / 2.0)
                    .sum();
                prop_assert!((under - area).abs() < 1e-12);
                prop_assert_eq!(curve.last(), Some(&[1.0, 1.0]));
            }
        }
    }
}
