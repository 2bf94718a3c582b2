//! A drawing as SVG.

use kurbo::{BezPath, PathEl, Point, Shape as _};
use svg::{
    Document,
    node::element::{ClipPath, Group, Path, Rectangle, Text},
};

use super::{Anchor, CAPITAL, Color, Drawing, Shape, TOLERANCE};

impl Drawing {
    /// The SVG document; `unit` is the unit of the drawing, such as `mm` or `px`.
    pub(crate) fn svg(&self, unit: &str) -> String {
        let (width, height) = (self.size.width, self.size.height);
        let paper = Rectangle::new().set("width", width).set("height", height).set("fill", "white");
        let mut document = Document::new()
            .set("width", format!("{width}{unit}"))
            .set("height", format!("{height}{unit}"))
            .set("viewBox", (0.0, 0.0, width, height))
            .set("font-family", "Helvetica, Arial, sans-serif")
            .add(paper);
        for shape in &self.shapes {
            document = match shape {
                Shape::Fill { path, color } => document.add(area(path).set("fill", hex(*color))),
                Shape::Line { path, width, color } => document.add(
                    area(path)
                        .set("fill", "none")
                        .set("stroke", hex(*color))
                        .set("stroke-width", *width),
                ),
                Shape::Text { at, anchor, height, text, color } => {
                    let anchor = match anchor {
                        Anchor::Start => "start",
                        Anchor::Middle => "middle",
                        Anchor::End => "end",
                    };
                    document.add(
                        Text::new(text.as_str())
                            .set("x", rounded(at.x))
                            .set("y", rounded(at.y))
                            .set("font-size", rounded(height / CAPITAL))
                            .set("text-anchor", anchor)
                            .set("fill", hex(*color)),
                    )
                }
                Shape::Clipped { window, paths } => {
                    let window = area(&window.to_path(TOLERANCE));
                    let group = Group::new().set("clip-path", "url(#window)");
                    document
                        .add(ClipPath::new().set("id", "window").add(window))
                        .add(paths.iter().fold(group, |group, path| group.add(area(path))))
                }
            };
        }
        document.to_string()
    }
}

fn area(path: &BezPath) -> Path {
    let point = |point: Point| format!("{} {} ", rounded(point.x), rounded(point.y));
    let commands = path.iter().map(|element| match element {
        PathEl::MoveTo(to) => format!("M{}", point(to)),
        PathEl::LineTo(to) => format!("L{}", point(to)),
        PathEl::QuadTo(..) => unreachable!("paths consist of lines and cubic curves"),
        PathEl::CurveTo(one, other, to) => {
            format!("C{}{}{}", point(one), point(other), point(to))
        }
        PathEl::ClosePath => "Z".to_owned(),
    });
    let data: String = commands.collect();
    Path::new().set("d", data.trim_end()).set("fill-rule", "evenodd")
}

fn hex([red, green, blue]: Color) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// To millionths: nanometres on a page.
fn rounded(length: f64) -> f64 {
    (length * 1e6).round() / 1e6
}
