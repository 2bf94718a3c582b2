//! Prints roundels and calibration boards true to scale, as PDF, SVG or PNG.
//!
//! Input: kinds of roundel ([`roundel_core::marker::Kind`]), numbers of codes, and a page size. Output: files. All
//! geometry is in millimetres from the page's top left corner. Every format draws the same [`page::Page`]s through
//! `drawing`. `tests/tests/print` checks that the detector reads the prints.

mod board;
mod code_list;
mod job;
mod marks;
pub mod page;
mod page_layout;
mod raster;
mod roundel;
pub mod spec;

use roundel_core::marker::CodeLayout;

pub use board::board_page;
pub use code_list::{CodeListing, list_codes};
pub use job::{PrintJob, PrintJobError, coded_item, config_lines, items_of_kind};
pub use page::{Page, PageSize, PrintItem, pdf};
pub use page_layout::{MAX_PAGES, PageLayoutError, lay_out_pages};
pub use raster::{DPI_LIMITS, RasterError, png, png_until};
pub use roundel::SIDE_SHARE;

/// Default outer diameter of a board's roundels, metres.
pub const BOARD_OUTER_M: f64 = 0.03;
/// Default pitch over the outer diameter.
pub const BOARD_PITCH: f64 = 1.2;
/// Default codes of a board.
pub const BOARD_LAYOUT: CodeLayout = CodeLayout { bits: 9, min_distance: 1 };

/// A length to a hundredth of a millimetre, without trailing zeros.
pub fn millimetres(length_mm: f64) -> String {
    let text = format!("{length_mm:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Codes in words, as in a board's footer.
pub fn codes(CodeLayout { bits, min_distance }: CodeLayout) -> String {
    match min_distance {
        1 => format!("codes of {bits} bits"),
        _ => format!("codes of {bits} bits, distance {min_distance}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_short() {
        assert_eq!([160.0, 96.5, 0.128, 100.004].map(millimetres), ["160", "96.5", "0.13", "100"]);
    }
}
