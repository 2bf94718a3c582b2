//! Whether the print has the columns and rows that are said of it.
//!
//! Numbers run row by row, so with the wrong count of columns the described places are those of the print, sheared, for a part
//! of the roundels (of 7 x 5 ones taken for 6 x 5 for 20 of 35), and a sheared board is a view like any other. So what is described
//! is held against other counts of columns: the right one has all roundels in their places.

use super::{super::LEAST_VIEWS, homography::Flat, target::Target, view::View};
use crate::board::Board;

/// Fewer roundels say nothing of the print.
const LEAST_SEEN: usize = 12;
/// Another count has this share of all roundels in their places …
const LEAST_SHARE: f64 = 0.9;
/// … and so many more than what is described: codes are misread now and then.
const LEAST_MORE: usize = 3;
/// So large a share of the rows that are seen at all is seen in a view that shows the board whole.
const WHOLE_SHARE: f64 = 0.9;

/// Columns and rows that the print in a view seems to have, if not those of the board. There may be more rows than are in
/// the picture.
pub(crate) fn other_sides(board: &Board, view: &View) -> Option<(usize, usize)> {
    let all = view.sightings.len();
    let fitting = |board: &Board| {
        Flat::of(&Target::from(board.clone()), view).map_or(0, |flat| flat.sightings.len())
    };
    let described = fitting(board);
    let is_clear =
        |count: usize| count >= described + LEAST_MORE && count as f64 >= LEAST_SHARE * all as f64;
    if all < LEAST_SEEN || !is_clear(all) {
        return None;
    }
    let last = view.sightings.iter().map(|it| usize::from(it.number)).max()?;
    let (least, most) = Board::SIDES;
    let others = (least..=most.min(last)).filter_map(|columns| {
        let other = board.with_sides((columns, last.div_ceil(columns).max(least)))?;
        Some((fitting(&other), columns))
    });
    let (count, columns) = others.max_by_key(|&(count, columns)| (count, usize::MAX - columns))?;
    is_clear(count).then_some((columns, last.div_ceil(columns).max(least)))
}

/// How many of the board's rows there seem to be, if all views that show the whole width of the print lack the last ones.
pub(crate) fn fewer_rows<'a>(
    board: &Board,
    views: impl Iterator<Item = &'a View>,
) -> Option<usize> {
    let views: Vec<&View> = views.collect();
    let last =
        views.iter().flat_map(|view| &view.sightings).map(|it| usize::from(it.number)).max()?;
    let rows = last.div_ceil(board.columns());
    let whole = (WHOLE_SHARE * (rows * board.columns()) as f64) as usize;
    let are_whole = views.iter().filter(|view| view.sightings.len() >= whole).count();
    let is_clear = rows < board.rows() && are_whole >= LEAST_VIEWS && 2 * are_whole > views.len();
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

    /// A print of these sides, seen at a slant, from this number on.
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
    fn a_wrong_count_of_columns_or_rows_is_told() {
        let print = view((7, 5), 1);
        assert_eq!(other_sides(&board((7, 5)), &print), None);
        for described in [(6, 5), (8, 5), (5, 7), (7, 4), (4, 3)] {
            assert_eq!(other_sides(&board(described), &print), Some((7, 5)), "{described:?}");
        }
        // The upper rows are hidden.
        assert_eq!(other_sides(&board((6, 5)), &view((7, 5), 12)), Some((7, 5)));
        // A code that was misread, and too little to say anything.
        let mut misread = print.clone();
        (misread.sightings[3].number, misread.sightings[4].number) = (5, 4);
        assert_eq!(other_sides(&board((7, 5)), &misread), None);
        let few = View { sightings: print.sightings[..10].to_vec(), ..View::default() };
        assert_eq!(other_sides(&board((6, 5)), &few), None);
    }

    #[test]
    fn rows_that_are_not_there_are_told_where_the_rest_is_whole() {
        let views = vec![view((7, 5), 1); 6];
        assert_eq!(fewer_rows(&board((7, 5)), views.iter()), None);
        assert_eq!(fewer_rows(&board((7, 6)), views.iter()), Some(5));
        assert_eq!(fewer_rows(&board((7, 6)), views[..3].iter()), None);
        // Parts of a board that is always cut off.
        let parts = vec![view((7, 5), 20); 6];
        assert_eq!(fewer_rows(&board((7, 6)), parts.iter()), None);
    }
}
