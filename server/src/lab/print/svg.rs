//! A page → SVG, in millimetres.

use std::fmt::Write as _;

use svg::{
    Document,
    node::element::{ClipPath, Definitions, Group, Line, Path as Outline, Rectangle, Text},
};

use super::{
    page::{LINE_MM, Page, Shape, TextAnchor},
    path::{Path, Step},
};

/// Height of capitals over the size of common fonts.
const CAPITAL: f64 = 0.72;

/// The file's text.
pub fn svg(page: &Page) -> String {
    let (width, height) = (page.size.width_mm, page.size.height_mm);
    let paper = Rectangle::new().set("width", width).set("height", height).set("fill", "white");
    let mut window = Path::default();
    window.add_rectangle(&page.window);
    let window = ClipPath::new().set("id", "window").add(outline(&window));
    let mut prints = Group::new().set("clip-path", "url(#window)").set("fill-rule", "evenodd");
    for print in &page.prints {
        prints = prints.add(outline(print));
    }
    let mut marks = Group::new()
        .set("stroke", "black")
        .set("stroke-width", LINE_MM)
        .set("font-family", "Helvetica, Arial, sans-serif");
    for mark in &page.marks {
        marks = match mark {
            Shape::Line { from, to } => {
                let line = Line::new().set("x1", from.x).set("y1", from.y);
                marks.add(line.set("x2", to.x).set("y2", to.y))
            }
            Shape::Text { at, anchor, height_mm, text } => {
                let anchor = match anchor {
                    TextAnchor::Begin => "start",
                    TextAnchor::Middle => "middle",
                    TextAnchor::End => "end",
                };
                let text = Text::new(text.as_str()).set("x", at.x).set("y", at.y);
                let text = text.set("font-size", height_mm / CAPITAL).set("text-anchor", anchor);
                marks.add(text.set("stroke", "none"))
            }
        };
    }
    Document::new()
        .set("width", format!("{width}mm"))
        .set("height", format!("{height}mm"))
        .set("viewBox", (0.0, 0.0, width, height))
        .add(Definitions::new().add(window))
        .add(paper)
        .add(prints)
        .add(marks)
        .to_string()
}

fn outline(path: &Path) -> Outline {
    let mut data = String::new();
    for step in &path.steps {
        // Writing to a string does not fail.
        let _ = match *step {
            Step::Move(to) => write!(data, "M{:.6} {:.6}", to.x, to.y),
            Step::Line(to) => write!(data, "L{:.6} {:.6}", to.x, to.y),
            Step::Cubic(one, other, to) => write!(
                data,
                "C{:.6} {:.6} {:.6} {:.6} {:.6} {:.6}",
                one.x, one.y, other.x, other.y, to.x, to.y
            ),
            Step::Close => write!(data, "Z"),
        };
    }
    Outline::new().set("d", data)
}
