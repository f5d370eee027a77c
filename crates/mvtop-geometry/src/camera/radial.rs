//! Radial profiles: where they stop rising, and their inverse on the part where they rise.

/// `Σ coefficients[i] xⁱ`.
pub(super) fn eval(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

pub(super) fn derivative(coefficients: &[f64]) -> Vec<f64> {
    let powers = coefficients.iter().zip(0..).skip(1);
    powers.map(|(c, power)| c * f64::from(power)).collect()
}

pub(super) fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; a.len() + b.len() - 1];
    for (i, a) in a.iter().enumerate() {
        for (j, b) in b.iter().enumerate() {
            out[i + j] += a * b;
        }
    }
    out
}

/// The zeros of a polynomial in `(0, end)` at which it changes its sign, in order.
///
/// Between two neighbouring extrema there is at most one zero, so the derivative's zeros bracket
/// them all.
pub(super) fn sign_changes(coefficients: &[f64], end: f64) -> Vec<f64> {
    if coefficients.len() < 2 {
        return Vec::new();
    }
    let mut ends = vec![0.0];
    ends.extend(sign_changes(&derivative(coefficients), end));
    ends.push(end);
    ends.windows(2)
        .filter_map(|pair| {
            let (mut low, mut high) = (pair[0], pair[1]);
            let rising = eval(coefficients, high) > 0.0;
            if (eval(coefficients, low) > 0.0) == rising {
                return None;
            }
            while low.max(high * f64::EPSILON) < (low + high) / 2.0 && (low + high) / 2.0 < high {
                let middle = (low + high) / 2.0;
                match (eval(coefficients, middle) > 0.0) == rising {
                    true => high = middle,
                    false => low = middle,
                }
            }
            Some(low)
        })
        .collect()
}

/// The `x` in `[0, end]` with `profile(x) = target`, for a profile that rises from 0 there.
///
/// `profile` gives value and derivative. Newton's method, held inside a shrinking bracket.
pub(super) fn invert(profile: impl Fn(f64) -> (f64, f64), target: f64, end: f64) -> Option<f64> {
    // Not `target > value`: a NaN must end here too.
    if !(target >= 0.0 && target <= profile(end).0) {
        return None;
    }
    let (mut low, mut high) = (0.0, end);
    let mut x = target.min(end);
    for _ in 0..100 {
        let (value, slope) = profile(x);
        if value > target {
            high = x;
        } else {
            low = x;
        }
        let newton = x - (value - target) / slope;
        let next = if newton > low && newton < high {
            newton
        } else {
            (low + high) / 2.0
        };
        if (next - x).abs() <= 4.0 * f64::EPSILON * x {
            return Some(next);
        }
        x = next;
    }
    // Bisection alone halves the bracket 100 times, so `x` is as exact as it can be.
    Some(x)
}
