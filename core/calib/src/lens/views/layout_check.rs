//! Detects prints with other columns or rows than stated.
//!
//! Numbers run row by row. With a wrong number of columns, a part of the roundels (20 of 35 for a board of 7 x 5 stated as
//! 6 x 5) lies at sheared positions of the print, which look like a valid view. Therefore other numbers of columns are
//! compared: the right one has all roundels in their positions.

use super::{super::MIN_VIEWS, homography::BoardHomography, target::Target, view::View};
use crate::board::Board;

/// Minimum number of roundels for a decision.
const MIN_POINTS: usize = 12;
/// Minimum share of roundels that another layout must fit …
const MIN_SHARE: f64 = 0.9;
/// … and minimum number by which it must exceed the stated layout, since codes may be misread.
const MIN_MARGIN: usize = 3;
/// Minimum share of visible roundels in a complete view.
const WHOLE_SHARE: f64 = 0.9;

/// Columns and rows of the print in a view if they differ from the board's. There may be more rows outside of the
/// picture.
pub(crate) fn other_sides(board: &Board, view: &View) -> Option<(usize, usize)> {
    let all = view.sightings.len();
    let fitting_count = |board: &Board| {
        BoardHomography::fit(&Target::from(board.clone()), view)
            .map_or(0, |homography| homography.sightings.len())
    };
    let described = fitting_count(board);
    let is_clear =
        |count: usize| count >= described + MIN_MARGIN && count as f64 >= MIN_SHARE * all as f64;
    if all < MIN_POINTS || !is_clear(all) {
        return None;
    }
    let last = view.sightings.iter().map(|it| usize::from(it.number)).max()?;
    let (min, max) = Board::SIDES;
    let candidates = (min..=max.min(last)).filter_map(|columns| {
        let other = board.with_sides((columns, last.div_ceil(columns).max(min)))?;
        Some((fitting_count(&other), columns))
    });
    let (count, columns) =
        candidates.max_by_key(|&(count, columns)| (count, usize::MAX - columns))?;
    is_clear(count).then_some((columns, last.div_ceil(columns).max(min)))
}

/// Number of rows if all complete views lack the board's last rows.
pub(crate) fn fewer_rows(board: &Board, views: &[View]) -> Option<usize> {
    let last =
        views.iter().flat_map(|view| &view.sightings).map(|it| usize::from(it.number)).max()?;
    let rows = last.div_ceil(board.columns());
    let whole = (WHOLE_SHARE * (rows * board.columns()) as f64) as usize;
    let are_whole = views.iter().filter(|view| view.sightings.len() >= whole).count();
    let is_clear = rows < board.rows() && are_whole >= MIN_VIEWS && 2 * are_whole > views.len();
    is_clear.then_some(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::Sighting;
    use roundel_vision::{camera::PixelPoint, marker::CodeLayout};

    fn board(sides: (usize, usize)) -> Board {
        Board::new(sides, 0.036, 0.03, CodeLayout { bits: 9, min_distance: 1 }).unwrap()
    }

    /// Oblique view of a print of these sides, from this number on.
    fn view(sides: (usize, usize), from: u16) -> View {
        let sighting = |(number, at): (u16, nalgebra::Point2<f64>)| {
            let depth = 1.0 + 1.5 * at.x + 0.5 * at.y;
            let center = PixelPoint {
                u: 640.0 + (2500.0 * at.x + 200.0 * at.y) / depth,
                v: 360.0 - 2400.0 * at.y / depth,
            };
            (number >= from).then_some(Sighting { number, center, radius_px: 36.0 })
        };
        let sightings = board(sides).centers().filter_map(sighting).collect();
        View { sightings, ..View::default() }
    }

    #[test]
    fn a_wrong_number_of_columns_or_rows_is_detected() {
        let print = view((7, 5), 1);
        assert_eq!(other_sides(&board((7, 5)), &print), None);
        for described in [(6, 5), (8, 5), (5, 7), (7, 4), (4, 3)] {
            assert_eq!(other_sides(&board(described), &print), Some((7, 5)), "{described:?}");
        }
        // The upper rows are hidden.
        assert_eq!(other_sides(&board((6, 5)), &view((7, 5), 12)), Some((7, 5)));
        // A misread code, and too few roundels.
        let mut misread = print.clone();
        (misread.sightings[3].number, misread.sightings[4].number) = (5, 4);
        assert_eq!(other_sides(&board((7, 5)), &misread), None);
        let few = View { sightings: print.sightings[..10].to_vec(), ..View::default() };
        assert_eq!(other_sides(&board((6, 5)), &few), None);
    }

    #[test]
    fn missing_rows_are_detected_in_complete_views() {
        let views = vec![view((7, 5), 1); 6];
        assert_eq!(fewer_rows(&board((7, 5)), &views), None);
        assert_eq!(fewer_rows(&board((7, 6)), &views), Some(5));
        assert_eq!(fewer_rows(&board((7, 6)), &views[..3]), None);
        // Parts of a board that is always cut off.
        let parts = vec![view((7, 5), 20); 6];
        assert_eq!(fewer_rows(&board((7, 6)), &parts), None);
    }
}
