//! What is to be printed: roundels of a kind by their numbers, or the calibration board.

use roundel_core::{
    calib::board::{Board, BoardError},
    marker::{
        AXIS_RATIO_LIMIT, CodeError, CodeLayout, Kind, Pattern, Polarity, RATIO_LIMITS,
        is_measurable, tells_heading,
    },
};
use thiserror::Error;

use super::{
    BOARD_OUTER_M, BOARD_PITCH, BoardPageError, Page, PageLayoutError, PageSize, PrintItem,
    board_page, lay_out_pages, millimetres,
    spec::{CodeNumbers, Diameters, PrintSpec},
};

/// What is to be printed.
#[derive(Clone, Debug, PartialEq)]
pub enum PrintJob {
    /// Roundels, in this order.
    Roundels(Vec<PrintItem>),
    Board(Board),
}

/// Why that cannot be printed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PrintJobError {
    /// Neither a ratio nor a code.
    #[error("expected OUTER_MM:INNER_MM for a plain roundel, or a code for a coded one")]
    Inner,
    /// Both an ellipse and a code.
    #[error("an elliptical disc and a code exclude each other")]
    Exclusive,
    /// The detector would not find it.
    #[error(
        "expected a disc of {} to {} of the outer diameter, found {found:.3}: another would not be found",
        RATIO_LIMITS.0, RATIO_LIMITS.1
    )]
    Ratio { found: f64 },
    #[error(
        "expected the disc's shorter diameter to be at most {AXIS_RATIO_LIMIT} of its longer one, found {found:.3}: \
         of a rounder disc nobody could tell how it is turned; leave it out for a round one"
    )]
    Axes { found: f64 },
    /// Numbers of a kind that has none.
    #[error(
        "numbers are those of codes, and this kind has none: give a code, or a number of copies"
    )]
    NoCodes,
    /// A board's ratio is that of all coded prints.
    #[error(
        "a board's roundels are coded, so their inner diameter is {} of the outer one: give the outer one alone",
        CodeLayout::RATIO
    )]
    BoardInner,
    /// No such codes.
    #[error(transparent)]
    Code(#[from] CodeError),
    #[error(transparent)]
    Board(#[from] BoardError),
    /// It does not fit.
    #[error(transparent)]
    BoardPage(#[from] BoardPageError),
    #[error(transparent)]
    PageLayout(#[from] PageLayoutError),
}

impl PrintJob {
    /// The board of so many columns and rows; without a diameter or pitch (millimetres), those of a sheet of A4.
    pub fn board(
        sides: (usize, usize),
        diameters: Option<Diameters>,
        pitch_mm: Option<f64>,
        layout: CodeLayout,
    ) -> Result<Board, PrintJobError> {
        let outer_m = match diameters {
            None => BOARD_OUTER_M,
            Some(Diameters { outer_m, inner_m: None, .. }) => outer_m,
            Some(_) => return Err(PrintJobError::BoardInner),
        };
        let pitch_m = pitch_mm.map_or(outer_m * BOARD_PITCH, |pitch_mm| pitch_mm * 1e-3);
        Ok(Board::new(sides, pitch_m, outer_m, layout)?)
    }

    /// Roundels of which only sizes are known; their kind has no name.
    pub fn roundels(
        print: &PrintSpec,
        numbers: Option<&CodeNumbers>,
    ) -> Result<Vec<PrintItem>, PrintJobError> {
        let minor_m = print.diameters.and_then(|diameters| diameters.minor_m);
        if minor_m.is_some() && print.code.is_some() {
            return Err(PrintJobError::Exclusive);
        }
        let kind = print.kind().ok_or(PrintJobError::Inner)?;
        let kind = Kind { name: String::new(), ..kind };
        let minor_ratio = minor_m.map(|minor_m| minor_m / kind.outer_diameter_m);
        for found in [Some(kind.ratio()), minor_ratio].into_iter().flatten() {
            if !is_measurable(found) {
                return Err(PrintJobError::Ratio { found });
            }
        }
        let roundness = minor_m.map(|minor_m| minor_m / kind.inner_diameter_m);
        if let Some(found) = roundness.filter(|&found| !tells_heading(found)) {
            return Err(PrintJobError::Axes { found });
        }
        items_of_kind(&kind, numbers)
    }

    /// So many of each roundel, one after the other; of the board there is one.
    #[must_use]
    pub fn copies(self, copies: usize) -> Self {
        match self {
            Self::Roundels(items) => Self::Roundels(
                items.iter().flat_map(|item| std::iter::repeat_n(item, copies)).cloned().collect(),
            ),
            Self::Board(board) => Self::Board(board),
        }
    }

    pub fn pages(&self, page: PageSize) -> Result<Vec<Page>, PrintJobError> {
        Ok(match self {
            Self::Roundels(items) => lay_out_pages(items, page)?,
            Self::Board(board) => vec![board_page(board, page)?],
        })
    }
}

/// One of each code of a kind that is asked for (all, if none is), or the one plain roundel.
pub fn items_of_kind(
    kind: &Kind,
    numbers: Option<&CodeNumbers>,
) -> Result<Vec<PrintItem>, PrintJobError> {
    let Pattern::Coded(layout) = kind.pattern else {
        if numbers.is_some() {
            return Err(PrintJobError::NoCodes);
        }
        return Ok(vec![PrintItem { kind: kind.clone(), number: None, label: kind.name.clone() }]);
    };
    let codes = layout.codes()?;
    let all = || codes.iter().map(|(code, _)| code.number).collect();
    let numbers = numbers.map_or_else(all, |CodeNumbers(numbers)| numbers.clone());
    Ok(numbers.into_iter().map(|number| coded_item(kind, number, None)).collect())
}

/// One code of a kind, with the name of what carries it.
pub fn coded_item(kind: &Kind, number: u16, carrier: Option<&str>) -> PrintItem {
    let label = carrier.map_or_else(|| format!("#{number}"), |name| format!("{name} #{number}"));
    PrintItem { kind: kind.clone(), number: Some(number), label }
}

/// A kind as an installation's configuration has it, line by line.
pub fn config_lines(kind: &Kind) -> Vec<String> {
    let (outer, inner) = (kind.outer_diameter_m * 1e3, kind.inner_diameter_m * 1e3);
    let mut lines = vec![
        "[[roundel]]".to_owned(),
        "name = \"robot\"".to_owned(),
        format!("outer_mm = {}", millimetres(outer)),
    ];
    match kind.pattern {
        Pattern::Plain => lines.push(format!("inner_mm = {}", millimetres(inner))),
        Pattern::Elliptical { minor_diameter_m } => {
            lines.push(format!("inner_mm = {}", millimetres(inner)));
            lines.push(format!("inner_minor_mm = {}", millimetres(minor_diameter_m * 1e3)));
        }
        Pattern::Coded(CodeLayout { bits, min_distance }) => {
            if !has_default_ratio(kind) {
                lines.push(format!("inner_mm = {}", millimetres(inner)));
            }
            lines.push(format!("code = {{ bits = {bits}, min_distance = {min_distance} }}"));
        }
    }
    if kind.polarity == Polarity::WhiteRing {
        lines.push("polarity = \"white_ring\"".to_owned());
    }
    lines
}

/// Whether the inner diameter follows from the outer one, as it does of coded prints unless they were asked for otherwise.
pub(super) fn has_default_ratio(kind: &Kind) -> bool {
    (kind.ratio() - CodeLayout::RATIO).abs() < 1e-6
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::print::spec::{code, diameters};

    fn printed(marker: &str, layout: Option<&str>) -> Result<Vec<PrintItem>, PrintJobError> {
        let code = layout.map(|layout| code(layout).unwrap());
        let diameters = Some(diameters(marker).unwrap());
        let polarity = Polarity::BlackRing;
        PrintJob::roundels(&PrintSpec { diameters, code, polarity }, None)
    }

    #[test]
    fn the_lines_to_configure_say_what_was_printed() {
        let lines =
            |marker, layout| config_lines(&printed(marker, layout).unwrap()[0].kind).join("; ");
        assert!(!lines("160", Some("8:2")).contains("inner_mm"));
        assert!(!lines("160:96", Some("8:2")).contains("inner_mm"));
        assert!(lines("160:64", Some("8:2")).contains("inner_mm = 64; code = { bits = 8"));
        assert!(lines("160:64", None).contains("inner_mm = 64"));
    }

    #[test]
    fn diameters_at_the_limits_are_printed() {
        for marker in ["50:10", "30:6", "25:20", "7:1.4", "50:20:10", "100:70:63"] {
            assert!(printed(marker, None).is_ok(), "{marker}");
        }
        for marker in ["50:9.99", "25:20.01", "50:20:9.99", "100:70:63.01"] {
            assert!(printed(marker, None).is_err(), "{marker}");
        }
    }

    #[test]
    fn a_disc_that_is_nearly_round_is_not_printed_as_an_ellipse() {
        assert!(printed("160:96:86", None).is_ok());
        let error = printed("160:96:95", None).unwrap_err().to_string();
        assert!(error.contains("at most 0.9") && error.contains("found 0.990"), "{error}");
    }
}
