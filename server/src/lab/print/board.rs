//! The page of a calibration board.

use kurbo::{Point, Size};
use roundel_core::{calib::board::Board, marker::Pattern};

use super::{
    codes, marks, millimetres,
    page::{Page, PageSize},
    page_layout::{PageLayoutError, printable_area},
    roundel::outline,
};

/// The board in the middle of one page, rotated if it fits only then. It is never spread over several pages, since its
/// parts must not move against each other.
pub fn board_page(board: &Board, page: PageSize) -> Result<Page, PageLayoutError> {
    let kind = board.kind();
    let (columns, rows) = (board.columns(), board.rows());
    let (outer_mm, pitch_mm) = (kind.outer_diameter_m * 1e3, board.pitch_m() * 1e3);
    let side = |count: usize| (count - 1) as f64 * pitch_mm + outer_mm;
    let size_mm = Size::new(side(columns), side(rows));
    let fits = |page: &PageSize| {
        let available = printable_area(*page).size();
        available.width >= size_mm.width && available.height >= size_mm.height
    };
    let Some(page) = [page, page.rotated()].into_iter().find(fits) else {
        let landscape = if size_mm.width > size_mm.height { page.rotated() } else { page };
        let (page, available_mm) = (page.name(), printable_area(landscape).size());
        return Err(PageLayoutError::Board {
            columns,
            rows,
            pitch_mm,
            size_mm,
            page,
            available_mm,
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
        "calibration board: {columns} x {rows} roundels of {} mm, {} mm from centre to centre{}",
        millimetres(outer_mm),
        millimetres(pitch_mm),
        layout.map_or(String::new(), |layout| format!(", {}", codes(layout)))
    );
    Ok(Page { size: page, window, prints: prints.collect(), marks: marks::footer(page, &about) })
}
