//! Calibration of a camera's lens with a printed board that the operator moves in front of it.

use axum::{
    Json,
    extract::State,
    http::{HeaderValue, header},
    response::{IntoResponse, Response},
};
use roundel_core::{calib::lens::DistortionModel, camera::MAX_SIDE_PX};
use serde::Deserialize;
use utoipa::ToSchema;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, Body, Example, NO_STORE, blocking, download},
    picture, queries, setup,
};
use crate::lab::{
    lens::{DEFAULT_VIEWS, LensError, LensRun, PictureSource, VIEWS, report::LensStatus},
    print::{BOARD_LAYOUT, PrintJob, spec},
};

const DEFAULT_BOARD: &str = "7x5";

/// Request for a lens calibration: the camera and the printed board.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LensRequest {
    /// Name of a camera of this server; or a `source`
    camera: String,
    /// A source as in a configuration, which is opened for the calibration
    source: String,
    /// With source: columns to request, pixels; 0: the source's default.
    width: usize,
    /// With source: rows to request, likewise.
    height: usize,
    /// Camera name in the file [the camera's]
    name: String,
    /// The printed board: COLUMNSxROWS [7x5]
    board: String,
    /// Its roundels' outer diameter, millimetres, as measured on the print [30]
    marker: Option<f64>,
    /// From centre to centre, millimetres, as measured on the print [1.2 of the outer diameter]
    pitch: Option<f64>,
    /// Its codes: BITS[:DISTANCE] [9]
    code: String,
    /// Maximum number of views kept, 5 to 100 [40]
    views: Option<usize>,
    /// plumb_bob, rational_polynomial or equidistant [the best supported by the views]
    model: String,
}

impl Example for LensRequest {
    const EXAMPLE: &str = r#"{"camera": "north", "board": "7x5"}"#;
}

/// Progress and result of the newest calibration of a lens.
///
/// A calibration whose status is not read for a minute is cancelled.
#[utoipa::path(
    get, path = "/api/v1/lens", tag = "calibration",
    responses((status = 200, description = "the newest calibration", body = LensStatus)),
)]
pub async fn show(State(api): Api) -> Answer<LensStatus> {
    newest(&api)
}

/// Starts a lens calibration: searches a camera's pictures for the printed board.
///
/// Move the board and hold it still at each place. Useful views are kept automatically, and the lens is estimated when they
/// suffice.
///
/// The camera keeps running. A server that is open to a network opens sources only with `setup = true` in its
/// configuration.
#[utoipa::path(
    post, path = "/api/v1/lens", tag = "calibration",
    request_body = LensRequest,
    responses(
        (status = 200, description = "the search runs", body = LensStatus),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "lists the existing cameras", body = ErrorBody),
        (status = 409, description = "a calibration is running, or clients must not open sources", body = ErrorBody),
    ),
)]
pub async fn start(State(api): Api, Body(request): Body<LensRequest>) -> Answer<LensStatus> {
    let requested = api.clone();
    // Resolves the paths of a source.
    let run = blocking(move || lens_run(&requested, &request)).await?;
    api.lenses.start(run)?;
    newest(&api)
}

/// Cancels the running calibration.
#[utoipa::path(
    delete, path = "/api/v1/lens", tag = "calibration",
    responses(
        (status = 200, description = "it was cancelled", body = LensStatus),
        (status = 409, description = "no calibration is running", body = ErrorBody),
    ),
)]
pub async fn cancel(State(api): Api) -> Answer<LensStatus> {
    api.lenses.cancel()?;
    newest(&api)
}

/// Stops the search and estimates the lens from the views kept so far.
#[utoipa::path(
    put, path = "/api/v1/lens/finished", tag = "calibration",
    responses(
        (status = 200, description = "it solves", body = LensStatus),
        (status = 409, description = "no calibration is running", body = ErrorBody),
    ),
)]
pub async fn finish(State(api): Api) -> Answer<LensStatus> {
    api.lenses.finish()?;
    newest(&api)
}

/// The newest searched picture with the detected board.
#[utoipa::path(
    get, path = "/api/v1/lens/picture.jpg", tag = "calibration",
    responses(
        (status = 200, description = "the picture", content_type = "image/jpeg"),
        (status = 503, description = "no picture was searched yet", body = ErrorBody),
    ),
)]
pub async fn picture(State(api): Api) -> Result<Response, ApiError> {
    let Some(shown) = api.lenses.shown() else {
        let why = "no picture was searched yet: start a calibration of a lens, and wait for its first picture";
        return Err(ApiError::Unavailable(why.to_owned()));
    };
    let bytes = picture::BYTES_PER_PIXEL * shown.pixel_count();
    let draw = move |_: &_| shown.jpeg().map_err(|error| ApiError::Internal(error.to_string()));
    let jpeg = api.pictures.run(bytes, draw).await?.into_bytes();
    let headers = [(header::CONTENT_TYPE, HeaderValue::from_static("image/jpeg")), NO_STORE];
    Ok((headers, jpeg).into_response())
}

/// The result, as ROS' `camera_info` YAML.
#[utoipa::path(
    get, path = "/api/v1/lens/file", tag = "calibration",
    responses(
        (status = 200, description = "the file", content_type = "application/yaml"),
        (status = 409, description = "there is no result yet", body = ErrorBody),
    ),
)]
pub async fn file(State(api): Api) -> Result<Response, ApiError> {
    let found = api.lenses.found()?;
    let plain = |it: char| if it.is_ascii_alphanumeric() { it } else { '-' };
    let name: String = found.name.chars().map(plain).collect();
    download("application/yaml", &format!("{name}.yaml"), found.file())
}

/// Stores the result next to the server's configuration. If it belongs to a camera of the server, the camera uses it from
/// its next frame on.
#[utoipa::path(
    put, path = "/api/v1/lens/applied", tag = "calibration",
    responses(
        (status = 200, description = "`applied` says where it is stored", body = LensStatus),
        (status = 409, description = "there is no result yet, or clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn apply(State(api): Api) -> Answer<LensStatus> {
    let found = api.lenses.found()?;
    let manager = setup::manager_if_allowed(&api)?;
    let kept = blocking(move || match &found.camera {
        Some(camera) => manager.use_lens(camera, &found.file()).map(|(file, _)| file),
        None => manager.save_lens(&found.name, &found.file()),
    })
    .await?;
    api.lenses.applied(&kept);
    newest(&api)
}

fn newest(api: &ApiState) -> Answer<LensStatus> {
    let can_apply = api.camera_manager.is_some();
    Ok(Json(LensStatus { can_apply, ..api.lenses.status() }))
}

fn lens_run(api: &ApiState, request: &LensRequest) -> Result<LensRun, ApiError> {
    let (picture_source, shown) = picture_source(api, request)?;
    let wrong = |field| move |message: String| ApiError::Invalid { field, message };
    let sides = if request.board.is_empty() { DEFAULT_BOARD } else { &request.board };
    let sides = spec::sides(sides).map_err(wrong("board"))?;
    let marker = request.marker.map(|mm| spec::diameters(&mm.to_string())).transpose();
    let marker = marker.map_err(wrong("marker"))?;
    let layout = match request.code.as_str() {
        "" => BOARD_LAYOUT,
        code => spec::code(code).map_err(wrong("code"))?,
    };
    let board = PrintJob::board(sides, marker, request.pitch, layout)
        .map_err(|error| wrong("board")(error.to_string()))?;
    let model = match request.model.as_str() {
        "" => None,
        "plumb_bob" => Some(DistortionModel::PlumbBob),
        "rational_polynomial" => Some(DistortionModel::Rational),
        "equidistant" => Some(DistortionModel::Equidistant),
        other => {
            let expected = "plumb_bob, rational_polynomial or equidistant";
            return Err(ApiError::invalid("model", expected, format!("{other:?}")));
        }
    };
    let name = match (&picture_source, request.name.as_str()) {
        (PictureSource::Camera(_, camera), "") => camera.clone(),
        (PictureSource::Source(..), "") => "camera".to_owned(),
        (_, name) => name.to_owned(),
    };
    let max_views = request.views.unwrap_or(DEFAULT_VIEWS);
    Ok(LensRun { picture_source, name, shown, board, max_views, model })
}

fn picture_source(
    api: &ApiState,
    request: &LensRequest,
) -> Result<(PictureSource, String), ApiError> {
    let LensRequest { camera, source, width, height, .. } = request;
    match (camera.as_str(), source.as_str()) {
        ("", "") => Err(ApiError::invalid("camera", "a camera's name, or a `source`", "neither")),
        (camera, "") => {
            let id = queries::camera_id(api, camera)?;
            Ok((PictureSource::Camera(id, camera.to_owned()), camera.to_owned()))
        }
        ("", source) => {
            let Some(manager) = &api.camera_manager else {
                return Err(ApiError::FailedPrecondition(
                    "this server is open to a network, so clients must not open sources: `setup = true` under [server] \
                     allows it, for every client that reaches its port; `roundel calibrate lens SOURCE` opens one on its machine"
                        .into(),
                ));
            };
            let size = (*width, *height);
            let is_side = |side: &usize| (1..=MAX_SIDE_PX).contains(side);
            if size != (0, 0) && ![width, height].into_iter().all(is_side) {
                let expected = format!("1 to {MAX_SIDE_PX} pixels each, or neither");
                return Err(ApiError::invalid("width", expected, format!("{width} x {height}")));
            }
            let size = (size != (0, 0)).then_some(size);
            Ok(api.lenses.source(source, size, |address| manager.admit_source(address))?)
        }
        _ => Err(ApiError::invalid("camera", "either a camera or a source", "both")),
    }
}

impl From<LensError> for ApiError {
    fn from(error: LensError) -> Self {
        match error {
            LensError::Views(found) => {
                let (least, most) = VIEWS;
                Self::invalid("views", format!("{least} to {most} views"), found)
            }
            LensError::Address(_) | LensError::Rule(_) | LensError::Fed => {
                Self::Invalid { field: "source", message: error.to_string() }
            }
            LensError::Thread(_) => Self::Internal(error.to_string()),
            _ => Self::FailedPrecondition(error.to_string()),
        }
    }
}
