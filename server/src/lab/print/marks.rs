//! Marks around the roundels: cut marks, rulers that verify the printed scale, and small print.

use kurbo::{Point, Rect, Shape as _};
use roundel_core::marker::Polarity;

use super::page::{EDGE_MM, FOOT_MM, LINE_MM, PageSize, PrintItem, RULER_MM};
use crate::lab::drawing::{Anchor, Shape};

/// Length of a cut mark and its distance from the square, millimetres.
pub(super) const CUT_MM: f64 = 3.0;
pub(super) const CUT_GAP_MM: f64 = 0.5;
const MAX_RULER_MM: f64 = 100.0;
/// Lengths of the rulers' ticks at half and whole centimetres, millimetres.
const TICKS_MM: (f64, f64) = (1.5, 3.0);
/// Height of capitals of the small print, millimetres.
const SMALL_MM: f64 = 1.8;
/// Smallest legible height of capitals, millimetres.
const MIN_TEXT_MM: f64 = 0.8;
/// Approximate width of a character over the height of capitals.
const CHARACTER: f64 = 0.8;
/// Length of a mark where sheets meet and its distance from the window, millimetres.
const JOIN_MM: f64 = 1.5;
const JOIN_GAP_MM: f64 = 0.3;

/// Marks in line with a square's sides, at its corners.
pub(super) fn cut_marks(square: &Rect) -> Vec<Shape> {
    let mut marks = Vec::with_capacity(8);
    for (x, away_x) in [(square.x0, -1.0), (square.x1, 1.0)] {
        for (y, away_y) in [(square.y0, -1.0), (square.y1, 1.0)] {
            let (from, to) = (CUT_GAP_MM, CUT_GAP_MM + CUT_MM);
            let line = |from, to| Shape::line(from, to, LINE_MM);
            marks.push(line(Point::new(x + away_x * from, y), Point::new(x + away_x * to, y)));
            marks.push(line(Point::new(x, y + away_y * from), Point::new(x, y + away_y * to)));
        }
    }
    marks
}

/// Label and size in the square's lower corners, away from the rim and kept after cutting. On black, or where they would
/// be too small to read, they are below the square and identify it until it is cut out.
pub(super) fn corner_labels(item: &PrintItem, square: &Rect) -> Vec<Shape> {
    let outer_mm = item.kind.outer_diameter_m * 1e3;
    let height_mm = (outer_mm * 0.04).min(SMALL_MM * 1.5);
    let size = format!("{} mm", super::millimetres(outer_mm));
    if height_mm < MIN_TEXT_MM || item.kind.polarity == Polarity::WhiteRing {
        return below(&item.label, &size, square).into_iter().collect();
    }
    let inset = 0.6 * height_mm;
    let text =
        |x, anchor, text| Shape::text(Point::new(x, square.y1 - inset), anchor, height_mm, text);
    vec![
        text(square.x0 + inset, Anchor::Start, item.label.clone()),
        text(square.x1 - inset, Anchor::End, size),
    ]
}

/// Label and size in the gap between the cut marks, or one of them if only that fits, preferably the label.
fn below(label: &str, size: &str, square: &Rect) -> Option<Shape> {
    let both = format!("{label} {size}");
    // Half of the gap to each neighbour.
    let available_mm = square.width() + CUT_MM;
    let fits = |text: &str| available_mm / (CHARACTER * text.chars().count() as f64);
    let texts = [both.trim(), label, size].into_iter().filter(|text| !text.is_empty());
    let (text, height_mm) = texts
        .map(|text| (text, fits(text).min(SMALL_MM)))
        .find(|(_, height_mm)| *height_mm >= MIN_TEXT_MM)?;
    let at = Point::new(square.center().x, square.y1 + CUT_GAP_MM + height_mm);
    Some(Shape::text(at, Anchor::Middle, height_mm, text))
}

/// The small print at the foot of a page, and a ruler along the foot and one up the right.
pub(super) fn footer(page: PageSize, about: &str) -> Vec<Shape> {
    let (foot_y, right_x) =
        (page.height_mm - EDGE_MM - FOOT_MM + 5.0, page.width_mm - EDGE_MM - RULER_MM + 3.0);
    let length = |room_mm: f64| ((room_mm / 10.0).floor() * 10.0).min(MAX_RULER_MM);
    let across = length(page.width_mm - 2.0 * EDGE_MM - RULER_MM);
    let up = length(page.height_mm - 2.0 * EDGE_MM - FOOT_MM);
    let line = |from: (f64, f64), to: (f64, f64)| Shape::line(from.into(), to.into(), LINE_MM);
    let mut shapes = vec![
        line((EDGE_MM, foot_y), (EDGE_MM + across, foot_y)),
        line((right_x, EDGE_MM), (right_x, EDGE_MM + up)),
    ];
    let tick = |index: usize| if index.is_multiple_of(2) { TICKS_MM.1 } else { TICKS_MM.0 };
    for index in 0..=(across / 5.0).round() as usize {
        let x = EDGE_MM + 5.0 * index as f64;
        shapes.push(line((x, foot_y), (x, foot_y - tick(index))));
    }
    for index in 0..=(up / 5.0).round() as usize {
        let y = EDGE_MM + 5.0 * index as f64;
        shapes.push(line((right_x, y), (right_x + tick(index), y)));
    }
    let lines = [
        about.to_owned(),
        format!(
            "Print at 100 %, not fitted to the page: the rulers measure {across} mm across and {up} mm down."
        ),
    ];
    for (index, text) in lines.into_iter().enumerate() {
        let at = Point::new(EDGE_MM, foot_y + 3.2 + 3.0 * index as f64);
        shapes.push(Shape::text(at, Anchor::Start, SMALL_MM, text));
    }
    shapes
}

/// Marks outside the window where sheets of one large roundel meet: the left and upper edges of a sheet are cut at the
/// window and placed on the line between the other sheet's marks. `sides`: whether there is a sheet to the left, right,
/// top and bottom.
pub(super) fn join_marks(window: &Rect, overlap_mm: f64, sides: [bool; 4]) -> Vec<Shape> {
    let [left, right, top, bottom] = sides;
    let (from, to) = (JOIN_GAP_MM, JOIN_GAP_MM + JOIN_MM);
    let line = |x0, y0, x1, y1| Shape::line(Point::new(x0, y0), Point::new(x1, y1), LINE_MM);
    let Rect { x0, y0, x1, y1 } = *window;
    let mut marks = Vec::new();
    for (joins, x) in [(left, x0), (right, x1 - overlap_mm)] {
        if joins {
            marks.extend([line(x, y0 - from, x, y0 - to), line(x, y1 + from, x, y1 + to)]);
        }
    }
    for (joins, y) in [(top, y0), (bottom, y1 - overlap_mm)] {
        if joins {
            marks.extend([line(x0 - from, y, x0 - to, y), line(x1 + from, y, x1 + to, y)]);
        }
    }
    marks
}

/// Whether a mark lies completely in an area.
pub(super) fn is_inside(shape: &Shape, area: &Rect) -> bool {
    match shape {
        Shape::Text { at, .. } => area.contains(*at),
        Shape::Line { path, .. } | Shape::Fill { path, .. } => {
            let bounds = path.bounding_box();
            bounds == area.intersect(bounds)
        }
        Shape::Clipped { .. } => false,
    }
}

#[cfg(test)]
mod tests {
    use roundel_core::marker::Kind;

    use super::{super::roundel::square, *};

    fn texts(outer_mm: f64, polarity: Polarity, label: &str) -> Vec<(String, Point)> {
        let kind = Kind { polarity, ..Kind::plain("", outer_mm * 1e-3, 0.4e-3 * outer_mm) };
        let item = PrintItem { kind, number: None, label: label.to_owned() };
        let square = square(Point::new(50.0, 50.0), 1.35 * outer_mm);
        let text = |shape: Shape| match shape {
            Shape::Text { at, height, text, .. } => {
                assert!((MIN_TEXT_MM..=1.5 * SMALL_MM).contains(&height), "{text}: {height}");
                (text, at)
            }
            other => panic!("{other:?}"),
        };
        corner_labels(&item, &square).into_iter().map(text).collect()
    }

    #[test]
    fn every_print_is_labelled() {
        let words = |outer_mm: f64, polarity: Polarity, label: &str| -> Vec<String> {
            texts(outer_mm, polarity, label).into_iter().map(|(text, _)| text).collect()
        };
        let (black, white) = (Polarity::BlackRing, Polarity::WhiteRing);
        assert_eq!(words(50.0, black, "#17"), ["#17", "50 mm"]);
        assert_eq!(words(50.0, white, "#17"), ["#17 50 mm"]);
        assert_eq!(words(12.0, black, "robot #17"), ["robot #17 12 mm"]);
        assert_eq!(words(2.0, black, "#1017"), ["#1017"]);
        assert_eq!(words(12.0, white, ""), ["12 mm"]);
        // Outside of the black square.
        for (_, at) in texts(50.0, white, "#17") {
            assert!(at.y > 50.0 + 1.35 * 25.0 && at.x == 50.0);
        }
    }
}
