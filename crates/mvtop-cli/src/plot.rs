//! Plots as SVG text.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::failure::{Failure, Result};

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = std::result::Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// Of a plot among others on a page, px.
const SMALL: (u32, u32) = (380, 240);
/// Bars of a histogram of errors, at most.
const BINS: f64 = 24.0;
const COLORS: [RGBColor; 6] = [
    RGBColor(31, 119, 180),
    RGBColor(214, 39, 40),
    RGBColor(44, 160, 44),
    RGBColor(255, 127, 14),
    RGBColor(148, 103, 189),
    RGBColor(140, 86, 75),
];
const LINES: RGBColor = RGBColor(221, 221, 221);
const REST: RGBColor = RGBColor(153, 153, 153);

/// A chart with its title and axes; what differs of the axes is set by the last argument.
macro_rules! chart {
    ($area:expr, $title:expr, $y_label_area:expr, $axes:expr, |$mesh:ident| $set:expr) => {{
        let (x, y) = $axes;
        let mut chart = ChartBuilder::on($area)
            .caption($title, ("sans-serif", 16))
            .margin(8)
            .margin_right(16)
            .x_label_area_size(36)
            .y_label_area_size($y_label_area)
            .build_cartesian_2d(x, y)?;
        let mut mesh = chart.configure_mesh();
        let $mesh = mesh
            .disable_x_mesh()
            .bold_line_style(LINES)
            .light_line_style(TRANSPARENT)
            .label_style(("sans-serif", 14))
            .x_label_formatter(&|x| number(*x));
        $set.draw()?;
        chart
    }};
}

/// A histogram. The last bar holds all that lies beyond the others.
pub struct Bars<'a> {
    /// px
    pub size: (u32, u32),
    pub title: &'a str,
    pub x_label: &'a str,
    pub y_label: &'a str,
    /// Of a bar, in units of the axis.
    pub width: f64,
    pub counts: &'a [u64],
    /// What stands above a bar, from its count.
    pub above: &'a dyn Fn(u64) -> String,
}

impl Bars<'_> {
    pub fn svg(&self) -> Result<String> {
        svg(self.size, |area| {
            let most = self.counts.iter().copied().max().unwrap_or(0);
            let x_max = self.width * self.counts.len() as f64;
            // Room for what stands above the highest bar.
            let axes = (0.0..x_max, 0..most + most / 10 + 1);
            let y_label_area = if self.y_label.is_empty() { 36 } else { 64 };
            let mut chart = chart!(area, self.title, y_label_area, axes, |mesh| {
                mesh.x_desc(self.x_label)
                    .y_desc(self.y_label)
                    .x_labels(self.size.0 as usize / 60)
                    .y_labels(self.size.1 as usize / 40)
            });
            for (bin, &count) in self.counts.iter().enumerate() {
                let last = bin + 1 == self.counts.len();
                let color = if last { REST } else { COLORS[0] };
                let [x0, x1] = [0.04, 0.96].map(|side| self.width * (bin as f64 + side));
                let middle = ((x0 + x1) / 2.0, count);
                let style = ("sans-serif", 14).into_text_style(area);
                let style = style.pos(Pos::new(HPos::Center, VPos::Bottom));
                let bar = Rectangle::new([(x0, 0), (x1, count)], color.filled());
                let above = Text::new((self.above)(count), (0, -2), style);
                chart.draw_series([bar])?;
                chart.draw_series([EmptyElement::at(middle) + above])?;
            }
            Ok(())
        })
    }
}

/// How many errors lie where, from 0 to about the 95th percentile; the last bar holds all beyond.
pub fn histogram(title: &str, unit: &str, errors: &[f64]) -> Result<String> {
    let (width, counts) = count(errors);
    let of: u64 = counts.iter().sum();
    Bars {
        size: SMALL,
        title,
        x_label: &format!("{unit} (last bar: and beyond), {of} objects"),
        y_label: "",
        width,
        counts: &counts,
        above: &|_| String::new(),
    }
    .svg()
}

/// Round width of a bar, and what is in each; errors that are not finite are left out.
fn count(errors: &[f64]) -> (f64, Vec<u64>) {
    let mut sorted: Vec<f64> = errors.iter().copied().filter(|x| x.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let near_last = sorted.len().saturating_sub(1) * 95 / 100;
    let x_max = sorted.get(near_last).copied().unwrap_or(1.0).max(1e-9);
    // Few values in many bars would be a comb.
    let width = round_step(x_max / (2.0 * (sorted.len() as f64).sqrt()).clamp(4.0, BINS));
    let bins = (x_max / width).floor() as usize + 1;
    let mut counts = vec![0; bins];
    for error in &sorted {
        counts[((error / width) as usize).min(bins - 1)] += 1;
    }
    (width, counts)
}

/// The least of 1, 2, 5, 10, 20, ... and 0.5, 0.2, 0.1, ... that is no less than `least`.
fn round_step(least: f64) -> f64 {
    let decade = 10_f64.powf(least.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|step| step * decade);
    let enough = |step: &f64| *step >= least * (1.0 - 1e-9);
    steps.into_iter().find(enough).unwrap_or(10.0 * decade)
}

/// Share of errors below a threshold, over the threshold from 0 to `max`; missed objects are
/// infinite errors.
pub fn recall_curves(
    title: &str,
    unit: &str,
    max: f64,
    errors_of: &[(&str, Vec<f64>)],
) -> Result<String> {
    svg(SMALL, |area| {
        let mut chart = chart!(area, title, 36, (0.0..max, 0.0..1.0), |mesh| {
            let mesh = mesh.x_desc(unit).x_labels(6).y_labels(6);
            mesh.y_label_formatter(&|y| number(*y))
        });
        for ((name, errors), color) in errors_of.iter().zip(COLORS.into_iter().cycle()) {
            chart
                .draw_series(LineSeries::new(steps(errors, max), color.stroke_width(2)))?
                .label(*name)
                .legend(move |(x, y)| {
                    PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2))
                });
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE)
            .label_font(("sans-serif", 14))
            .draw()
    })
}

/// Corners of the curve of shares below a threshold.
fn steps(errors: &[f64], max: f64) -> Vec<(f64, f64)> {
    let mut sorted: Vec<f64> = errors.iter().copied().filter(|&x| x <= max).collect();
    sorted.sort_by(f64::total_cmp);
    let share = |count: usize| count as f64 / errors.len().max(1) as f64;
    let mut corners = vec![(0.0, 0.0)];
    for (i, &error) in sorted.iter().enumerate() {
        corners.extend([(error, share(i)), (error, share(i + 1))]);
    }
    corners.push((max, share(sorted.len())));
    corners
}

fn svg(size: (u32, u32), draw: impl FnOnce(&Area) -> Drawn) -> Result<String> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        area.fill(&WHITE)
            .and_then(|()| draw(&area))
            .and_then(|()| area.present())
            .map_err(|cause| Failure(format!("cannot draw a plot: {cause}")))?;
    }
    Ok(text)
}

/// At an axis: without the digits that rounding leaves.
fn number(x: f64) -> String {
    ((x * 1e6).round() / 1e6).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_and_curves_show_what_was_counted() {
        let errors = [0.0, 0.0, 1.0, 1.0, f64::INFINITY];
        let svg = histogram("Errors", "mm", &errors).unwrap();
        assert!(
            svg.contains("mm (last bar: and beyond), 4 objects"),
            "{svg}"
        );
        let (width, counts) = count(&errors);
        assert_eq!((width, &counts[..]), (0.5, &[2, 0, 2][..]));
        // Blue for each bin but the last.
        assert_eq!(svg.matches("fill=\"#1F77B4\"").count(), counts.len() - 1);
        let corners = steps(&[0.5, f64::INFINITY], 1.0);
        assert_eq!(corners, [(0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (1.0, 0.5)]);
        let curves = [("ADD", vec![0.5, f64::INFINITY]), ("MSSD", vec![0.2, 0.3])];
        let svg = recall_curves("Recall <1>", "m", 1.0, &curves).unwrap();
        assert!(
            svg.contains("Recall &lt;1&gt;") && svg.contains("MSSD"),
            "{svg}"
        );
    }

    #[test]
    fn bars_have_round_widths_and_the_last_one_takes_the_rest() {
        // The 95th percentile is 3.8: of 8.9 bars at most, steps of 0.5 are the finest round ones.
        let mut values: Vec<f64> = (0..20).map(|i| 0.2 * f64::from(i)).collect();
        values[19] = 70.0;
        let (width, counts) = count(&values);
        assert_eq!((width, counts.len()), (0.5, 8));
        // 3.6 and 70.
        assert_eq!(counts[7], 2);
    }

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

    #[test]
    fn numbers_are_short() {
        for (x, text) in [
            (0.0, "0"),
            (0.025, "0.025"),
            (0.1 + 0.2, "0.3"),
            (1234.0, "1234"),
        ] {
            assert_eq!(number(x), text);
        }
    }
}
