//! Descriptions of other tools' boards on the command line: `chessboard:COLUMNSxROWS:SQUARE_MM`, counted in inner corners
//! as in OpenCV and ROS, and `charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY`, counted in squares as in OpenCV.

use std::collections::BTreeMap;

use roundel_core::calib::checkerboard::Checkerboard;
use thiserror::Error;

use crate::lab::print::spec;

/// Number of pictures of another board that excludes a misdetection.
const MIN_MISMATCHES: usize = 3;

#[derive(Clone, Debug, PartialEq)]
pub struct Chessboard {
    pub corners: Checkerboard,
    pub markers: Option<Markers>,
}

/// Markers in the white squares of a ChArUco board, numbered row by row; the square at the top left is black.
#[derive(Clone, Debug, PartialEq)]
pub struct Markers {
    /// Side of the black border, metres.
    pub side_m: f64,
    /// OpenCV's name of the dictionary, such as `DICT_4X4_50`.
    pub dictionary: String,
}

/// Parses a description; `None` if the text begins with neither word.
pub fn parse(text: &str) -> Option<Result<Chessboard, String>> {
    let parts: Vec<&str> = text.split(':').collect();
    let (parsed, expected) = match parts[..] {
        ["chessboard", ref rest @ ..] => (
            plain(rest),
            "chessboard:COLUMNSxROWS:SQUARE_MM with counts of inner corners, such as chessboard:9x6:25 for 10 x 7 \
             squares of 25 mm",
        ),
        ["charuco", ref rest @ ..] => (
            charuco(rest),
            "charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY with counts of squares, such as \
             charuco:10x7:25:18:DICT_4X4_50",
        ),
        _ => return None,
    };
    Some(parsed.unwrap_or_else(|| Err(format!("expected {expected}, found `{text}`"))))
}

/// `None` if the description is incomplete.
fn plain(parts: &[&str]) -> Option<Result<Chessboard, String>> {
    let &[sides, square] = parts else { return None };
    let corners = Checkerboard::new(spec::sides(sides).ok()?, metres(square)?);
    let board = corners.map(|corners| Chessboard { corners, markers: None });
    Some(board.map_err(|error| error.to_string()))
}

fn charuco(parts: &[&str]) -> Option<Result<Chessboard, String>> {
    let &[sides, square, marker, dictionary] = parts else { return None };
    let (columns, rows) = spec::sides(sides).ok()?;
    let (square_m, side_m) = (metres(square)?, metres(marker)?);
    if dictionary.is_empty() {
        return None;
    }
    if !(side_m > 0.0 && side_m < square_m) {
        return Some(Err(format!("a marker must be smaller than its square, found {marker} mm")));
    }
    let corners = Checkerboard::new((columns.saturating_sub(1), rows.saturating_sub(1)), square_m);
    let markers = Some(Markers { side_m, dictionary: dictionary.to_owned() });
    let board = corners.map(|corners| Chessboard { corners, markers });
    Some(board.map_err(|error| error.to_string()))
}

fn metres(millimetres: &str) -> Option<f64> {
    Some(millimetres.trim().parse::<f64>().ok()? * 1e-3)
}

/// The board has other counts than described.
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

/// Counts of detected grids by size, except those of the described size.
///
/// Sizes have the longer side first, since the board may be turned.
#[derive(Clone, Debug, Default)]
pub(super) struct GridCounts(BTreeMap<(usize, usize), usize>);

impl GridCounts {
    pub(super) fn add(&mut self, (columns, rows): (usize, usize)) {
        *self.0.entry((columns.max(rows), columns.min(rows))).or_default() += 1;
    }

    /// The mismatch, once it is certain beside `taken` views of the described board. A larger grid is another board. A
    /// smaller one may be a part of the board, unless no more pictures come and most show the same size.
    pub(super) fn mismatch(
        &self,
        board: &Checkerboard,
        taken: usize,
        is_over: bool,
    ) -> Option<ChessboardMismatch> {
        let described = (board.columns(), board.rows());
        let (long, short) = (described.0.max(described.1), described.0.min(described.1));
        let all: usize = self.0.values().sum();
        let is_clear = |&((columns, rows), count): &((usize, usize), usize)| {
            let is_larger = columns > long || rows > short;
            count > taken && count >= MIN_MISMATCHES && (is_larger || (is_over && 2 * count > all))
        };
        let seen = self.0.iter().map(|(sides, count)| (*sides, *count)).filter(is_clear);
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
    fn both_kinds_are_parsed() {
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
    fn errors_name_the_expected_form() {
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
    fn another_board_is_distinguished_from_a_part_of_it() {
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
