//! Chessboards of other tools as they are described on the command line: `chessboard:COLUMNSxROWS:SQUARE_MM`, counted in
//! inner corners as OpenCV and ROS count them, and `charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY`, counted in squares
//! as OpenCV counts these.

use std::collections::BTreeMap;

use roundel_core::calib::checkerboard::Checkerboard;
use thiserror::Error;

use crate::lab::print::spec;

/// So many pictures of another board are no accident.
const MIN_MISMATCHES: usize = 3;

#[derive(Clone, Debug, PartialEq)]
pub struct Chessboard {
    pub corners: Checkerboard,
    pub markers: Option<Markers>,
}

/// Markers in a ChArUco board's white squares, numbered row by row; the square at the top left is black.
#[derive(Clone, Debug, PartialEq)]
pub struct Markers {
    /// Side of the black border, metres.
    pub side_m: f64,
    /// OpenCV's name of their dictionary, such as `DICT_4X4_50`.
    pub dictionary: String,
}

/// Reads a description, `None` if the text begins with neither word.
pub fn parse(text: &str) -> Option<Result<Chessboard, String>> {
    let (word, rest) = text.split_once(':').unwrap_or((text, ""));
    match word {
        "chessboard" => Some(plain(rest, text)),
        "charuco" => Some(charuco(rest, text)),
        _ => None,
    }
}

fn plain(rest: &str, text: &str) -> Result<Chessboard, String> {
    let wrong = || {
        format!(
            "expected chessboard:COLUMNSxROWS:SQUARE_MM with counts of inner corners, such as chessboard:9x6:25 for \
             10 x 7 squares of 25 mm, found `{text}`"
        )
    };
    let (sides, square) = rest.split_once(':').ok_or_else(wrong)?;
    let sides = spec::sides(sides).map_err(|_| wrong())?;
    let square_m = metres(square).ok_or_else(wrong)?;
    let corners = Checkerboard::new(sides, square_m).map_err(|error| error.to_string())?;
    Ok(Chessboard { corners, markers: None })
}

fn charuco(rest: &str, text: &str) -> Result<Chessboard, String> {
    let wrong = || {
        format!(
            "expected charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY with counts of squares, such as \
             charuco:10x7:25:18:DICT_4X4_50, found `{text}`"
        )
    };
    let parts: Vec<&str> = rest.split(':').collect();
    let [sides, square, marker, dictionary] = parts[..] else { return Err(wrong()) };
    let (columns, rows) = spec::sides(sides).map_err(|_| wrong())?;
    let square_m = metres(square).ok_or_else(wrong)?;
    let side_m = metres(marker).ok_or_else(wrong)?;
    if !(side_m > 0.0 && side_m < square_m) {
        return Err(format!("a marker is smaller than its square, found `{text}`"));
    }
    if dictionary.is_empty() {
        return Err(wrong());
    }
    let inner = (columns.saturating_sub(1), rows.saturating_sub(1));
    let corners = Checkerboard::new(inner, square_m).map_err(|error| error.to_string())?;
    Ok(Chessboard { corners, markers: Some(Markers { side_m, dictionary: dictionary.to_owned() }) })
}

fn metres(millimetres: &str) -> Option<f64> {
    Some(millimetres.trim().parse::<f64>().ok()? * 1e-3)
}

/// The board has other counts than is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "the chessboard shows {} x {} inner corners, not {} x {}: corners are counted where four squares meet, one less than \
     squares each way (`--board chessboard:{}x{}:…`)",
    .found.0, .found.1, .described.0, .described.1, .found.0, .found.1
)]
pub struct ChessboardMismatch {
    pub described: (usize, usize),
    pub found: (usize, usize),
}

/// How often a plain chessboard looked as if it had other counts than is said.
#[derive(Clone, Debug, Default)]
pub(super) struct GridCounts {
    /// By the longer and the shorter side, since a board may be turned.
    seen: BTreeMap<(usize, usize), usize>,
}

impl GridCounts {
    #[cfg(any(feature = "chessboard", test))]
    pub(super) fn add(&mut self, (columns, rows): (usize, usize)) {
        *self.seen.entry((columns.max(rows), columns.min(rows))).or_default() += 1;
    }

    /// Why there will be no lens, once that is clear, of so many views that were taken. What is larger than described is
    /// another board. What is smaller may be a part of it, unless pictures are over and most show just the same.
    pub(super) fn mismatch(
        &self,
        board: &Checkerboard,
        taken: usize,
        is_over: bool,
    ) -> Option<ChessboardMismatch> {
        let described = (board.columns(), board.rows());
        let (long, short) = (described.0.max(described.1), described.0.min(described.1));
        let all: usize = self.seen.values().sum();
        let is_clear = |&((columns, rows), count): &((usize, usize), usize)| {
            let is_larger = columns > long || rows > short;
            count > taken && count >= MIN_MISMATCHES && (is_larger || (is_over && 2 * count > all))
        };
        let seen = self.seen.iter().map(|(sides, count)| (*sides, *count)).filter(is_clear);
        let ((columns, rows), _) = seen.max_by_key(|(_, count)| *count)?;
        let is_upright = described.0 < described.1;
        let found = if is_upright { (rows, columns) } else { (columns, rows) };
        Some(ChessboardMismatch { described, found })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_kinds_are_read() {
        let plain = parse("chessboard:9x6:25").unwrap().unwrap();
        assert_eq!(plain.markers, None);
        assert_eq!(plain.corners, Checkerboard::new((9, 6), 0.025).unwrap());
        let charuco = parse("charuco:10x7:25:17.5:DICT_4X4_50").unwrap().unwrap();
        assert_eq!(charuco.corners, plain.corners);
        let markers = charuco.markers.unwrap();
        assert_eq!((markers.side_m, markers.dictionary.as_str()), (0.0175, "DICT_4X4_50"));
        assert_eq!(parse("7x5"), None);
    }

    #[test]
    fn what_is_wrong_is_told_with_what_was_expected() {
        let error = |text: &str| parse(text).unwrap().unwrap_err();
        for text in ["chessboard", "chessboard:9x6", "chessboard:9:25", "chessboard:9x6:wide"] {
            let error = error(text);
            assert!(error.contains("such as chessboard:9x6:25") && error.contains(text), "{error}");
        }
        for text in ["charuco:10x7:25", "charuco:10x7:25:18", "charuco:10x7:25:18:"] {
            assert!(error(text).contains("such as charuco:10x7:25:18:DICT_4X4_50"), "{text}");
        }
        assert!(error("chessboard:9x2:25").contains("found 9 x 2"));
        assert!(error("chessboard:9x6:-1").contains("above 0 mm"));
        assert!(error("charuco:10x7:25:25:DICT_4X4_50").contains("smaller than its square"));
    }

    #[test]
    fn another_board_is_told_from_a_part_of_it() {
        let board = Checkerboard::new((9, 6), 0.025).unwrap();
        let mut others = GridCounts::default();
        let mismatch = |others: &GridCounts, taken, is_over| {
            others.mismatch(&board, taken, is_over).map(|other| other.found)
        };
        for sides in [(5, 6), (8, 6), (8, 6), (6, 8)] {
            others.add(sides);
        }
        assert_eq!(mismatch(&others, 0, false), None, "it may be cut off");
        assert_eq!(mismatch(&others, 0, true), Some((8, 6)), "it is never whole");
        assert_eq!(mismatch(&others, 3, true), None, "whole ones are no fewer");
        (0..3).for_each(|_| others.add((10, 6)));
        assert_eq!(mismatch(&others, 0, false), Some((10, 6)), "no part of it");
        assert!(others.mismatch(&board, 0, false).unwrap().to_string().contains("chessboard:10x6"));
    }
}
