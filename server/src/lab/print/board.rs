//! The page of a calibration board.

use kurbo::Point;
use roundel_core::{calib::board::Board, marker::Pattern};
use thiserror::Error;

use super::{
    codes, marks, millimetres,
    page::{Page, PageSize},
    page_layout::printable_area,
    roundel::outline,
};

/// The board is larger than the page.
#[derive(Clone, Debug, PartialEq, Error)]
#[error(
    "a board of {columns} x {rows} with a pitch of {} mm is {} x {} mm, and {page} has room for {} x {} mm: use a smaller \
     pitch and outer diameter, fewer roundels, or a larger page",
    millimetres(*.pitch_mm), millimetres(.size_mm.0), millimetres(.size_mm.1), millimetres(.room_mm.0),
    millimetres(.room_mm.1)
)]
pub struct BoardPageError {
    columns: usize,
    rows: usize,
    pitch_mm: f64,
    size_mm: (f64, f64),
    page: String,
    room_mm: (f64, f64),
}

/// The board in the middle of one page, turned if it fits only then: its parts must not move against each
/// other, so it is never spread over several.
pub fn board_page(board: &Board, page: PageSize) -> Result<Page, BoardPageError> {
    let kind = board.kind();
    let (outer_mm, pitch_mm) = (kind.outer_diameter_m * 1e3, board.pitch_m() * 1e3);
    let side = |count: usize| (count - 1) as f64 * pitch_mm + outer_mm;
    let (width, height) = (side(board.columns()), side(board.rows()));
    let fits = |page: &PageSize| {
        let room = printable_area(*page);
        room.width() >= width && room.height() >= height
    };
    let Some(page) = [page, page.rotated()].into_iter().find(fits) else {
        let lying = if width > height { page.rotated() } else { page };
        let room = printable_area(lying);
        return Err(BoardPageError {
            columns: board.columns(),
            rows: board.rows(),
            pitch_mm,
            size_mm: (width, height),
            page: page.name(),
            room_mm: (room.width(), room.height()),
        });
    };
    let window = printable_area(page);
    let middle = window.center();
    let layout = match kind.pattern {
        Pattern::Coded(layout) => Some(layout),
        _ => None,
    };
    let words = layout.and_then(|layout| layout.codes().ok());
    let prints = board.centers().map(|(number, center)| {
        let teeth = words.as_ref().and_then(|codes| codes.teeth(number)).unwrap_or_default();
        let center = Point::new(middle.x + center.x * 1e3, middle.y - center.y * 1e3);
        outline(&kind, &teeth, center, pitch_mm)
    });
    let about = format!(
        "calibration board: {} x {} roundels of {} mm, {} mm from centre to centre{}",
        board.columns(),
        board.rows(),
        millimetres(outer_mm),
        millimetres(pitch_mm),
        layout.map_or(String::new(), |layout| format!(", {}", codes(layout)))
    );
    Ok(Page { size: page, window, prints: prints.collect(), marks: marks::footer(page, &about) })
}
