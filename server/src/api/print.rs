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
    Api,
    error::{ApiError, ErrorBody},
    query::Parameters,
};
use crate::print::{
    self, BOARD_LAYOUT, Listed, Order, PageSize,
    spec::{self, PolarityWord, Print},
};

/// Most pages that are made for a request.
const MAX_PAGES: usize = 100;

/// Roundels or the calibration board, true to scale: print them at 100 %.
#[utoipa::path(
    get, path = "/api/v1/print", tag = "print",
    params(
        ("format" = Option<String>, Query, description = "pdf, or svg, which has one page [pdf]", example = "pdf"),
        ("marker" = Option<String>, Query, description = "OUTER_MM[:INNER_MM[:MINOR_MM]]", example = "160"),
        ("code" = Option<String>, Query, description = "BITS[:DISTANCE]", example = "8:2"),
        ("ids" = Option<String>, Query, description = "numbers of codes; all, if left out", example = "1-24,30"),
        ("polarity" = Option<String>, Query, description = "black-ring or white-ring"),
        ("board" = Option<String>, Query, description = "COLUMNSxROWS of a calibration board instead", example = "7x5"),
        ("pitch" = Option<f64>, Query, description = "with board: from centre to centre, millimetres"),
        ("page" = Option<String>, Query, description = "A2, A3, A4, A5, Letter, Legal or WIDTHxHEIGHT in millimetres [A4]"),
        ("sheet" = Option<usize>, Query, description = "with svg: which page, from 1 [1]"),
    ),
    responses(
        (status = 200, description = "the file", content_type = "application/pdf"),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
    ),
)]
pub async fn file(State(_): State<Arc<Api>>, uri: Uri) -> Result<Response, ApiError> {
    let mut parameters = Parameters::of(&uri)?;
    let format = parameters.take("format")?.unwrap_or_else(|| "pdf".to_owned());
    let sheet = parameters.take_parsed::<usize>("sheet", "a page's number from 1")?.unwrap_or(1);
    let page = read(&mut parameters, "page", |text| {
        PageSize::parse(text).map_err(|error| error.to_string())
    })?;
    let order = order(&mut parameters)?;
    parameters.finish()?;
    let work = move || -> Result<Response, ApiError> {
        let a4 = PageSize { width_mm: 210.0, height_mm: 297.0 };
        let pages = order
            .pages(page.unwrap_or(a4))
            .map_err(|error| ApiError::Invalid { field: "query", message: error.to_string() })?;
        if pages.len() > MAX_PAGES {
            let found = format!("{} pages", pages.len());
            return Err(ApiError::invalid("ids", format!("at most {MAX_PAGES} pages"), found));
        }
        match format.as_str() {
            "pdf" => Ok(sent("application/pdf", "roundels.pdf", print::pdf(&pages, "Roundels"))),
            "svg" => {
                let page = sheet.checked_sub(1).and_then(|index| pages.get(index));
                let page = page.ok_or_else(|| {
                    let expected = format!("a page from 1 to {}", pages.len());
                    ApiError::invalid("sheet", expected, sheet)
                })?;
                Ok(sent("image/svg+xml", "roundels.svg", print::svg(page).into_bytes()))
            }
            other => Err(ApiError::invalid("format", "pdf or svg", format!("{other:?}"))),
        }
    };
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|error| ApiError::Internal(format!("laying out the pages ended early: {error}")))?
}

/// Every code of a kind, with its Hamming distances.
#[utoipa::path(
    get, path = "/api/v1/codes", tag = "print",
    params(("code" = String, Query, description = "BITS[:DISTANCE]", example = "8:2")),
    responses(
        (status = 200, description = "the codes by number", body = Vec<Listed>),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
    ),
)]
pub async fn codes(State(_): State<Arc<Api>>, uri: Uri) -> Result<Json<Vec<Listed>>, ApiError> {
    let mut parameters = Parameters::of(&uri)?;
    let code = read(&mut parameters, "code", spec::code)?;
    parameters.finish()?;
    let layout = code.unwrap_or(CodeLayout { bits: 8, min_distance: 2 });
    let listed = tokio::task::spawn_blocking(move || print::list(layout)).await;
    listed
        .map_err(|error| ApiError::Internal(format!("listing the codes ended early: {error}")))?
        .map(Json)
        .map_err(|error| ApiError::Invalid { field: "code", message: error.to_string() })
}

fn order(parameters: &mut Parameters) -> Result<Order, ApiError> {
    let marker = read(parameters, "marker", spec::diameters)?;
    let code = read(parameters, "code", spec::code)?;
    let numbers = read(parameters, "ids", spec::numbers)?;
    let polarity = read(parameters, "polarity", |text| PolarityWord::from_str(text, true))?;
    let board = read(parameters, "board", spec::sides)?;
    let pitch_mm = parameters.take_parsed::<f64>("pitch", "millimetres")?;
    let wrong = |field: &'static str| {
        move |error: print::OrderError| ApiError::Invalid { field, message: error.to_string() }
    };
    if let Some(sides) = board {
        let layout = code.unwrap_or(BOARD_LAYOUT);
        return Order::board(sides, marker, pitch_mm, layout)
            .map(Order::Board)
            .map_err(wrong("board"));
    }
    if marker.is_none() {
        return Err(ApiError::invalid("marker", "OUTER_MM[:INNER_MM], or a board", "neither"));
    }
    let print = Print { diameters: marker, code, polarity: polarity.unwrap_or_default().into() };
    Order::roundels(&print, numbers.as_ref()).map(Order::Roundels).map_err(wrong("marker"))
}

/// A parameter that `reader` understands; what it says is wrong is told with the parameter's name.
fn read<T>(
    parameters: &mut Parameters,
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
