//! What expected and actual errors say of each other.

use mvtop_eval::statistics::{self, CALIBRATION_BINS};
use pyo3::prelude::*;

use crate::convert::{ArrayLike, F64, shaped};
use crate::error::value;

/// Area under the receiver operating characteristic: the probability that of a sample with the
/// label and one without it, the one with it has the greater score; equal scores count half (Hanley
/// and McNeil 1982).
///
/// Parameters
/// ----------
/// scores : array, (N,)
/// labels : array, (N,)
///     Whether each sample is one of those that should score high: bools, or 0 and 1.
///
/// Returns
/// -------
/// 0 to 1; None where all labels are alike.
#[pyfunction]
pub fn auroc(scores: ArrayLike, labels: ArrayLike) -> PyResult<Option<f64>> {
    let (scores, labels) = labelled(&scores, &labels)?;
    Ok(statistics::auroc(&scores, &labels))
}

/// The characteristic of "the score is at least a threshold", whose area `auroc` is.
///
/// Parameters
/// ----------
/// scores, labels : array, (N,)
///     As of `auroc`.
///
/// Returns
/// -------
/// array, (T + 1, 2)
///     False and true positive rate, from (0, 0) to (1, 1), one for each of T different scores;
///     a rate of no samples is 0.
#[pyfunction]
pub fn roc_curve(scores: ArrayLike, labels: ArrayLike) -> PyResult<F64> {
    let (scores, labels) = labelled(&scores, &labels)?;
    rows(&statistics::roc_curve(&scores, &labels))
}

/// Pearson's correlation coefficient.
///
/// Parameters
/// ----------
/// x, y : array, (N,)
///
/// Returns
/// -------
/// -1 to 1; None where either side does not vary.
#[pyfunction]
pub fn correlation(x: ArrayLike, y: ArrayLike) -> PyResult<Option<f64>> {
    let [x, y] = pair(["x", "y"], [&x, &y])?;
    Ok(statistics::correlation(&x, &y))
}

/// Mean expected and mean actual error in bins of equal count, least expected error first.
///
/// Parameters
/// ----------
/// expected, actual : array, (N,)
/// bins
///     How many; as many as there are samples where those are fewer.
///
/// Returns
/// -------
/// array, (bins, 2)
#[pyfunction]
#[pyo3(signature = (expected, actual, bins = CALIBRATION_BINS as i64))]
pub fn calibration(expected: ArrayLike, actual: ArrayLike, bins: i64) -> PyResult<F64> {
    let bins = usize::try_from(bins)
        .map_err(|_| value(format!("bins: expected 0 or more, got {bins}")))?;
    let [expected, actual] = pair(["expected", "actual"], [&expected, &actual])?;
    let bins = statistics::calibration(&expected, &actual, bins);
    let means = bins.iter().map(|bin| [bin.expected, bin.actual]);
    rows(&means.collect::<Vec<_>>())
}

fn labelled(scores: &ArrayLike, labels: &ArrayLike) -> PyResult<(Vec<f64>, Vec<bool>)> {
    let scores = scores.list("scores")?;
    let labels = labels.any_number::<f64>("labels", Some(0), &[0])?;
    as_many(["scores", "labels"], [scores.len(), labels.len()])?;
    let labels = labels.into_iter().enumerate().map(label);
    Ok((scores, labels.collect::<PyResult<_>>()?))
}

fn label((index, number): (usize, f64)) -> PyResult<bool> {
    match number {
        0.0 => Ok(false),
        1.0 => Ok(true),
        _ => Err(value(format!(
            "labels: expected bools, or 0 and 1, got {number} at index {index}; compare with a \
             threshold, as in `labels > 0.5`"
        ))),
    }
}

fn pair(names: [&str; 2], arrays: [&ArrayLike; 2]) -> PyResult<[Vec<f64>; 2]> {
    let (first, second) = (arrays[0].list(names[0])?, arrays[1].list(names[1])?);
    as_many(names, [first.len(), second.len()])?;
    Ok([first, second])
}

fn as_many([first, second]: [&str; 2], [expected, got]: [usize; 2]) -> PyResult<()> {
    match expected == got {
        true => Ok(()),
        false => Err(value(format!(
            "{second}: expected {expected} numbers, as many as of {first}, got {got}"
        ))),
    }
}

fn rows(pairs: &[[f64; 2]]) -> PyResult<F64> {
    Ok(F64(shaped(&[pairs.len(), 2], pairs.concat())?))
}
