//! Lays out roundels on pages: many on one page, or one over several pages if it is larger than a page.
//!
//! Roundels of one kind share pages, each in a square with cut marks at its corners; the page is rotated if more fit
//! then. A larger roundel is spread over pages that overlap by [`OVERLAP_MM`], with marks where sheets meet.

use kurbo::{Point, Rect, Size};
use roundel_core::marker::{CodeError, CodeLayout, Dictionary, Pattern, Tooth};
use thiserror::Error;

use super::{
    marks, millimetres,
    page::{EDGE_MM, FOOT_MM, Page, PageSize, PrintItem, RULER_MM},
    roundel::{MIN_SIDE_SHARE, SIDE_SHARE, outline, square},
};
use crate::lab::drawing::Shape;

/// Gap between squares, which holds their cut marks, millimetres.
const GAP_MM: f64 = 2.0 * (marks::CUT_GAP_MM + marks::CUT_MM) + 1.0;
/// Tolerance for squares that just fit.
const ROUNDING: f64 = 1e-9;
/// Overlap of the pages of one large roundel, millimetres.
const OVERLAP_MM: f64 = 10.0;
/// Most pages of one file.
pub const MAX_PAGES: usize = 500;
/// Smallest roundel that a printer makes well, millimetres.
const MIN_OUTER_MM: f64 = 2.0;
/// Largest roundel, millimetres.
const MAX_OUTER_MM: f64 = 5000.0;

#[derive(Clone, Debug, PartialEq, Error)]
pub enum PageLayoutError {
    #[error("nothing to print: expected at least one roundel")]
    Empty,
    #[error(
        "expected an outer diameter of {MIN_OUTER_MM} to {MAX_OUTER_MM} mm, found {found_mm} mm"
    )]
    Size { found_mm: f64 },
    #[error(
        "there is no code {number} of {bits} bits at a distance of {min_distance}: they are numbered \
         from 1 to {count}"
    )]
    Number { number: u16, bits: u8, min_distance: u8, count: usize },
    #[error(transparent)]
    Code(#[from] CodeError),
    #[error(
        "this takes {found} pages, and a file holds {MAX_PAGES} at most: print fewer roundels at a \
         time, or on larger pages"
    )]
    Pages { found: usize },
    #[error(
        "a page of {width_mm} x {height_mm} mm has no room for roundels beside the ruler and the edge \
         that printers leave white: use a larger page"
    )]
    Page { width_mm: f64, height_mm: f64 },
    #[error(
        "a board of {columns} x {rows} with a pitch of {} mm is {} x {} mm, and {page} has room for {} x {} mm: use a \
         smaller pitch and outer diameter, fewer roundels, or a larger page",
        millimetres(*.pitch_mm), millimetres(.size_mm.width), millimetres(.size_mm.height),
        millimetres(.available_mm.width), millimetres(.available_mm.height)
    )]
    Board {
        columns: usize,
        rows: usize,
        pitch_mm: f64,
        size_mm: Size,
        page: String,
        available_mm: Size,
    },
}

pub fn lay_out_pages(items: &[PrintItem], page: PageSize) -> Result<Vec<Page>, PageLayoutError> {
    if items.is_empty() {
        return Err(PageLayoutError::Empty);
    }
    let mut pages = Vec::new();
    for alike in items.chunk_by(|one, other| one.kind == other.kind) {
        let outer_mm = alike[0].kind.outer_diameter_m * 1e3;
        if !(MIN_OUTER_MM..=MAX_OUTER_MM).contains(&outer_mm) {
            return Err(PageLayoutError::Size { found_mm: outer_mm });
        }
        let side_mm = SIDE_SHARE * outer_mm;
        // Once for all of a kind: the codes of 16 bits take a while.
        let codes = match alike[0].kind.pattern {
            Pattern::Coded(layout) => Some(layout.codes()?),
            _ => None,
        };
        let codes = codes.as_ref();
        match Grid::best(page, side_mm).or_else(|| Grid::narrow(page, outer_mm)) {
            Some(grid) => pages.extend(grid.fill(alike, codes)?),
            None => pages.extend(lay_out_tiled(alike, codes, page, outer_mm)?),
        }
        if pages.len() > MAX_PAGES {
            return Err(PageLayoutError::Pages { found: pages.len() });
        }
    }
    Ok(pages)
}

/// The part of a page that is available for prints.
pub(super) fn printable_area(page: PageSize) -> Rect {
    let (right, bottom) = (page.width_mm - EDGE_MM - RULER_MM, page.height_mm - EDGE_MM - FOOT_MM);
    Rect { x0: EDGE_MM, y0: EDGE_MM, x1: right, y1: bottom }
}

/// Squares side by side on a page.
struct Grid {
    page: PageSize,
    side_mm: f64,
    columns: usize,
    rows: usize,
}

impl Grid {
    /// The grid with the most squares, on the page as it is or rotated; `None` if none fits.
    fn best(page: PageSize, side_mm: f64) -> Option<Self> {
        let [upright, rotated] = [page, page.rotated()].map(|page| Self::of(page, side_mm));
        let cells = |grid: &Option<Self>| grid.as_ref().map_or(0, Self::cells);
        if cells(&rotated) > cells(&upright) { rotated } else { upright }
    }

    /// One roundel with a narrower margin, if the page leaves enough of it; better than sheets that are glued.
    fn narrow(page: PageSize, outer_mm: f64) -> Option<Self> {
        let window = printable_area(page);
        let side_mm = window.width().min(window.height()) - GAP_MM;
        (side_mm >= MIN_SIDE_SHARE * outer_mm).then(|| Self::of(page, side_mm)).flatten()
    }

    fn of(page: PageSize, side_mm: f64) -> Option<Self> {
        let window = printable_area(page);
        let pitch_mm = side_mm + GAP_MM;
        let count = |length_mm: f64| (length_mm / pitch_mm + ROUNDING).floor().max(0.0) as usize;
        let (columns, rows) = (count(window.width()), count(window.height()));
        (columns * rows > 0).then_some(Self { page, side_mm, columns, rows })
    }

    fn cells(&self) -> usize {
        self.columns * self.rows
    }

    fn fill(
        &self,
        items: &[PrintItem],
        codes: Option<&Dictionary>,
    ) -> Result<Vec<Page>, PageLayoutError> {
        let window = printable_area(self.page);
        let pitch_mm = self.side_mm + GAP_MM;
        let count = items.len().div_ceil(self.cells());
        if count > MAX_PAGES {
            return Err(PageLayoutError::Pages { found: count });
        }
        let mut pages = Vec::with_capacity(count);
        for items in items.chunks(self.cells()) {
            let mut page = Page { size: self.page, window, prints: Vec::new(), marks: Vec::new() };
            for (index, item) in items.iter().enumerate() {
                let center = Point::new(
                    window.x0 + pitch_mm * ((index % self.columns) as f64 + 0.5),
                    window.y0 + pitch_mm * ((index / self.columns) as f64 + 0.5),
                );
                let square = square(center, self.side_mm);
                page.prints.push(outline(&item.kind, &teeth(item, codes)?, center, self.side_mm));
                page.marks.extend(marks::cut_marks(&square));
                page.marks.extend(marks::corner_labels(item, &square));
            }
            page.marks.extend(marks::footer(self.page, &footer_text(&items[0])));
            pages.push(page);
        }
        Ok(pages)
    }
}

/// Lays out each roundel over several pages.
fn lay_out_tiled(
    items: &[PrintItem],
    codes: Option<&Dictionary>,
    page: PageSize,
    outer_mm: f64,
) -> Result<Vec<Page>, PageLayoutError> {
    let ways = [page, page.rotated()].map(|page| TiledRoundel::of(page, outer_mm));
    let fewest = ways.into_iter().flatten().min_by_key(TiledRoundel::count);
    let Some(tiled) = fewest else {
        let PageSize { width_mm, height_mm } = page;
        return Err(PageLayoutError::Page { width_mm, height_mm });
    };
    let found = tiled.count().saturating_mul(items.len());
    if found > MAX_PAGES {
        return Err(PageLayoutError::Pages { found });
    }
    let mut pages = Vec::with_capacity(found);
    for item in items {
        let teeth = teeth(item, codes)?;
        pages.extend((0..tiled.count()).map(|index| tiled.sheet(index, item, &teeth)));
    }
    Ok(pages)
}

/// Overlapping sheets that together hold one square.
struct TiledRoundel {
    page: PageSize,
    window: Rect,
    side_mm: f64,
    columns: usize,
    rows: usize,
}

impl TiledRoundel {
    /// With the usual margin, or with the narrowest sufficient one if that takes fewer sheets; `None` if a page holds little
    /// more than the overlap.
    fn of(page: PageSize, outer_mm: f64) -> Option<Self> {
        let window = printable_area(page);
        if window.width() < 3.0 * OVERLAP_MM || window.height() < 3.0 * OVERLAP_MM {
            return None;
        }
        // Cut marks lie outside the square.
        let steps_mm = [window.width(), window.height()].map(|length_mm| length_mm - OVERLAP_MM);
        let counts = |side_share: f64| {
            let more_mm = side_share * outer_mm + GAP_MM - OVERLAP_MM;
            steps_mm.map(|step_mm| (more_mm / step_mm - ROUNDING).ceil().max(1.0) as usize)
        };
        let (usual, least) = (counts(SIDE_SHARE), counts(MIN_SIDE_SHARE));
        let all = |[columns, rows]: [usize; 2]| columns.saturating_mul(rows);
        let [columns, rows] = if all(least) < all(usual) { least } else { usual };
        let has_mm = |step_mm: f64, count: usize| step_mm * count as f64 + OVERLAP_MM - GAP_MM;
        let available_mm = has_mm(steps_mm[0], columns).min(has_mm(steps_mm[1], rows));
        let side_mm = available_mm.min(SIDE_SHARE * outer_mm);
        Some(Self { page, window, side_mm, columns, rows })
    }

    fn count(&self) -> usize {
        self.columns.saturating_mul(self.rows)
    }

    /// The sheet of that number, row by row.
    fn sheet(&self, index: usize, item: &PrintItem, teeth: &[Tooth]) -> Page {
        let &Self { page, window, side_mm, columns, rows } = self;
        let (column, row) = (index % columns, index / columns);
        // The square is centred on all sheets together.
        let middle = |begin: f64, length: f64, count: usize, place: usize| {
            let step = length - OVERLAP_MM;
            begin + (step * count as f64 + OVERLAP_MM) / 2.0 - step * place as f64
        };
        let center = Point::new(
            middle(window.x0, window.width(), columns, column),
            middle(window.y0, window.height(), rows, row),
        );
        let square = square(center, side_mm);
        let mut marks: Vec<Shape> = marks::cut_marks(&square)
            .into_iter()
            .chain(marks::corner_labels(item, &square))
            .filter(|shape| marks::is_inside(shape, &window))
            .collect();
        let joins = [column > 0, column + 1 < columns, row > 0, row + 1 < rows];
        marks.extend(marks::join_marks(&window, OVERLAP_MM, joins));
        let about = format!(
            "{} {}, row {} of {rows}, column {} of {columns}; sheets overlap by {OVERLAP_MM} mm",
            footer_text(item),
            item.label,
            row + 1,
            column + 1
        );
        marks.extend(marks::footer(page, &about));
        Page {
            size: page,
            window,
            prints: vec![outline(&item.kind, teeth, center, side_mm)],
            marks,
        }
    }
}

/// Empty for a kind without codes.
fn teeth(item: &PrintItem, codes: Option<&Dictionary>) -> Result<Vec<Tooth>, PageLayoutError> {
    let (Some(codes), Pattern::Coded(layout)) = (codes, item.kind.pattern) else {
        return Ok(Vec::new());
    };
    let CodeLayout { bits, min_distance } = layout;
    let (number, count) = (item.number.unwrap_or(0), codes.len());
    codes.teeth(number).ok_or(PageLayoutError::Number { number, bits, min_distance, count })
}

/// The kind in the terms of the configuration.
fn footer_text(item: &PrintItem) -> String {
    let kind = &item.kind;
    let mm = |length_m: f64| millimetres(length_m * 1e3);
    let (outer, inner) = (mm(kind.outer_diameter_m), mm(kind.inner_diameter_m));
    let size = match kind.pattern {
        Pattern::Plain => format!("outer {outer} mm, inner {inner} mm"),
        Pattern::Elliptical { minor_diameter_m } => {
            format!("outer {outer} mm, inner {inner} x {} mm", mm(minor_diameter_m))
        }
        Pattern::Coded(layout) => {
            let CodeLayout { bits, min_distance } = layout;
            let is_default = super::job::has_default_ratio(kind);
            let inner = if is_default { String::new() } else { format!(", inner {inner} mm") };
            format!("outer {outer} mm{inner}, code of {bits} bits at distance {min_distance}")
        }
    };
    if kind.name.is_empty() { size } else { format!("{}: {size}", kind.name) }
}

#[cfg(test)]
mod tests {
    use kurbo::PathEl;
    use roundel_core::marker::Kind;

    use super::*;

    const A4: PageSize = PageSize { width_mm: 210.0, height_mm: 297.0 };

    fn plain(outer_mm: f64) -> PrintItem {
        let kind = Kind::plain("robot", outer_mm * 1e-3, outer_mm * 0.4e-3);
        PrintItem { kind, number: None, label: String::new() }
    }

    /// Where the ring's outline begins: at its right.
    fn first(page: &Page) -> Point {
        match page.prints[0].elements()[0] {
            PathEl::MoveTo(place) => place,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_page_holds_as_many_as_fit() {
        let pages = lay_out_pages(&vec![plain(50.0); 7], A4).unwrap();
        assert_eq!(pages.iter().map(|page| page.prints.len()).collect::<Vec<_>>(), [6, 1]);
        // One of 130 mm fits either way, upright first.
        assert_eq!(lay_out_pages(&[plain(130.0)], A4).unwrap()[0].size, A4);
        // One of 160 mm just fits, with a narrower margin.
        let pages = lay_out_pages(&[plain(160.0)], A4).unwrap();
        assert_eq!((pages.len(), pages[0].prints.len()), (1, 1));
        // Three fit side by side on the rotated page, two upright.
        let pages = lay_out_pages(&vec![plain(58.0); 6], A4).unwrap();
        assert!(pages.len() == 1, "{}", pages.len());
    }

    #[test]
    fn a_large_roundel_is_spread_over_overlapping_pages() {
        let pages = lay_out_pages(&[plain(330.0)], A4).unwrap();
        assert_eq!(pages.len(), 6);
        // The next page shows the same, shifted by the window less the overlap.
        let (one, next) = (first(&pages[0]), first(&pages[1]));
        let width = printable_area(A4).width();
        assert!((one.x - next.x - (width - OVERLAP_MM)).abs() < 1e-9 && one.y == next.y);
        // Together they hold the whole square.
        let columns = 3.0;
        assert!(columns * (width - OVERLAP_MM) + OVERLAP_MM >= 330.0 * SIDE_SHARE);
    }

    #[test]
    fn the_margin_is_narrowed_to_save_sheets() {
        let a3 = PageSize { width_mm: 297.0, height_mm: 420.0 };
        for (outer_mm, page, count) in
            [(600.0, a3, 6), (300.0, A4, 4), (235.0, A4, 2), (236.0, A4, 4)]
        {
            let pages = lay_out_pages(&[plain(outer_mm)], page).unwrap();
            assert_eq!(pages.len(), count, "{outer_mm} mm");
            // The least margin and its cut marks lie in the windows of the outermost sheets.
            let reach_mm = 0.5 * (MIN_SIDE_SHARE * outer_mm + GAP_MM);
            let middle = |page: &Page| first(page) - (0.5 * outer_mm, 0.0);
            let (one, other) = (&pages[0], &pages[count - 1]);
            let (before, after) = (middle(one), middle(other));
            let [first, last] = [one, other].map(|it| it.window.inflate(ROUNDING, ROUNDING));
            let [least, most] = [before - (reach_mm, reach_mm), after + (reach_mm, reach_mm)];
            assert!(least.x >= first.x0 && least.y >= first.y0, "{outer_mm} mm");
            assert!(most.x <= last.x1 && most.y <= last.y1, "{outer_mm} mm");
        }
    }

    #[test]
    fn errors_name_the_reason() {
        let error = |items: &[PrintItem], page| lay_out_pages(items, page).unwrap_err().to_string();
        assert!(error(&[], A4).contains("at least one"));
        assert!(error(&[plain(0.5)], A4).contains("found 0.5 mm"));
        let square = |side_mm| PageSize { width_mm: side_mm, height_mm: side_mm };
        assert!(error(&[plain(4999.0)], square(100.0)).contains("pages"));
        let tiny = square(50.0);
        let no_room = error(&[plain(90.0)], tiny);
        assert!(no_room.contains("has no room"), "{no_room}");
        let layout = CodeLayout { bits: 8, min_distance: 2 };
        let count = layout.codes().unwrap().len();
        let mut coded = plain(50.0);
        coded.kind.pattern = Pattern::Coded(layout);
        coded.number = Some(count as u16 + 1);
        assert!(error(&[coded], A4).contains(&format!("numbered from 1 to {count}")));
    }
}
