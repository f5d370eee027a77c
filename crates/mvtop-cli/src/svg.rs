//! What all plots and pages need.

/// The least of 1, 2, 5, 10, 20, ... and 0.5, 0.2, 0.1, ... that is no less than `least`.
pub fn round_step(least: f64) -> f64 {
    let decade = 10_f64.powf(least.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|step| step * decade);
    let enough = |step: &f64| *step >= least * (1.0 - 1e-9);
    steps.into_iter().find(enough).unwrap_or(10.0 * decade)
}

/// Text as it stands in HTML and SVG.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round() {
        for (least, step) in [
            (0.9, 1.0),
            (1.0, 1.0),
            (1.1, 2.0),
            (2.4, 5.0),
            (51.0, 100.0),
        ] {
            assert!((round_step(least) - step).abs() < 1e-9 * step, "{least}");
            assert!(
                (round_step(1e-3 * least) - 1e-3 * step).abs() < 1e-12,
                "{least}"
            );
        }
    }
}
