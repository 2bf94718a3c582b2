//! A bitmap font of three by five dots: capitals, digits and the signs of numbers.

use kurbo::{BezPath, Point, Rect, Shape as _};

use super::{Anchor, TOLERANCE};

const COLUMNS: usize = 3;
const ROWS: usize = 5;
/// Dots from one character to the next.
const ADVANCE: usize = COLUMNS + 1;

/// The width of a text with capitals of that height, including a gap of one dot at its end.
pub(crate) fn width(text: &str, height: f64) -> f64 {
    (text.chars().count() * ADVANCE) as f64 * height / ROWS as f64
}

/// The dots of a text.
pub(super) fn outline(text: &str, at: Point, anchor: Anchor, height: f64) -> BezPath {
    let dot = height / ROWS as f64;
    let origin = at - (anchor.share() * width(text, height), height);
    let mut path = BezPath::new();
    for (index, character) in text.chars().enumerate() {
        for (row, bits) in rows(character).into_iter().enumerate() {
            for column in (0..COLUMNS).filter(|column| bits >> (COLUMNS - 1 - column) & 1 == 1) {
                let (x, y) = ((index * ADVANCE + column) as f64 * dot, row as f64 * dot);
                let corner = origin + (x, y);
                path.extend(Rect::from_origin_size(corner, (dot, dot)).path_elements(TOLERANCE));
            }
        }
    }
    path
}

/// The rows of a character from the top, with the left dot in the highest of three bits. Lower case is drawn as upper
/// case, and unknown characters are blank.
fn rows(character: char) -> [u8; ROWS] {
    match character.to_ascii_uppercase() {
        '0' | 'O' => [0b111, 0b101, 0b101, 0b101, 0b111],
        '1' => [0b010, 0b110, 0b010, 0b010, 0b111],
        '2' => [0b111, 0b001, 0b111, 0b100, 0b111],
        '3' => [0b111, 0b001, 0b111, 0b001, 0b111],
        '4' => [0b101, 0b101, 0b111, 0b001, 0b001],
        '5' => [0b111, 0b100, 0b111, 0b001, 0b111],
        '6' => [0b111, 0b100, 0b111, 0b101, 0b111],
        '7' => [0b111, 0b001, 0b010, 0b010, 0b010],
        '8' => [0b111, 0b101, 0b111, 0b101, 0b111],
        '9' => [0b111, 0b101, 0b111, 0b001, 0b111],
        'A' => [0b010, 0b101, 0b111, 0b101, 0b101],
        'B' => [0b110, 0b101, 0b110, 0b101, 0b110],
        'C' => [0b011, 0b100, 0b100, 0b100, 0b011],
        'D' => [0b110, 0b101, 0b101, 0b101, 0b110],
        'E' => [0b111, 0b100, 0b110, 0b100, 0b111],
        'F' => [0b111, 0b100, 0b110, 0b100, 0b100],
        'G' => [0b011, 0b100, 0b101, 0b101, 0b011],
        'H' => [0b101, 0b101, 0b111, 0b101, 0b101],
        'I' => [0b111, 0b010, 0b010, 0b010, 0b111],
        'J' => [0b001, 0b001, 0b001, 0b101, 0b010],
        'K' => [0b101, 0b101, 0b110, 0b101, 0b101],
        'L' => [0b100, 0b100, 0b100, 0b100, 0b111],
        'M' => [0b101, 0b111, 0b111, 0b101, 0b101],
        'N' => [0b111, 0b101, 0b101, 0b101, 0b101],
        'P' => [0b110, 0b101, 0b110, 0b100, 0b100],
        'Q' => [0b111, 0b101, 0b101, 0b111, 0b001],
        'R' => [0b110, 0b101, 0b110, 0b101, 0b101],
        'S' => [0b011, 0b100, 0b010, 0b001, 0b110],
        'T' => [0b111, 0b010, 0b010, 0b010, 0b010],
        'U' => [0b101, 0b101, 0b101, 0b101, 0b111],
        'V' => [0b101, 0b101, 0b101, 0b101, 0b010],
        'W' => [0b101, 0b101, 0b111, 0b111, 0b101],
        'X' => [0b101, 0b101, 0b010, 0b101, 0b101],
        'Y' => [0b101, 0b101, 0b010, 0b010, 0b010],
        'Z' => [0b111, 0b001, 0b010, 0b100, 0b111],
        '#' => [0b101, 0b111, 0b101, 0b111, 0b101],
        '.' => [0b000, 0b000, 0b000, 0b000, 0b010],
        ',' => [0b000, 0b000, 0b000, 0b010, 0b100],
        ':' => [0b000, 0b010, 0b000, 0b010, 0b000],
        ';' => [0b000, 0b010, 0b000, 0b010, 0b100],
        '-' => [0b000, 0b000, 0b111, 0b000, 0b000],
        '_' => [0b000, 0b000, 0b000, 0b000, 0b111],
        '+' => [0b000, 0b010, 0b111, 0b010, 0b000],
        '=' => [0b000, 0b111, 0b000, 0b111, 0b000],
        '/' => [0b001, 0b001, 0b010, 0b100, 0b100],
        '%' => [0b101, 0b001, 0b010, 0b100, 0b101],
        '(' => [0b001, 0b010, 0b010, 0b010, 0b001],
        ')' => [0b100, 0b010, 0b010, 0b010, 0b100],
        _ => [0; ROWS],
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    #[test]
    fn characters_are_distinct() {
        let mut known = HashMap::new();
        for character in ('0'..='9').chain('A'..='Z').chain("# .,:;-_+=/%()".chars()) {
            if let Some(other) = known.insert(rows(character), character) {
                assert_eq!((other, character), ('0', 'O'), "these look alike");
            }
            assert_eq!(rows(character), rows(character.to_ascii_lowercase()));
        }
    }
}
