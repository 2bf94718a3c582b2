//! A print job: roundels of a kind by their numbers, or a calibration board.

use roundel_core::{
    calib::board::{Board, BoardError},
    marker::{
        AXIS_RATIO_LIMIT, CodeError, CodeLayout, Kind, Pattern, Polarity, RATIO_LIMITS,
        is_measurable, shows_heading,
    },
};
use thiserror::Error;

use super::{
    BOARD_OUTER_M, BOARD_PITCH, Page, PageLayoutError, PageSize, PrintItem, board_page,
    lay_out_pages, millimetres,
    spec::{CodeNumbers, Diameters, PrintSpec},
};

#[derive(Clone, Debug, PartialEq)]
pub enum PrintJob {
    Roundels(Vec<PrintItem>),
    Board(Board),
}

#[derive(Clone, Debug, PartialEq, Error)]
pub enum PrintJobError {
    #[error("expected OUTER_MM:INNER_MM for a plain roundel, or a code for a coded one")]
    Inner,
    #[error("an elliptical disc and a code exclude each other")]
    Exclusive,
    #[error(
        "expected a disc of {} to {} of the outer diameter, found {found:.3}: the detector finds no other",
        RATIO_LIMITS.0, RATIO_LIMITS.1
    )]
    Ratio { found: f64 },
    #[error(
        "expected the disc's shorter diameter to be at most {AXIS_RATIO_LIMIT} of its longer one, found {found:.3}: \
         the heading of a rounder disc cannot be measured; leave it out for a round one"
    )]
    Axes { found: f64 },
    #[error(
        "numbers are those of codes, and this kind has none: give a code, or a number of copies"
    )]
    NoCodes,
    #[error(
        "a board's roundels are coded, so their inner diameter is {} of the outer one: give the outer one alone",
        CodeLayout::RATIO
    )]
    BoardInner,
    #[error(transparent)]
    Code(#[from] CodeError),
    #[error(transparent)]
    Board(#[from] BoardError),
    #[error(transparent)]
    PageLayout(#[from] PageLayoutError),
}

impl PrintJob {
    /// A board of `sides` columns and rows. Default diameter and pitch (millimetres) make a 7x5 board fit on A4.
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

    /// Roundels that are described only by their sizes; their kind has no name.
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
        let mut ratios = std::iter::once(kind.ratio()).chain(minor_ratio);
        if let Some(found) = ratios.find(|&ratio| !is_measurable(ratio)) {
            return Err(PrintJobError::Ratio { found });
        }
        let axis_ratio = minor_m.map(|minor_m| minor_m / kind.inner_diameter_m);
        if let Some(found) = axis_ratio.filter(|&ratio| !shows_heading(ratio)) {
            return Err(PrintJobError::Axes { found });
        }
        items_of_kind(&kind, numbers)
    }

    /// Repeats each roundel; there is always one board.
    #[must_use]
    pub fn copies(self, copies: usize) -> Self {
        match self {
            Self::Roundels(items) => Self::Roundels(
                items.iter().flat_map(|item| std::iter::repeat_n(item, copies)).cloned().collect(),
            ),
            board => board,
        }
    }

    pub fn pages(&self, page: PageSize) -> Result<Vec<Page>, PrintJobError> {
        Ok(match self {
            Self::Roundels(items) => lay_out_pages(items, page)?,
            Self::Board(board) => vec![board_page(board, page)?],
        })
    }
}

/// One roundel for each of the given codes of a kind, by default all of them; or the one without a code.
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

/// One code of a kind; the label names its carrier.
pub fn coded_item(kind: &Kind, number: u16, carrier: Option<&str>) -> PrintItem {
    let label = carrier.map_or_else(|| format!("#{number}"), |name| format!("{name} #{number}"));
    PrintItem { kind: kind.clone(), number: Some(number), label }
}

/// The lines that describe a kind in a configuration; one without a name is called "robot".
pub fn config_lines(kind: &Kind) -> Vec<String> {
    let (outer, inner) = (kind.outer_diameter_m * 1e3, kind.inner_diameter_m * 1e3);
    let mut lines = vec![
        "[[roundel]]".to_owned(),
        format!("name = {:?}", if kind.name.is_empty() { "robot" } else { &kind.name }),
        format!("outer_mm = {}", millimetres(outer)),
    ];
    if !(matches!(kind.pattern, Pattern::Coded(_)) && has_default_ratio(kind)) {
        lines.push(format!("inner_mm = {}", millimetres(inner)));
    }
    match kind.pattern {
        Pattern::Plain => {}
        Pattern::Elliptical { minor_diameter_m } => {
            lines.push(format!("inner_minor_mm = {}", millimetres(minor_diameter_m * 1e3)));
        }
        Pattern::Coded(CodeLayout { bits, min_distance }) => {
            lines.push(format!("code = {{ bits = {bits}, min_distance = {min_distance} }}"));
        }
    }
    if kind.polarity == Polarity::WhiteRing {
        lines.push("polarity = \"white_ring\"".to_owned());
    }
    lines
}

/// Whether the inner diameter is the default of coded prints.
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
    fn configuration_lines_describe_the_print() {
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
