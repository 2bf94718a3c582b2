//! Writes panels of curves as one SVG file: two panels a row, one legend above them.

use std::{fmt::Write, path::Path};

use anyhow::Context;

pub struct Curve {
    pub style: Style,
    pub points: Vec<(f64, f64)>,
}

/// A curve has the same name and color in all panels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Style {
    Fast,
    Precise,
    Bound,
}

impl Style {
    fn name_and_color(self) -> (&'static str, &'static str) {
        match self {
            Style::Fast => ("fast", "#d07010"),
            Style::Precise => ("precise", "#1860a8"),
            Style::Bound => ("Cramér-Rao bound", "#707070"),
        }
    }
}

/// One plot with its axes. The y axis is logarithmic.
pub struct Panel {
    pub title: String,
    pub x_name: &'static str,
    pub y_name: &'static str,
    pub log_x: bool,
    pub curves: Vec<Curve>,
}

/// Width and height of a panel with its labels.
const PANEL: (f64, f64) = (420.0, 270.0);
/// The plot within a panel: left, top, right, bottom.
const PLOT: [f64; 4] = [56.0, 28.0, 408.0, 226.0];
/// Height of the legend.
const LEGEND: f64 = 26.0;

/// Writes the panels to a file, and prints their points.
pub fn draw(path: &Path, panels: &[Panel]) -> anyhow::Result<()> {
    panels.iter().for_each(print);
    let text = svg(panels);
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

fn svg(panels: &[Panel]) -> String {
    let (width, height) = (2.0 * PANEL.0, LEGEND + PANEL.1 * panels.len().div_ceil(2) as f64);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n\
         <style>.g{{stroke:#e4e4e4}}.t{{font-size:13px}}.m{{text-anchor:middle}}.e{{text-anchor:end}}\
         polyline{{fill:none;stroke-width:1.8}}</style>\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    legend(&mut svg, panels);
    for (index, panel) in panels.iter().enumerate() {
        let (x, y) = (PANEL.0 * (index % 2) as f64, LEGEND + PANEL.1 * (index / 2) as f64);
        append(&mut svg, format_args!("<g transform=\"translate({x} {y})\">\n"));
        draw_panel(&mut svg, panel);
        append(&mut svg, format_args!("</g>\n"));
    }
    svg.push_str("</svg>\n");
    svg
}

fn append(svg: &mut String, text: std::fmt::Arguments<'_>) {
    svg.write_fmt(text).expect("writing to a string does not fail");
}

fn legend(svg: &mut String, panels: &[Panel]) {
    let mut x = PLOT[0];
    for curve in &panels[0].curves {
        let (name, color) = curve.style.name_and_color();
        append(
            svg,
            format_args!(
                "<path d=\"M{x} 14h20\" stroke=\"{color}\" stroke-width=\"3\"/>\
                 <text x=\"{}\" y=\"18\" class=\"t\">{name}</text>\n",
                x + 26.0
            ),
        );
        x += 56.0 + 7.0 * name.chars().count() as f64;
    }
}

fn draw_panel(svg: &mut String, panel: &Panel) {
    let points = || panel.curves.iter().flat_map(|curve| &curve.points);
    let [left, top, right, bottom] = PLOT;
    let x = Axis::over(points().map(|point| point.0), panel.log_x, (left + 6.0, right - 6.0));
    let y = Axis::over(points().map(|point| point.1), true, (bottom - 6.0, top + 6.0));
    for tick in x.ticks() {
        let at = x.place(tick);
        append(
            svg,
            format_args!(
                "<path class=\"g\" d=\"M{at:.1} {top}V{bottom}\"/>\
                 <text class=\"m\" x=\"{at:.1}\" y=\"{}\">{}</text>\n",
                bottom + 14.0,
                short(tick)
            ),
        );
    }
    for tick in y.ticks() {
        let at = y.place(tick);
        append(
            svg,
            format_args!(
                "<path class=\"g\" d=\"M{left} {at:.1}H{right}\"/>\
                 <text class=\"e\" x=\"{}\" y=\"{:.1}\">{}</text>\n",
                left - 5.0,
                at + 4.0,
                short(tick)
            ),
        );
    }
    let (middle, half) = (0.5 * (left + right), 0.5 * (top + bottom));
    append(
        svg,
        format_args!(
            "<path d=\"M{left} {top}V{bottom}H{right}\" fill=\"none\" stroke=\"#333\"/>\
             <text class=\"m t\" x=\"{middle}\" y=\"18\">{}</text>\
             <text class=\"m\" x=\"{middle}\" y=\"{}\">{}</text>\
             <text class=\"m\" transform=\"translate(13 {half}) rotate(-90)\">{}</text>\n",
            panel.title,
            bottom + 31.0,
            panel.x_name,
            panel.y_name
        ),
    );
    for curve in &panel.curves {
        draw_curve(svg, curve, &x, &y);
    }
}

fn draw_curve(svg: &mut String, curve: &Curve, x: &Axis, y: &Axis) {
    let color = curve.style.name_and_color().1;
    let places = curve.points.iter().map(|point| (x.place(point.0), y.place(point.1)));
    let list: Vec<_> = places.clone().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    append(svg, format_args!("<polyline points=\"{}\" stroke=\"{color}\"/>\n", list.join(" ")));
    if curve.style != Style::Bound {
        let dots = places.map(|(x, y)| format!("M{x:.1} {y:.1}h0")).collect::<String>();
        append(
            svg,
            format_args!(
                "<path d=\"{dots}\" stroke=\"{color}\" stroke-width=\"5\" stroke-linecap=\"round\"/>\n"
            ),
        );
    }
}

/// Maps values to positions, linearly or by logarithm.
struct Axis {
    log: bool,
    values: (f64, f64),
    places: (f64, f64),
}

impl Axis {
    fn over(values: impl Iterator<Item = f64>, log: bool, places: (f64, f64)) -> Self {
        let (low, high) = values
            .fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
        // A logarithmic axis covers a factor of four at least, so that noise does not look like a trend.
        let widen = if log { (4.0 * low / high).max(1.0).sqrt() } else { 1.0 };
        Self { log, values: (low / widen, high * widen), places }
    }

    fn place(&self, value: f64) -> f64 {
        let scale = |value: f64| if self.log { value.ln() } else { value };
        let (low, high) = (scale(self.values.0), scale(self.values.1));
        self.places.0 + (self.places.1 - self.places.0) * (scale(value) - low) / (high - low)
    }

    /// Logarithmic: 1, 2 and 5 of each decade, and more on a short axis. Linear: four to ten even steps.
    fn ticks(&self) -> Vec<f64> {
        let (low, high) = self.values;
        let decade = |value: f64| value.log10().floor() as i32;
        let steps = |power: i32| [1.0, 2.0, 5.0].map(|step| step * 10f64.powi(power));
        let more = |power: i32| [1.0, 1.5, 2.0, 3.0, 5.0, 7.0].map(|step| step * 10f64.powi(power));
        let inside = |tick: &f64| (0.999 * low..=1.001 * high).contains(tick);
        if self.log && high < 8.0 * low {
            return (decade(low)..=decade(high)).flat_map(more).filter(inside).collect();
        }
        if self.log {
            return (decade(low)..=decade(high)).flat_map(steps).filter(inside).collect();
        }
        let min_step = (high - low) / 10.0;
        let step = steps(decade(min_step)).into_iter().find(|step| *step >= min_step);
        let step = step.unwrap_or(10f64.powi(decade(min_step) + 1));
        let first = (low / step).ceil() as i64;
        (first..=(high / step * 1.0001).floor() as i64).map(|i| i as f64 * step).collect()
    }
}

/// Two significant digits, or all before the decimal point.
fn short(value: f64) -> String {
    let digits = (1.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

fn print(panel: &Panel) {
    println!("\n{}; {} → {}", panel.title, panel.x_name, panel.y_name);
    for curve in &panel.curves {
        let points: Vec<_> =
            curve.points.iter().map(|(x, y)| format!("{}: {}", short(*x), short(*y))).collect();
        println!("  {:17} {}", curve.style.name_and_color().0, points.join(", "));
    }
}
