//! Plots of an evaluation as SVG: trajectories from above, and errors over time.

use std::{fs, io, ops::Range, path::Path};

use kurbo::{Point, Rect, Size};
use nalgebra::Point3;
use roundel_core::time::Timestamp;

use super::{align::error_m, metrics::EvalMetrics};
use crate::lab::drawing::{Anchor, Axes, Color, Drawing, LETTER_PX, Shape};

const SIZE: Size = Size::new(900.0, 600.0);
const AREA: Rect = Rect::new(70.0, 48.0, 880.0, 548.0);
const TRUTH: Color = [150; 3];
/// Repeated colours of objects.
const OBJECTS: [Color; 6] =
    [[0, 114, 178], [213, 94, 0], [0, 158, 115], [204, 121, 167], [230, 159, 0], [86, 180, 233]];

/// Draws `above.svg` and `error.svg` into a folder, which is created if necessary.
pub fn draw(metrics: &EvalMetrics, folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    fs::write(folder.join("above.svg"), plot_top_view(metrics).svg("px"))?;
    fs::write(folder.join("error.svg"), plot_errors(metrics).svg("px"))
}

/// A line of a chart through pairs of values.
struct Curve {
    points: Vec<(f64, f64)>,
    width: f64,
    color: Color,
}

fn plot_top_view(metrics: &EvalMetrics) -> Drawing {
    let truths = metrics.objects.iter().map(|object| {
        let truth = object.pairs.iter().map(|pair| &pair.truth.position_m);
        Curve { points: truth.map(|at| (at.x, at.y)).collect(), width: 3.0, color: TRUTH }
    });
    let moved = metrics.objects.iter().zip(OBJECTS.iter().cycle()).map(|(object, &color)| {
        let estimates = object.pairs.iter().map(|pair| Point3::from(pair.estimate.position_m));
        let moved = estimates.map(|at| metrics.truth_from_estimate * at);
        Curve { points: moved.map(|at| (at.x, at.y)).collect(), width: 1.0, color }
    });
    let curves: Vec<Curve> = truths.chain(moved).collect();
    let (mut x, mut y) = (range(&curves, |it| it.0), range(&curves, |it| it.1));
    // Both axes have the same scale.
    let metres_per_px = ((x.end - x.start) / AREA.width()).max((y.end - y.start) / AREA.height());
    x = widened(&x, metres_per_px * AREA.width());
    y = widened(&y, metres_per_px * AREA.height());
    chart(&curves, (x, y), "from above: truth grey, recording coloured", ["x, m", "y, m"])
}

fn plot_errors(metrics: &EvalMetrics) -> Drawing {
    let begin = metrics.objects.iter().filter_map(|it| it.pairs.first()).map(|it| it.estimate.time);
    let begin: Timestamp = begin.min().unwrap_or_default();
    let curves = metrics.objects.iter().zip(OBJECTS.iter().cycle()).map(|(object, &color)| {
        let points = object.pairs.iter().map(|pair| {
            let error_mm = error_m(pair, &metrics.truth_from_estimate).norm() * 1e3;
            (pair.estimate.time.seconds_since(begin), error_mm)
        });
        Curve { points: points.collect(), width: 1.0, color }
    });
    let curves: Vec<Curve> = curves.collect();
    let (times, most) = (range(&curves, |it| it.0), range(&curves, |it| it.1).end);
    let mut drawing = chart(&curves, (times, 0.0..most), "distance from the truth", ["s", "mm"]);
    for ((object, curve), line) in metrics.objects.iter().zip(&curves).zip(1..) {
        let at = Point::new(AREA.x1 - 30.0, AREA.y0 + 18.0 * f64::from(line));
        let sample = [at - (0.0, 5.0), at + (20.0, -5.0)];
        drawing.shapes.push(Shape::polyline(sample, 2.0, curve.color));
        drawing.shapes.push(Shape::text(at - (8.0, 0.0), Anchor::End, LETTER_PX, &object.name));
    }
    drawing
}

fn chart(
    curves: &[Curve],
    (x, y): (Range<f64>, Range<f64>),
    title: &str,
    names: [&str; 2],
) -> Drawing {
    let axes = Axes { area: AREA, x, y };
    let mut shapes = axes.grid();
    shapes.extend(curves.iter().map(|curve| {
        let points = curve.points.iter().map(|&(x, y)| axes.point(x, y));
        Shape::polyline(points, curve.width, curve.color)
    }));
    shapes.extend(axes.frame(names));
    let at = Point::new(AREA.center().x, AREA.y0 - 18.0);
    shapes.push(Shape::text(at, Anchor::Middle, LETTER_PX, title));
    Drawing { size: SIZE, shapes }
}

/// The values of all curves with a margin, never empty.
fn range(curves: &[Curve], value: impl Fn(&(f64, f64)) -> f64) -> Range<f64> {
    let values = curves.iter().flat_map(|curve| &curve.points).map(value);
    let (low, high) = values
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), it| (low.min(it), high.max(it)));
    if !low.is_finite() {
        return 0.0..1.0;
    }
    let margin = ((high - low) * 0.05).max(1e-3);
    low - margin..high + margin
}

fn widened(range: &Range<f64>, length: f64) -> Range<f64> {
    let middle = (range.start + range.end) / 2.0;
    middle - length / 2.0..middle + length / 2.0
}
