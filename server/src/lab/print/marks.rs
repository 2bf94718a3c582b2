//! What is printed round the roundels: cut marks, the ruler that checks the printer, small print.

use roundel_core::marker::Polarity;

use super::{
    page::{PageSize, Shape, TextAnchor},
    page_layout::{EDGE_MM, FOOT_MM, PrintItem, RULER_MM},
    path::{Area, Place},
};

/// Length of a cut mark, and how far it stays from the square, millimetres.
pub(super) const CUT_MM: f64 = 3.0;
pub(super) const CUT_GAP_MM: f64 = 0.5;
/// Longest ruler, millimetres.
const MAX_RULER_MM: f64 = 100.0;
/// Lengths of the ruler's marks at each half and each whole centimetre, millimetres.
const TICKS_MM: (f64, f64) = (1.5, 3.0);
/// Height of capitals of the small print, millimetres.
const SMALL_MM: f64 = 1.8;
/// Below this it cannot be read, millimetres.
const MIN_TEXT_MM: f64 = 0.8;
/// Width of a character over the height of capitals, about.
const CHARACTER: f64 = 0.8;
/// Length of a mark where sheets meet, and how far it stays from the window, millimetres.
const JOIN_MM: f64 = 1.5;
const JOIN_GAP_MM: f64 = 0.3;

/// Marks in line with a square's sides, at its corners.
pub(super) fn cut_marks(square: &Area) -> Vec<Shape> {
    let mut marks = Vec::with_capacity(8);
    for (x, away_x) in [(square.left, -1.0), (square.right, 1.0)] {
        for (y, away_y) in [(square.top, -1.0), (square.bottom, 1.0)] {
            let (from, to) = (CUT_GAP_MM, CUT_GAP_MM + CUT_MM);
            let line = |from, to| Shape::Line { from, to };
            marks.push(line(Place::new(x + away_x * from, y), Place::new(x + away_x * to, y)));
            marks.push(line(Place::new(x, y + away_y * from), Place::new(x, y + away_y * to)));
        }
    }
    marks
}

/// Label and size in the square's lower corners, where they stay after cutting and no rim is near. Where they cannot be, on
/// black or too small to be read, they stand below the square, and tell what is what until it is cut out.
pub(super) fn corner_labels(item: &PrintItem, square: &Area) -> Vec<Shape> {
    let outer_mm = item.kind.outer_diameter_m * 1e3;
    let height_mm = (outer_mm * 0.04).min(SMALL_MM * 1.5);
    let size = format!("{} mm", super::millimetres(outer_mm));
    if height_mm < MIN_TEXT_MM || item.kind.polarity == Polarity::WhiteRing {
        return below(&item.label, &size, square).into_iter().collect();
    }
    let inset = 0.6 * height_mm;
    let text = |x, anchor, text| Shape::Text {
        at: Place::new(x, square.bottom - inset),
        anchor,
        height_mm,
        text,
    };
    vec![
        text(square.left + inset, TextAnchor::Begin, item.label.clone()),
        text(square.right - inset, TextAnchor::End, size),
    ]
}

/// Both in the middle of the gap between the cut marks, or what has room there: the label counts.
fn below(label: &str, size: &str, square: &Area) -> Option<Shape> {
    let both =
        [label, size].into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join(" ");
    // Neighbours have as much of a gap, of which each may take half.
    let room_mm = square.width() + CUT_MM;
    let fits = |text: &str| room_mm / (CHARACTER * text.chars().count() as f64);
    let texts = [both.as_str(), label, size].into_iter().filter(|text| !text.is_empty());
    let (text, height_mm) = texts
        .map(|text| (text, fits(text).min(SMALL_MM)))
        .find(|(_, height_mm)| *height_mm >= MIN_TEXT_MM)?;
    Some(Shape::Text {
        at: Place::new((square.left + square.right) / 2.0, square.bottom + CUT_GAP_MM + height_mm),
        anchor: TextAnchor::Middle,
        height_mm,
        text: text.to_owned(),
    })
}

/// The small print at the foot of a page, and a ruler along the foot and one up the right.
pub(super) fn footer(page: PageSize, about: &str) -> Vec<Shape> {
    let (foot_y, right_x) =
        (page.height_mm - EDGE_MM - FOOT_MM + 5.0, page.width_mm - EDGE_MM - RULER_MM + 3.0);
    let length = |room_mm: f64| ((room_mm / 10.0).floor() * 10.0).min(MAX_RULER_MM);
    let across = length(page.width_mm - 2.0 * EDGE_MM - RULER_MM);
    let up = length(page.height_mm - 2.0 * EDGE_MM - FOOT_MM);
    let mut shapes = vec![
        Shape::Line { from: Place::new(EDGE_MM, foot_y), to: Place::new(EDGE_MM + across, foot_y) },
        Shape::Line { from: Place::new(right_x, EDGE_MM), to: Place::new(right_x, EDGE_MM + up) },
    ];
    let tick = |index: usize| if index.is_multiple_of(2) { TICKS_MM.1 } else { TICKS_MM.0 };
    for index in 0..=(across / 5.0).round() as usize {
        let x = EDGE_MM + 5.0 * index as f64;
        shapes.push(Shape::Line {
            from: Place::new(x, foot_y),
            to: Place::new(x, foot_y - tick(index)),
        });
    }
    for index in 0..=(up / 5.0).round() as usize {
        let y = EDGE_MM + 5.0 * index as f64;
        shapes.push(Shape::Line {
            from: Place::new(right_x, y),
            to: Place::new(right_x + tick(index), y),
        });
    }
    let lines = [
        about.to_owned(),
        format!(
            "Print at 100 %, not fitted to the page: the rulers measure {across} mm across and {up} mm down."
        ),
    ];
    for (index, text) in lines.into_iter().enumerate() {
        shapes.push(Shape::Text {
            at: Place::new(EDGE_MM, foot_y + 3.2 + 3.0 * index as f64),
            anchor: TextAnchor::Begin,
            height_mm: SMALL_MM,
            text,
        });
    }
    shapes
}

/// Where sheets of one large roundel meet, marked outside of their windows: the left and the upper edge are
/// cut off at the window where a sheet joins there, and laid on the line that the other sheet's marks span.
/// `sides`: whether there is a sheet to the left, right, top and bottom.
pub(super) fn join_marks(window: &Area, overlap_mm: f64, sides: [bool; 4]) -> Vec<Shape> {
    let [left, right, top, bottom] = sides;
    let beyond = [JOIN_GAP_MM, JOIN_GAP_MM + JOIN_MM];
    let mut marks = Vec::new();
    for (is_there, x) in [(left, window.left), (right, window.right - overlap_mm)] {
        if is_there {
            let above = beyond.map(|away| Place::new(x, window.top - away));
            let below = beyond.map(|away| Place::new(x, window.bottom + away));
            marks.extend([above, below].map(|[from, to]| Shape::Line { from, to }));
        }
    }
    for (is_there, y) in [(top, window.top), (bottom, window.bottom - overlap_mm)] {
        if is_there {
            let before = beyond.map(|away| Place::new(window.left - away, y));
            let behind = beyond.map(|away| Place::new(window.right + away, y));
            marks.extend([before, behind].map(|[from, to]| Shape::Line { from, to }));
        }
    }
    marks
}

/// Whether a mark lies in an area as a whole.
pub(super) fn is_inside(shape: &Shape, area: &Area) -> bool {
    let holds = |place: &Place| {
        (area.left..=area.right).contains(&place.x) && (area.top..=area.bottom).contains(&place.y)
    };
    match shape {
        Shape::Line { from, to } => holds(from) && holds(to),
        Shape::Text { at, .. } => holds(at),
    }
}

#[cfg(test)]
mod tests {
    use roundel_core::marker::Kind;

    use super::*;

    fn texts(outer_mm: f64, polarity: Polarity, label: &str) -> Vec<(String, Place)> {
        let kind = Kind { polarity, ..Kind::plain("", outer_mm * 1e-3, 0.4e-3 * outer_mm) };
        let item = PrintItem { kind, number: None, label: label.to_owned() };
        let square = Area::square(Place::new(50.0, 50.0), 1.35 * outer_mm);
        let text = |shape: Shape| match shape {
            Shape::Text { at, height_mm, text, .. } => {
                assert!((MIN_TEXT_MM..=1.5 * SMALL_MM).contains(&height_mm), "{text}: {height_mm}");
                (text, at)
            }
            Shape::Line { .. } => panic!("a line"),
        };
        corner_labels(&item, &square).into_iter().map(text).collect()
    }

    #[test]
    fn every_print_says_what_it_is() {
        let words = |outer_mm: f64, polarity: Polarity, label: &str| -> Vec<String> {
            texts(outer_mm, polarity, label).into_iter().map(|(text, _)| text).collect()
        };
        let (black, white) = (Polarity::BlackRing, Polarity::WhiteRing);
        assert_eq!(words(50.0, black, "#17"), ["#17", "50 mm"]);
        assert_eq!(words(50.0, white, "#17"), ["#17 50 mm"]);
        assert_eq!(words(12.0, black, "robot #17"), ["robot #17 12 mm"]);
        assert_eq!(words(2.0, black, "#1017"), ["#1017"]);
        assert_eq!(words(12.0, white, ""), ["12 mm"]);
        // Outside of what is black.
        for (_, at) in texts(50.0, white, "#17") {
            assert!(at.y > 50.0 + 1.35 * 25.0 && at.x == 50.0);
        }
    }
}
