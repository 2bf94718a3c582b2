//! Printable files of roundels and calibration boards, as `roundel print` writes them.

use axum::{Json, extract::State, http::Uri, response::Response};
use clap::ValueEnum as _;
use roundel_core::marker::CodeLayout;

use super::{
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, download},
    heavy,
    query::QueryParameters,
};
use crate::lab::print::{
    self, BOARD_LAYOUT, CodeListing, Page, PageSize, PrintJob, RasterError,
    spec::{self, CodeNumbers, Diameters, PolarityArg, PrintSpec},
};

/// Maximum number of pages per request.
const MAX_PAGES: usize = 100;
/// Maximum number of copies of each roundel.
const MAX_COPIES: usize = 1000;
/// Maximum number of roundels per request.
const MAX_ROUNDELS: usize = 5000;
/// Memory of a print: a band of pixels, and the outlines and texts of the roundels on all pages.
const PRINT_BYTES: usize = 24 * 1024 * 1024;
const ROUNDEL_BYTES: usize = 20 * 1024;
/// Memory of the largest table of codes.
const CODES_BYTES: usize = 8 * 1024 * 1024;
const DEFAULT_DPI: f64 = 300.0;

/// Roundels or the calibration board, true to scale: print them at 100 %.
#[utoipa::path(
    get, path = "/api/v1/print", tag = "print",
    params(
        ("format" = Option<String>, Query, description = "pdf, or svg or png with a single page [pdf]", example = "pdf"),
        ("marker" = Option<String>, Query, description = "OUTER_MM[:INNER_MM[:MINOR_MM]]", example = "160"),
        ("code" = Option<String>, Query, description = "BITS[:DISTANCE]", example = "8:2"),
        ("ids" = Option<String>, Query, description = "numbers of codes [all]", example = "1-24,30"),
        ("polarity" = Option<String>, Query, description = "black-ring or white-ring"),
        ("board" = Option<String>, Query, description = "COLUMNSxROWS of a calibration board instead", example = "7x5"),
        ("pitch" = Option<f64>, Query, description = "with board: from centre to centre, millimetres"),
        ("page" = Option<String>, Query, description = "A2, A3, A4, A5, Letter, Legal or WIDTHxHEIGHT in millimetres [A4]"),
        ("copies" = Option<usize>, Query, description = "copies of each roundel [1]"),
        ("sheet" = Option<usize>, Query, description = "with svg and png: which page, from 1 [1]"),
        ("dpi" = Option<f64>, Query, description = "with png: dots per inch [300]"),
    ),
    responses(
        (status = 200, description = "the file", content_type = "application/pdf"),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 503, description = "the server is busy", body = ErrorBody),
    ),
)]
pub async fn file(State(api): Api, uri: Uri) -> Result<Response, ApiError> {
    let mut parameters = QueryParameters::of(&uri)?;
    let format = parameters.take("format")?.unwrap_or_else(|| "pdf".to_owned());
    let sheet = parameters.take_parsed::<usize>("sheet", "a page number from 1")?;
    let page = take_spec(&mut parameters, "page", |text| {
        PageSize::parse(text).map_err(|error| error.to_string())
    })?;
    let copies = parameters.take_parsed::<usize>("copies", "a number of copies from 1")?;
    let dpi = parameters.take_parsed::<f64>("dpi", "dots per inch")?;
    let request = take_request(&mut parameters, copies)?;
    parameters.finish()?;
    if !matches!(&*format, "svg" | "png") {
        reject("sheet", sheet, "`sheet` only with `format` svg or png")?;
    }
    if format != "png" {
        reject("dpi", dpi, "`dpi` only with `format` png")?;
    }
    let (media_type, name) = match format.as_str() {
        "pdf" => ("application/pdf", "roundels.pdf"),
        "svg" => ("image/svg+xml", "roundels.svg"),
        "png" => ("image/png", "roundels.png"),
        other => return Err(ApiError::invalid("format", "pdf, svg or png", format!("{other:?}"))),
    };
    let (sheet, dpi) = (sheet.unwrap_or(1), dpi.unwrap_or(DEFAULT_DPI));
    let bytes = PRINT_BYTES + ROUNDEL_BYTES * request.most_roundels();
    let file = api.files.run(bytes, move |stop| {
        let job = request.job()?;
        let a4 = PageSize { width_mm: 210.0, height_mm: 297.0 };
        let pages = job.pages(page.unwrap_or(a4)).map_err(|error| invalid("query", error))?;
        if pages.len() > MAX_PAGES {
            let expected = format!(
                "at most {MAX_PAGES} pages: request fewer `ids` or `copies`, or a larger `page`"
            );
            return Err(ApiError::invalid("query", expected, format!("{} pages", pages.len())));
        }
        match format.as_str() {
            "pdf" => Ok(print::pdf(&pages, "Roundels")),
            "svg" => Ok(page_of(&pages, sheet)?.svg().into_bytes()),
            _ => {
                let mut bytes = Vec::new();
                match print::png_until(page_of(&pages, sheet)?, dpi, &mut bytes, stop) {
                    Ok(()) => Ok(bytes),
                    Err(RasterError::Stopped) => Err(heavy::stopped()),
                    Err(error) => Err(invalid("dpi", error)),
                }
            }
        }
    });
    download(media_type, name, file.await?.into_bytes())
}

/// The page of that number, from 1.
fn page_of(pages: &[Page], sheet: usize) -> Result<&Page, ApiError> {
    sheet.checked_sub(1).and_then(|index| pages.get(index)).ok_or_else(|| {
        let expected = format!("a page from 1 to {}", pages.len());
        ApiError::invalid("sheet", expected, sheet)
    })
}

/// Every code of a layout, with its Hamming distances.
#[utoipa::path(
    get, path = "/api/v1/codes", tag = "print",
    params(("code" = Option<String>, Query, description = "BITS[:DISTANCE] [8:2]", example = "8:2")),
    responses(
        (status = 200, description = "the codes by number", body = Vec<CodeListing>),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
    ),
)]
pub async fn codes(State(api): Api, uri: Uri) -> Answer<Vec<CodeListing>> {
    let mut parameters = QueryParameters::of(&uri)?;
    let code = take_spec(&mut parameters, "code", spec::code)?;
    parameters.finish()?;
    let layout = code.unwrap_or(CodeLayout { bits: 8, min_distance: 2 });
    let list = move |_: &_| print::list_codes(layout).map_err(|error| invalid("code", error));
    Ok(Json(api.files.run(CODES_BYTES, list).await?.into_inner()))
}

/// The parameters that describe a print job.
struct PrintRequest {
    diameters: Option<Diameters>,
    code: Option<CodeLayout>,
    numbers: Option<CodeNumbers>,
    polarity: Option<PolarityArg>,
    board: Option<(usize, usize)>,
    pitch_mm: Option<f64>,
    copies: Option<usize>,
}

fn take_request(
    parameters: &mut QueryParameters,
    copies: Option<usize>,
) -> Result<PrintRequest, ApiError> {
    Ok(PrintRequest {
        diameters: take_spec(parameters, "marker", spec::diameters)?,
        code: take_spec(parameters, "code", spec::code)?,
        numbers: take_spec(parameters, "ids", spec::numbers)?,
        polarity: take_spec(parameters, "polarity", |text| PolarityArg::from_str(text, true))?,
        board: take_spec(parameters, "board", spec::sides)?,
        pitch_mm: parameters.take_parsed::<f64>("pitch", "millimetres")?,
        copies,
    })
}

impl PrintRequest {
    /// An upper bound of the number of roundels, before their codes are listed.
    fn most_roundels(&self) -> usize {
        let different = match (self.board, &self.numbers, self.code) {
            (Some((columns, rows)), ..) => columns.saturating_mul(rows),
            (None, Some(CodeNumbers(numbers)), _) => numbers.len(),
            // Codes that are rotations of each other count once.
            (None, None, Some(layout)) => {
                (1 << layout.bits.min(16)) / usize::from(layout.bits.max(1)) + 16
            }
            (None, None, None) => 1,
        };
        different.saturating_mul(self.copies.unwrap_or(1)).min(MAX_ROUNDELS)
    }

    fn job(self) -> Result<PrintJob, ApiError> {
        let Self { diameters, code, numbers, polarity, board, pitch_mm, copies } = self;
        if let Some(sides) = board {
            const NO_BOARD: &str = "no such parameter for a board";
            reject("ids", numbers.as_ref().map(|_| "some"), NO_BOARD)?;
            reject("polarity", polarity.map(|_| "one"), NO_BOARD)?;
            reject("copies", copies, NO_BOARD)?;
            let layout = code.unwrap_or(BOARD_LAYOUT);
            let board = PrintJob::board(sides, diameters, pitch_mm, layout);
            return board.map(PrintJob::Board).map_err(|error| invalid("board", error));
        }
        reject("pitch", pitch_mm, "`pitch` only with `board`")?;
        if diameters.is_none() {
            return Err(ApiError::invalid("marker", "OUTER_MM[:INNER_MM], or a board", "neither"));
        }
        let spec = PrintSpec { diameters, code, polarity: polarity.unwrap_or_default().into() };
        let items = PrintJob::roundels(&spec, numbers.as_ref());
        let items = items.map_err(|error| invalid("marker", error))?;
        let copies = copies.unwrap_or(1);
        if !(1..=MAX_COPIES).contains(&copies) {
            return Err(ApiError::invalid("copies", format!("1 to {MAX_COPIES}"), copies));
        }
        let roundels = items.len() * copies;
        if roundels > MAX_ROUNDELS {
            let expected =
                format!("at most {MAX_ROUNDELS} roundels: request fewer `ids` or `copies`");
            return Err(ApiError::invalid("query", expected, format!("{roundels} roundels")));
        }
        Ok(PrintJob::Roundels(items).copies(copies))
    }
}

/// Rejects a parameter that would have no effect.
fn reject(
    name: &'static str,
    found: Option<impl ToString>,
    expected: &str,
) -> Result<(), ApiError> {
    found.map_or(Ok(()), |found| Err(ApiError::invalid(name, expected, found)))
}

/// Takes a parameter and reads it as the command line does.
pub(super) fn take_spec<T>(
    parameters: &mut QueryParameters,
    name: &'static str,
    read: impl Fn(&str) -> Result<T, String>,
) -> Result<Option<T>, ApiError> {
    let text = parameters.take(name)?;
    text.map(|text| read(&text).map_err(|message| invalid(name, message))).transpose()
}

fn invalid(field: &'static str, message: impl ToString) -> ApiError {
    ApiError::Invalid { field, message: message.to_string() }
}
