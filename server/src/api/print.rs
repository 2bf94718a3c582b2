//! Roundels to print, as a file: what `roundel print` writes.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{HeaderMap, HeaderValue, Uri, header},
    response::{IntoResponse, Response},
};
use clap::ValueEnum as _;
use roundel_core::marker::CodeLayout;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    query::QueryParameters,
};
use crate::lab::print::{
    self, BOARD_LAYOUT, CodeListing, Page, PageSize, PrintJob,
    spec::{self, PolarityArg, PrintSpec},
};

/// Most pages that are made for a request.
const MAX_PAGES: usize = 100;
/// Most copies of each roundel.
const MAX_COPIES: usize = 1000;
/// Dots an inch of a picture, if nobody says how many.
const DPI: f64 = 300.0;

/// Roundels or the calibration board, true to scale: print them at 100 %.
#[utoipa::path(
    get, path = "/api/v1/print", tag = "print",
    params(
        ("format" = Option<String>, Query, description = "pdf, or svg or png, which have one page [pdf]", example = "pdf"),
        ("marker" = Option<String>, Query, description = "OUTER_MM[:INNER_MM[:MINOR_MM]]", example = "160"),
        ("code" = Option<String>, Query, description = "BITS[:DISTANCE]", example = "8:2"),
        ("ids" = Option<String>, Query, description = "numbers of codes; all, if left out", example = "1-24,30"),
        ("polarity" = Option<String>, Query, description = "black-ring or white-ring"),
        ("board" = Option<String>, Query, description = "COLUMNSxROWS of a calibration board instead", example = "7x5"),
        ("pitch" = Option<f64>, Query, description = "with board: from centre to centre, millimetres"),
        ("page" = Option<String>, Query, description = "A2, A3, A4, A5, Letter, Legal or WIDTHxHEIGHT in millimetres [A4]"),
        ("copies" = Option<usize>, Query, description = "how many of each roundel [1]"),
        ("sheet" = Option<usize>, Query, description = "with svg and png: which page, from 1 [1]"),
        ("dpi" = Option<f64>, Query, description = "with png: dots an inch [300]"),
    ),
    responses(
        (status = 200, description = "the file", content_type = "application/pdf"),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
    ),
)]
pub async fn file(State(_): State<Arc<ApiState>>, uri: Uri) -> Result<Response, ApiError> {
    let mut parameters = QueryParameters::of(&uri)?;
    let format = parameters.take("format")?.unwrap_or_else(|| "pdf".to_owned());
    let sheet = parameters.take_parsed::<usize>("sheet", "a page's number from 1")?;
    let page = read(&mut parameters, "page", |text| {
        PageSize::parse(text).map_err(|error| error.to_string())
    })?;
    let copies = parameters.take_parsed::<usize>("copies", "how many of each, from 1")?;
    let dpi = parameters.take_parsed::<f64>("dpi", "dots an inch")?;
    let order = order(&mut parameters, copies)?;
    parameters.finish()?;
    alone("sheet", sheet, "it with `format` svg or png alone", matches!(&*format, "svg" | "png"))?;
    alone("dpi", dpi, "it with `format` png alone", format == "png")?;
    let (sheet, dpi) = (sheet.unwrap_or(1), dpi.unwrap_or(DPI));
    let work = move || -> Result<Response, ApiError> {
        let a4 = PageSize { width_mm: 210.0, height_mm: 297.0 };
        let pages = order
            .pages(page.unwrap_or(a4))
            .map_err(|error| ApiError::Invalid { field: "query", message: error.to_string() })?;
        if pages.len() > MAX_PAGES {
            let expected = format!(
                "at most {MAX_PAGES} pages: fewer `ids` or `copies` at a time, or a larger `page`"
            );
            return Err(ApiError::invalid("query", expected, format!("{} pages", pages.len())));
        }
        match format.as_str() {
            "pdf" => Ok(sent("application/pdf", "roundels.pdf", print::pdf(&pages, "Roundels"))),
            "svg" => {
                let svg = page_of(&pages, sheet)?.svg();
                Ok(sent("image/svg+xml", "roundels.svg", svg.into_bytes()))
            }
            "png" => {
                let mut bytes = Vec::new();
                let drawn = print::png(page_of(&pages, sheet)?, dpi, &mut bytes);
                drawn.map_err(|error| ApiError::Invalid {
                    field: "dpi",
                    message: error.to_string(),
                })?;
                Ok(sent("image/png", "roundels.png", bytes))
            }
            other => Err(ApiError::invalid("format", "pdf, svg or png", format!("{other:?}"))),
        }
    };
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|error| ApiError::Internal(format!("laying out the pages ended early: {error}")))?
}

/// The page of that number, from 1.
fn page_of(pages: &[Page], sheet: usize) -> Result<&Page, ApiError> {
    sheet.checked_sub(1).and_then(|index| pages.get(index)).ok_or_else(|| {
        let expected = format!("a page from 1 to {}", pages.len());
        ApiError::invalid("sheet", expected, sheet)
    })
}

fn counted(copies: Option<usize>) -> Result<usize, ApiError> {
    let copies = copies.unwrap_or(1);
    let is_some = (1..=MAX_COPIES).contains(&copies);
    is_some
        .then_some(copies)
        .ok_or_else(|| ApiError::invalid("copies", format!("1 to {MAX_COPIES}"), copies))
}

/// Every code of a kind, with its Hamming distances.
#[utoipa::path(
    get, path = "/api/v1/codes", tag = "print",
    params(("code" = Option<String>, Query, description = "BITS[:DISTANCE] [8:2]", example = "8:2")),
    responses(
        (status = 200, description = "the codes by number", body = Vec<CodeListing>),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
    ),
)]
pub async fn codes(
    State(_): State<Arc<ApiState>>,
    uri: Uri,
) -> Result<Json<Vec<CodeListing>>, ApiError> {
    let mut parameters = QueryParameters::of(&uri)?;
    let code = read(&mut parameters, "code", spec::code)?;
    parameters.finish()?;
    let layout = code.unwrap_or(CodeLayout { bits: 8, min_distance: 2 });
    let listed = tokio::task::spawn_blocking(move || print::list_codes(layout)).await;
    listed
        .map_err(|error| ApiError::Internal(format!("listing the codes ended early: {error}")))?
        .map(Json)
        .map_err(|error| ApiError::Invalid { field: "code", message: error.to_string() })
}

fn order(parameters: &mut QueryParameters, copies: Option<usize>) -> Result<PrintJob, ApiError> {
    let marker = read(parameters, "marker", spec::diameters)?;
    let code = read(parameters, "code", spec::code)?;
    let numbers = read(parameters, "ids", spec::numbers)?;
    let polarity = read(parameters, "polarity", |text| PolarityArg::from_str(text, true))?;
    let board = read(parameters, "board", spec::sides)?;
    let pitch_mm = parameters.take_parsed::<f64>("pitch", "millimetres")?;
    let wrong = |field: &'static str| {
        move |error: print::PrintJobError| ApiError::Invalid { field, message: error.to_string() }
    };
    if let Some(sides) = board {
        const NO_BOARD: &str = "nothing: a board is one of its kind";
        alone("ids", numbers.as_ref().map(|_| "some"), NO_BOARD, false)?;
        alone("polarity", polarity.map(|_| "one"), NO_BOARD, false)?;
        alone("copies", copies, NO_BOARD, false)?;
        let layout = code.unwrap_or(BOARD_LAYOUT);
        return PrintJob::board(sides, marker, pitch_mm, layout)
            .map(PrintJob::Board)
            .map_err(wrong("board"));
    }
    alone("pitch", pitch_mm, "it with `board` alone", false)?;
    if marker.is_none() {
        return Err(ApiError::invalid("marker", "OUTER_MM[:INNER_MM], or a board", "neither"));
    }
    let print =
        PrintSpec { diameters: marker, code, polarity: polarity.unwrap_or_default().into() };
    PrintJob::roundels(&print, numbers.as_ref())
        .map_err(wrong("marker"))
        .and_then(|items| Ok(PrintJob::Roundels(items).copies(counted(copies)?)))
}

/// Refuses a parameter that is there and would change nothing.
fn alone<T: std::fmt::Display>(
    name: &'static str,
    found: Option<T>,
    expected: &str,
    counts: bool,
) -> Result<(), ApiError> {
    match found {
        Some(found) if !counts => Err(ApiError::invalid(name, expected, found)),
        _ => Ok(()),
    }
}

/// A parameter that `reader` understands; what it says is wrong is told with the parameter's name.
fn read<T>(
    parameters: &mut QueryParameters,
    name: &'static str,
    reader: impl Fn(&str) -> Result<T, String>,
) -> Result<Option<T>, ApiError> {
    let text = parameters.take(name)?;
    let wrong = |message| ApiError::Invalid { field: name, message };
    text.map(|text| reader(&text).map_err(wrong)).transpose()
}

fn sent(kind: &'static str, name: &str, bytes: Vec<u8>) -> Response {
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    let disposition = format!("attachment; filename=\"{name}\"");
    if let Ok(disposition) = HeaderValue::from_str(&disposition) {
        headers.insert(header::CONTENT_DISPOSITION, disposition);
    }
    (headers, bytes).into_response()
}
