//! Corners of chessboards and ChArUco boards in pictures, by the `calib-targets` crates (ChESS corners: Bennett, Lasenby 2014),
//! with their fit of a saddle to each corner's surroundings: within 0.015 px rms a coordinate (noise 2/255, blur
//! 0.8 px) where the default, a centre of mass, has 0.09.
//!
//! Limits: of a plain chessboard all rows and columns have to be in the picture, since nothing else tells one corner
//! from the next; neither is found through fisheyes. ChArUco boards are those of OpenCV since 4.6, the square at the top left
//! black.

use calib_targets_charuco::{
    CharucoBoardSpec, CharucoDetector, CharucoParams, builtins::BUILTIN_DICTIONARY_NAMES,
    resolve_dictionary,
};
use calib_targets_chessboard::{
    ChessboardDetector, ChessboardParams, DetectorConfig, GrayImageView, default_chess_config,
    detect_corners,
};
use calib_targets_core::ImageRefiner;
use roundel_core::{
    calib::{
        checkerboard::Checkerboard,
        lens::{Sighting, View},
    },
    camera::PixelPoint,
    frame::Frame,
};

use super::chessboard::Chessboard;

/// Finds the corners of one board.
pub(super) struct Finder {
    board: Checkerboard,
    by: By,
    /// The picture without padding.
    pixels: Vec<u8>,
}

enum By {
    Grid(ChessboardDetector, DetectorConfig),
    Markers(Box<CharucoDetector>),
}

pub(super) enum CornerSearch {
    Board(View),
    /// A grid of so many corners across and down.
    Other((usize, usize)),
}

/// A corner as it was found: column, row, place.
type Corner = (usize, usize, PixelPoint);

impl Finder {
    /// An error tells what is wrong with the description.
    pub(super) fn new(board: &Chessboard) -> Result<Self, String> {
        let config = default_chess_config().with_refiner(ImageRefiner::saddle_point());
        let by = match &board.markers {
            None => {
                let detector = ChessboardDetector::new(ChessboardParams::default());
                By::Grid(detector.map_err(|error| error.to_string())?, config)
            }
            Some(markers) => {
                let name = &markers.dictionary;
                let dictionary = resolve_dictionary(name).ok_or_else(|| {
                    let names = BUILTIN_DICTIONARY_NAMES.join(", ");
                    format!("there is no dictionary `{name}`; expected one of {names}")
                })?;
                let corners = &board.corners;
                let (columns, rows) = (corners.columns() as u32 + 1, corners.rows() as u32 + 1);
                let marker_share = (markers.side_m / corners.square_m()) as f32;
                let spec = CharucoBoardSpec::new(rows, columns, 1.0, marker_share, dictionary);
                let mut params = CharucoParams::for_board(spec);
                params.chess = config;
                let detector = CharucoDetector::new(params)
                    .map_err(|error| format!("there is no such ChArUco board: {error}"))?;
                By::Markers(Box::new(detector))
            }
        };
        Ok(Self { board: board.corners, by, pixels: Vec::new() })
    }

    pub(super) fn find(&mut self, frame: &Frame<'_>) -> CornerSearch {
        let (width, height) = (frame.width(), frame.height());
        self.pixels.clear();
        (0..height).for_each(|row| self.pixels.extend_from_slice(frame.row(row)));
        let picture = GrayImageView { width, height, data: &self.pixels };
        match &self.by {
            By::Grid(detector, config) => {
                let corners = detect_corners(&picture, config);
                let Some(grid) = detector.detect(&corners) else {
                    return CornerSearch::Board(View::default());
                };
                let corners: Vec<Corner> = grid
                    .corners
                    .iter()
                    .map(|it| (it.grid.u as usize, it.grid.v as usize, pixel(&it.position)))
                    .collect();
                placed(&self.board, corners)
            }
            By::Markers(detector) => {
                let columns = self.board.columns();
                let found = detector.detect(&picture).map_or_else(|_| Vec::new(), |it| it.corners);
                let corner = |id: usize| (id % columns, id / columns);
                let corners: Vec<Corner> = found
                    .iter()
                    .map(|it| (corner(it.id as usize), pixel(&it.position)))
                    .map(|((column, row), place)| (column, row, place))
                    .collect();
                CornerSearch::Board(view(&self.board, &corners))
            }
        }
    }
}

/// Pixel centres are whole numbers there as here.
fn pixel(place: &nalgebra::Point2<f32>) -> PixelPoint {
    PixelPoint { u: place.x.into(), v: place.y.into() }
}

/// A plain chessboard's corners, counted from the top left in the picture, on a board that may be turned by 90°.
fn placed(board: &Checkerboard, mut corners: Vec<Corner>) -> CornerSearch {
    let most = |of: fn(&Corner) -> usize| corners.iter().map(of).max().map_or(0, |it| it + 1);
    let sides = (most(|it| it.0), most(|it| it.1));
    let described = (board.columns(), board.rows());
    if sides == described {
        CornerSearch::Board(view(board, &corners))
    } else if (sides.1, sides.0) == described {
        for (column, row, _) in &mut corners {
            (*column, *row) = (*row, sides.0 - 1 - *column);
        }
        CornerSearch::Board(view(board, &corners))
    } else {
        CornerSearch::Other(sides)
    }
}

/// A corner is as large as half of the way to those beside it.
fn view(board: &Checkerboard, corners: &[Corner]) -> View {
    let mut sightings: Vec<Sighting> = corners
        .iter()
        .filter_map(|(column, row, center)| {
            let beside = corners.iter().filter_map(|(other_column, other_row, other)| {
                let apart = column.abs_diff(*other_column) + row.abs_diff(*other_row);
                (apart == 1).then(|| (other.u - center.u).hypot(other.v - center.v))
            });
            let nearest_px = beside.min_by(f64::total_cmp)?;
            let number = board.number(*column, *row)?;
            Some(Sighting { number, center: *center, radius_px: nearest_px / 2.0 })
        })
        .collect();
    sightings.sort_by_key(|sighting| sighting.number);
    View { sightings, ..View::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corners(columns: usize, rows: usize) -> Vec<Corner> {
        let corner = |index: usize| {
            let (column, row) = (index % columns, index / columns);
            let center = PixelPoint { u: 40.0 * column as f64, v: 30.0 * row as f64 };
            (column, row, center)
        };
        (0..columns * rows).map(corner).collect()
    }

    #[test]
    fn a_board_that_is_turned_keeps_its_handedness() {
        let board = Checkerboard::new((9, 6), 0.025).unwrap();
        for (columns, rows) in [(9, 6), (6, 9)] {
            let CornerSearch::Board(view) = placed(&board, corners(columns, rows)) else {
                panic!("{columns} x {rows} is the board");
            };
            assert_eq!(view.sightings.len(), 54);
            let place = |number: usize| view.sightings[number - 1].center;
            // From the first corner to the next in its row, and to that below it: right-handed in the picture, whose v is down.
            let (first, beside, below) = (place(1), place(2), place(10));
            let (ru, rv) = (beside.u - first.u, beside.v - first.v);
            let (du, dv) = (below.u - first.u, below.v - first.v);
            assert!(ru * dv - rv * du > 0.0, "{columns} x {rows}");
        }
        assert!(matches!(placed(&board, corners(8, 6)), CornerSearch::Other((8, 6))));
    }
}
