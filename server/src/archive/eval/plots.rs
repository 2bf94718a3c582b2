//! An evaluation as pictures (SVG): where all went, from above, and how far off it was over time.

use std::{fs, io, ops::Range, path::Path};

use plotters::{
    chart::ChartBuilder,
    prelude::{IntoDrawingArea, LineSeries, Palette, Palette99, PathElement, SVGBackend},
    style::{BLACK, Color, RGBColor, WHITE},
};
use roundel_core::time::Timestamp;

use super::metrics::{EvalMetrics, errors};

const SIZE: (u32, u32) = (900, 600);
const TRUTH: RGBColor = RGBColor(150, 150, 150);

/// Draws `above.svg` and `error.svg` into a folder, which is made if it is not there.
pub fn draw(metrics: &EvalMetrics, folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let drawn = [("above.svg", plot_top_view(metrics)), ("error.svg", plot_errors(metrics))];
    for (name, picture) in drawn {
        let picture = picture.map_err(|error| io::Error::other(error.to_string()))?;
        fs::write(folder.join(name), picture)?;
    }
    Ok(())
}

type PlotResult = Result<String, Box<dyn std::error::Error>>;

fn plot_top_view(metrics: &EvalMetrics) -> PlotResult {
    let each = metrics.objects.iter();
    let truths = each.clone().map(|object| {
        object.pairs.iter().map(|pair| (pair.truth.position_m.x, pair.truth.position_m.y)).collect()
    });
    let truths: Vec<Vec<(f64, f64)>> = truths.collect();
    let moved = each.map(|object| {
        let place = |pair: &super::align::Pair| {
            let point = nalgebra::Point3::from(pair.estimate.position_m);
            let place = metrics.truth_from_estimate * point;
            (place.x, place.y)
        };
        object.pairs.iter().map(place).collect()
    });
    let moved: Vec<Vec<(f64, f64)>> = moved.collect();
    let all = || truths.iter().chain(&moved).flatten();
    let (mut xs, mut ys) = (range(all().map(|it| it.0)), range(all().map(|it| it.1)));
    // A metre is as long in both ways.
    let scale = ((xs.end - xs.start) / 1.5).max(ys.end - ys.start);
    xs = about(&xs, scale * 1.5);
    ys = about(&ys, scale);
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .caption("from above: truth grey, recording coloured", ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(48)
            .build_cartesian_2d(xs, ys)?;
        chart.configure_mesh().x_desc("x, m").y_desc("y, m").draw()?;
        for line in truths {
            chart.draw_series(LineSeries::new(line, TRUTH.stroke_width(3)))?;
        }
        for (index, line) in moved.into_iter().enumerate() {
            chart.draw_series(LineSeries::new(line, Palette99::pick(index).stroke_width(1)))?;
        }
        root.present()?;
    }
    Ok(text)
}

fn plot_errors(metrics: &EvalMetrics) -> PlotResult {
    let begin = metrics.objects.iter().filter_map(|it| it.pairs.first()).map(|it| it.estimate.time);
    let begin: Timestamp = begin.min().unwrap_or_default();
    let lines: Vec<(String, Vec<(f64, f64)>)> = metrics
        .objects
        .iter()
        .map(|object| {
            let errors = errors(&object.pairs, &metrics.truth_from_estimate);
            let point = |(pair, error): (&super::align::Pair, &nalgebra::Vector3<f64>)| {
                (pair.estimate.time.seconds_since(begin), error.norm() * 1e3)
            };
            (object.name.clone(), object.pairs.iter().zip(&errors).map(point).collect())
        })
        .collect();
    let all = || lines.iter().flat_map(|(_, line)| line);
    let (times, most) = (range(all().map(|it| it.0)), range(all().map(|it| it.1)).end);
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .caption("distance from the truth", ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(56)
            .build_cartesian_2d(times, 0.0..most)?;
        chart.configure_mesh().x_desc("s").y_desc("mm").draw()?;
        for (index, (name, line)) in lines.into_iter().enumerate() {
            let color = Palette99::pick(index).to_rgba();
            chart
                .draw_series(LineSeries::new(line, color.stroke_width(1)))?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], color));
        }
        chart
            .configure_series_labels()
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK)
            .draw()?;
        root.present()?;
    }
    Ok(text)
}

/// From the least to the most, never empty.
fn range(numbers: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = numbers
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), it| (low.min(it), high.max(it)));
    if !low.is_finite() {
        return 0.0..1.0;
    }
    let margin = ((high - low) * 0.05).max(1e-3);
    low - margin..high + margin
}

fn about(range: &Range<f64>, length: f64) -> Range<f64> {
    let middle = (range.start + range.end) / 2.0;
    middle - length / 2.0..middle + length / 2.0
}
