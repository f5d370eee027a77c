//! The histogram as SVG, which the paper's figure of YCB-V shows.

use std::fmt::Write;

use mvtop_eval::leakage::BINS;

use super::report::{nearest, percent};
use super::{Audited, Measure};
use crate::svg::{escape, round_step};

const LEFT: f64 = 80.0;
const BOTTOM: f64 = 330.0;
const HEIGHT: f64 = 250.0;
const BAR: f64 = 58.0;
/// Steps of the axis, at most.
const TICKS: f64 = 10.0;

/// Poses of split a over their difference to the most alike pose of b; the last bar is the rest.
pub fn svg(result: &Audited) -> String {
    let total = result.leakage.total();
    let histogram = &total.histogram;
    let counts: Vec<u64> = histogram
        .bins
        .into_iter()
        .chain([histogram.beyond])
        .collect();
    let most = counts.iter().copied().max().unwrap_or(0);
    let step = round_step(most as f64 / TICKS).max(1.0) as u64;
    let top = most.div_ceil(step).max(1) * step;
    let y = |count: u64| BOTTOM - HEIGHT * count as f64 / top as f64;
    let right = LEFT + BAR * counts.len() as f64;
    let width = right + 20.0;
    let middle = (LEFT + right) / 2.0;
    let label = match result.measure {
        Measure::AddPercent => "ADD to the nearest pose of b, percent of the object's diameter",
        Measure::RotDeg => "angle to the pose of b with the same translation, degrees",
    };

    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"400\" \
         viewBox=\"0 0 {width} 400\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    // Writing to a string does not fail, so results of `write` are dropped.
    let text = |svg: &mut String, x: f64, y: f64, anchor: &str, text: &str| {
        let text = escape(text);
        let _ = writeln!(
            svg,
            r#"<text x="{x}" y="{y}" text-anchor="{anchor}">{text}</text>"#
        );
    };
    let splits = format!("a: {}   b: {}", result.names[0], result.names[1]);
    text(&mut svg, 16.0, 24.0, "start", &splits);
    let summary = nearest(result.measure, histogram, total.a.poses);
    text(&mut svg, 16.0, 44.0, "start", &summary);
    for tick in (0..=top / step).map(|i| i * step) {
        let y = y(tick);
        let _ = writeln!(
            svg,
            "<line x1=\"{LEFT}\" x2=\"{right}\" y1=\"{y}\" y2=\"{y}\" stroke=\"#ddd\"/>"
        );
        text(&mut svg, LEFT - 8.0, y + 4.0, "end", &tick.to_string());
    }
    for (i, &count) in counts.iter().enumerate() {
        let x = LEFT + BAR * i as f64;
        let fill = if i < BINS { "#3465a4" } else { "#999" };
        let _ = writeln!(
            svg,
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{fill}\"/>",
            x + 2.0,
            y(count),
            BAR - 4.0,
            BOTTOM - y(count)
        );
        let share = format!("{:.1} %", percent(count, total.a.poses));
        text(&mut svg, x + BAR / 2.0, y(count) - 5.0, "middle", &share);
        if i < BINS {
            text(&mut svg, x, BOTTOM + 18.0, "middle", &i.to_string());
        } else {
            text(&mut svg, x, BOTTOM + 18.0, "middle", &BINS.to_string());
            text(&mut svg, x + BAR / 2.0, BOTTOM + 18.0, "middle", "more");
        }
    }
    text(&mut svg, middle, BOTTOM + 42.0, "middle", label);
    let _ = writeln!(
        svg,
        "<text transform=\"translate(16 {}) rotate(-90)\" text-anchor=\"middle\">poses of a</text>\n\
         </svg>",
        BOTTOM - HEIGHT / 2.0
    );
    svg
}
