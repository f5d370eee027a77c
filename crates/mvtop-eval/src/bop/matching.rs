//! Which estimates are of which targets, as BOP's evaluation has it.

/// The target that each estimate takes at a threshold: in the order given, the free one that it is
/// least off from, if it is off by less than the threshold.
///
/// - `errors`: by estimate, surest first, then by target
///
/// Source: `match_poses` of bop_toolkit.
pub fn match_targets(errors: &[Vec<f64>], threshold: f64) -> Vec<Option<usize>> {
    let mut taken = vec![false; errors.first().map_or(0, Vec::len)];
    let mut matched = Vec::with_capacity(errors.len());
    for of_estimate in errors {
        let free = of_estimate.iter().enumerate();
        let free = free.filter(|&(target, &error)| !taken[target] && error < threshold);
        let target = free.min_by(|a, b| a.1.total_cmp(b.1)).map(|(t, _)| t);
        if let Some(target) = target {
            taken[target] = true;
        }
        matched.push(target);
    }
    matched
}

/// How many estimates are right at a threshold, matched as [`match_targets`] does.
///
/// - `errors`: by estimate, surest first, then by target
pub fn count_right(errors: &[Vec<f64>], threshold: f64) -> usize {
    match_targets(errors, threshold).iter().flatten().count()
}

#[cfg(test)]
mod tests {
    use super::{count_right, match_targets};

    #[test]
    fn surest_estimates_choose_first_and_targets_are_taken_once() {
        // The first estimate takes target 1, which the second would need.
        let errors = [vec![4.0, 3.0], vec![9.0, 2.0], vec![5.0, 6.0]];
        assert_eq!(count_right(&errors, 3.0), 1); // the second, as 3 is not below 3
        assert_eq!(count_right(&errors, 4.0), 1); // the first; nothing is left for the second
        assert_eq!(count_right(&errors, 5.5), 2); // the third takes target 0
        assert_eq!(match_targets(&errors, 5.5), [Some(1), None, Some(0)]);
        assert_eq!(count_right(&errors, f64::INFINITY), 2);
        assert_eq!(count_right(&[vec![], vec![]], 5.0), 0);
        assert_eq!(count_right(&[], 5.0), 0);
    }
}
