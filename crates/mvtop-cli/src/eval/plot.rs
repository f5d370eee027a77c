//! Plots as SVG text.

use std::fmt::Write;

use crate::svg::round_step;

const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 220.0;
const LEFT: f64 = 44.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 24.0;
const BOTTOM: f64 = 36.0;
/// Bars of a histogram, at most; ticks of an axis, about.
const BINS: f64 = 24.0;
const TICKS: f64 = 5.0;
const COLORS: [&str; 4] = ["#1f77b4", "#d62728", "#2ca02c", "#9467bd"];

/// Plot area with axes from 0 to `x_max` and to `y_max`.
struct Axes {
    x_max: f64,
    y_max: f64,
    svg: String,
}

impl Axes {
    fn new(title: &str, x_label: &str, x_max: f64, y_max: f64, y_tick: f64) -> Self {
        let mut axes = Self {
            x_max,
            y_max,
            svg: format!(
                "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" \
                 width=\"{WIDTH}\" height=\"{HEIGHT}\" font-family=\"sans-serif\" \
                 font-size=\"11\"><text x=\"{LEFT}\" y=\"14\" font-weight=\"bold\">{title}</text>"
            ),
        };
        let base = HEIGHT - BOTTOM;
        for value in ticks(y_max, y_tick) {
            let (y, text) = (axes.y(value), number(value));
            axes.put(format_args!(
                "<line x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"#ddd\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{text}</text>",
                WIDTH - RIGHT,
                LEFT - 4.0,
                y + 4.0,
            ));
        }
        for value in ticks(x_max, round_step(x_max / TICKS)) {
            let (x, text) = (axes.x(value), number(value));
            axes.put(format_args!(
                "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{text}</text>",
                base + 14.0
            ));
        }
        let middle = (LEFT + WIDTH - RIGHT) / 2.0;
        axes.put(format_args!(
            "<text x=\"{middle:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{x_label}</text>",
            HEIGHT - 6.0
        ));
        axes
    }

    fn put(&mut self, text: std::fmt::Arguments) {
        // Writing to a string cannot fail.
        let _ = self.svg.write_fmt(text);
    }

    fn x(&self, value: f64) -> f64 {
        LEFT + value / self.x_max * (WIDTH - LEFT - RIGHT)
    }

    fn y(&self, value: f64) -> f64 {
        HEIGHT - BOTTOM - value / self.y_max * (HEIGHT - TOP - BOTTOM)
    }

    fn end(mut self) -> String {
        self.svg += "</svg>";
        self.svg
    }
}

/// How many values lie where, from 0 to about the 95th percentile; the last bar holds all beyond.
pub fn histogram(title: &str, unit: &str, values: &[f64]) -> String {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let near_last = sorted.len().saturating_sub(1) * 95 / 100;
    let x_max = sorted.get(near_last).copied().unwrap_or(1.0).max(1e-9);
    // Few values in many bars would be a comb.
    let width = round_step(x_max / (2.0 * (sorted.len() as f64).sqrt()).clamp(4.0, BINS));
    let bins = (x_max / width).floor() as usize + 1;
    let mut counts = vec![0_usize; bins];
    for value in &sorted {
        counts[((value / width) as usize).min(bins - 1)] += 1;
    }
    let most = counts.iter().max().copied().unwrap_or(0).max(1) as f64;
    let tick = round_step(most / TICKS).max(1.0);
    let label = format!("{unit} (last bar: and beyond), {} objects", sorted.len());
    let x_max = width * bins as f64;
    let mut axes = Axes::new(title, &label, x_max, (most / tick).ceil() * tick, tick);
    for (bin, &count) in counts.iter().enumerate() {
        let (x0, x1) = (axes.x(width * bin as f64), axes.x(width * (bin + 1) as f64));
        let (top, base) = (axes.y(count as f64), axes.y(0.0));
        let (width, height) = (x1 - x0 - 1.0, base - top);
        axes.put(format_args!(
            "<rect x=\"{x0:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
             fill=\"{}\"/>",
            COLORS[0]
        ));
    }
    axes.end()
}

/// Share of errors below a threshold, over the threshold from 0 to `max`; missed objects are
/// infinite errors.
pub fn recall_curves(title: &str, unit: &str, max: f64, errors_of: &[(&str, Vec<f64>)]) -> String {
    let mut axes = Axes::new(title, unit, max, 1.0, 0.25);
    for (i, (name, errors)) in errors_of.iter().enumerate() {
        let color = COLORS[i % COLORS.len()];
        let mut sorted: Vec<f64> = errors.iter().copied().filter(|&x| x <= max).collect();
        sorted.sort_by(f64::total_cmp);
        let total = errors.len().max(1) as f64;
        let mut points = format!("{:.1},{:.1}", axes.x(0.0), axes.y(0.0));
        for (k, &error) in sorted.iter().enumerate() {
            let x = axes.x(error);
            for share in [k, k + 1] {
                let _ = write!(points, " {x:.1},{:.1}", axes.y(share as f64 / total));
            }
        }
        let last = axes.y(sorted.len() as f64 / total);
        let _ = write!(points, " {:.1},{last:.1}", axes.x(max));
        // Where curves seldom go.
        let legend = HEIGHT - BOTTOM - 8.0 - 13.0 * (errors_of.len() - 1 - i) as f64;
        axes.put(format_args!(
            "<polyline points=\"{points}\" fill=\"none\" stroke=\"{color}\" \
             stroke-width=\"1.5\"/><text x=\"{:.1}\" y=\"{legend:.1}\" text-anchor=\"end\" \
             fill=\"{color}\">{name}</text>",
            WIDTH - RIGHT - 6.0
        ));
    }
    axes.end()
}

/// 0 and multiples of `step` up to `max`.
fn ticks(max: f64, step: f64) -> impl Iterator<Item = f64> {
    let count = (max / step * (1.0 + 1e-9)) as usize;
    (0..=count).map(move |i| i as f64 * step)
}

/// With three significant digits.
fn number(x: f64) -> String {
    let digits = if x == 0.0 {
        0.0
    } else {
        2.0 - x.abs().log10().floor()
    };
    let text = format!("{x:.*}", digits.clamp(0.0, 9.0) as usize);
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_and_steps_are_where_the_values_are() {
        let svg = histogram("Errors", "mm", &[0.0, 0.0, 1.0, f64::INFINITY]);
        assert!(
            svg.contains("mm (last bar: and beyond), 3 objects"),
            "{svg}"
        );
        let full = format!("height=\"{:.1}\"", HEIGHT - TOP - BOTTOM);
        assert_eq!(svg.matches(&full).count(), 1, "{svg}");
        let curve = recall_curves("Recall", "m", 1.0, &[("ADD", vec![0.5, f64::INFINITY])]);
        let (middle, right) = ((LEFT + WIDTH - RIGHT) / 2.0, WIDTH - RIGHT);
        let (base, half) = (HEIGHT - BOTTOM, (HEIGHT - BOTTOM + TOP) / 2.0);
        let expected = format!(
            "points=\"{LEFT:.1},{base:.1} {middle:.1},{base:.1} {middle:.1},{half:.1} {right:.1},{half:.1}\""
        );
        assert!(curve.contains(&expected), "{curve}");
    }

    #[test]
    fn bars_have_round_widths_and_the_last_one_takes_the_rest() {
        // The 95th percentile is 3.8: of 8.9 bars at most, steps of 0.5 are the finest round ones.
        let mut values: Vec<f64> = (0..20).map(|i| 0.2 * f64::from(i)).collect();
        values[19] = 70.0;
        let svg = histogram("Errors", "mm", &values);
        assert_eq!(svg.matches("<rect").count(), 8, "{svg}");
        // 3.6 and 70.
        let top = HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * 2.0 / 3.0;
        let last = svg.rfind("<rect").unwrap();
        assert!(svg[last..].contains(&format!("y=\"{top:.1}\"")), "{svg}");
    }

    #[test]
    fn ticks_reach_the_end() {
        let at: Vec<f64> = ticks(0.5, 0.1).collect();
        assert_eq!(at.len(), 6);
        assert!((at[5] - 0.5).abs() < 1e-12);
    }

    #[test]
    fn numbers_are_short() {
        for (x, text) in [
            (0.0, "0"),
            (0.025, "0.025"),
            (12.5, "12.5"),
            (1234.0, "1234"),
            (0.75, "0.75"),
        ] {
            assert_eq!(number(x), text);
        }
    }
}
