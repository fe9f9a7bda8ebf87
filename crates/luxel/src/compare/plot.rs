//! The plot of a comparison: measured error against time, both in decades.

use super::{Comparison, Curve};
use plotters::coord::Shift;
use plotters::prelude::*;

const SIZE: (u32, u32) = (1280, 560);
const FONT: &str = "sans-serif";
/// Smaller errors are drawn here.
const LEAST_PERCENT: f64 = 1e-3;

/// Colours that people with any colour vision tell apart [Okabe08], then some more.
const COLOURS: [RGBColor; 10] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
    RGBColor(140, 86, 75),
    RGBColor(127, 127, 127),
    RGBColor(188, 189, 34),
];

/// An SVG picture.
pub(super) fn svg(comparison: &Comparison) -> String {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        // Drawing into a string does not fail.
        draw(comparison, &area).expect("a string takes all");
        area.present().expect("a string takes all");
    }
    text
}

fn draw(
    comparison: &Comparison,
    area: &DrawingArea<SVGBackend<'_>, Shift>,
) -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
    area.fill(&WHITE)?;
    let caption = format!(
        "{}: {} elements, {} mesh",
        comparison.scene,
        comparison.elements,
        comparison.mesh.name()
    );
    let (left, right) = area
        .titled(&caption, (FONT, 22))?
        .split_horizontally(SIZE.0 / 2);
    // What an answer takes from the front on, and what one more takes after it.
    panel(comparison, &left, true, "seconds, form factors included")?;
    panel(comparison, &right, false, "seconds of solving alone")
}

/// One of the two charts.
fn panel(
    comparison: &Comparison,
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    with_factors: bool,
    times: &str,
) -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
    let points = |curve: &Curve| -> Vec<(f64, f64)> {
        let setup = if with_factors { curve.setup.wall } else { 0.0 };
        let samples = curve.samples.iter();
        samples
            .map(|s| (setup + s.seconds.wall, 100.0 * s.error))
            .filter(|p| p.0 > 0.0 && p.1 > 0.0)
            .collect()
    };
    let all: Vec<(f64, f64)> = comparison.curves.iter().flat_map(points).collect();
    // Errors below what anyone asks for would take the room of those that matter.
    let mut errors = decades(all.iter().map(|p| p.1));
    errors.start = errors.start.max(LEAST_PERCENT).min(0.1 * errors.end);
    let floor = errors.start;
    let mut chart = ChartBuilder::on(area)
        .margin(16)
        .x_label_area_size(48)
        .y_label_area_size(72)
        .build_cartesian_2d(
            decades(all.iter().map(|p| p.0)).log_scale(),
            errors.log_scale(),
        )?;
    chart
        .configure_mesh()
        .x_desc(times)
        .y_desc("error of element exitance, %")
        .label_style((FONT, 15))
        .axis_desc_style((FONT, 16))
        .bold_line_style(RGBColor(205, 205, 205))
        .light_line_style(RGBColor(240, 240, 240))
        .x_label_formatter(&|x| short(*x))
        .y_label_formatter(&|y| short(*y))
        .draw()?;
    for (k, curve) in comparison.curves.iter().enumerate() {
        let colour = COLOURS[k % COLOURS.len()];
        let lowered = |(t, e): (f64, f64)| (t, e.max(floor));
        let line: Vec<(f64, f64)> = points(curve).into_iter().map(lowered).collect();
        chart.draw_series(line.iter().map(|&p| Circle::new(p, 3, colour.filled())))?;
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)))?
            .label(curve.solver.name())
            .legend(move |(x, y)| {
                PathElement::new(vec![(x, y), (x + 24, y)], colour.stroke_width(3))
            });
    }
    if with_factors {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerLeft)
            .label_font((FONT, 15))
            .background_style(WHITE.mix(0.85))
            .border_style(RGBColor(205, 205, 205))
            .draw()?;
    }
    Ok(())
}

/// Whole powers of ten around values above zero.
fn decades(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
    if low > high {
        return 0.1..1.0;
    }
    let start = low.log10().floor().max(-9.0);
    10f64.powf(start)..10f64.powf(high.log10().ceil().max(start + 1.0))
}

/// A power of ten as people write it.
fn short(value: f64) -> String {
    if (1e-4..1e5).contains(&value) {
        format!("{value:.4}")
            .trim_end_matches('0')
            .trim_end_matches('.')
            .to_owned()
    } else {
        format!("{value:.0e}")
    }
}
