//! The lens of a camera, while somebody moves the printed board before it.

use std::sync::Arc;

use axum::{
    Json,
    extract::{State, rejection::JsonRejection},
    http::{HeaderMap, HeaderValue, header},
    response::{IntoResponse, Response},
};
use roundel_core::{calib::lens::Model, camera::MAX_SIDE_PX};
use serde::Deserialize;
use utoipa::ToSchema;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    queries, setup,
};
use crate::lab::{
    lens::{DEFAULT_VIEWS, LensError, LensRun, PictureSource, VIEWS, report::LensStatus},
    print::{BOARD_LAYOUT, PrintJob, spec},
};

/// If nobody says another one.
const BOARD: &str = "7x5";
const EXAMPLE: &str = r#"{"camera": "north", "board": "7x5"}"#;

/// Whose lens is wanted, and which board is moved before it.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LensRequest {
    /// A camera of this server, by name; or …
    camera: String,
    /// … a source as in a configuration, which is opened for it.
    source: String,
    /// With source: columns that are asked of it, pixels; 0: as it gives.
    width: usize,
    /// With source: rows, likewise.
    height: usize,
    /// What goes into the file as the camera's name [the camera's]
    name: String,
    /// The printed board: COLUMNSxROWS [7x5]
    board: String,
    /// Its roundels' outer diameter, millimetres, as measured on the print [30]
    marker: Option<f64>,
    /// From centre to centre, millimetres, as measured on the print [1.2 of the outer diameter]
    pitch: Option<f64>,
    /// Its codes: BITS[:DISTANCE] [9]
    code: String,
    /// Most views that are kept, 5 to 100 [40]
    views: Option<usize>,
    /// plumb_bob, rational_polynomial or equidistant [the one for which most speaks]
    model: String,
}

/// The newest calibration of a lens: what is seen, what is missing, and what came out.
///
/// One that nobody asks about for a minute ends by itself.
#[utoipa::path(
    get, path = "/api/v1/lens", tag = "calibration",
    responses((status = 200, description = "the newest one", body = LensStatus)),
)]
pub async fn show(State(api): State<Arc<ApiState>>) -> Json<LensStatus> {
    Json(newest(&api))
}

/// Begins to look for the printed board in a camera's pictures. Move it, and hold it still at each place: good views are
/// chosen by themselves, and solved once nothing is missing.
///
/// The camera goes on meanwhile. A server that is open to a network opens no source for it but with `setup = true` in its
/// configuration.
#[utoipa::path(
    post, path = "/api/v1/lens", tag = "calibration",
    request_body = LensRequest,
    responses(
        (status = 200, description = "it looks", body = LensStatus),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "names the cameras that there are", body = ErrorBody),
        (status = 409, description = "one is running, or clients may not", body = ErrorBody),
    ),
)]
pub async fn start(
    State(api): State<Arc<ApiState>>,
    body: Result<Json<LensRequest>, JsonRejection>,
) -> Result<Json<LensStatus>, ApiError> {
    let request = ApiError::body(body, EXAMPLE)?;
    let run = lens_run(&api, &request)?;
    api.lenses.start(run)?;
    Ok(Json(newest(&api)))
}

/// Ends the one that is running, without a result.
#[utoipa::path(
    delete, path = "/api/v1/lens", tag = "calibration",
    responses(
        (status = 200, description = "it ends", body = LensStatus),
        (status = 409, description = "none is running", body = ErrorBody),
    ),
)]
pub async fn cancel(State(api): State<Arc<ApiState>>) -> Result<Json<LensStatus>, ApiError> {
    api.lenses.cancel()?;
    Ok(Json(newest(&api)))
}

/// Looks no further, and solves with the views that there are.
#[utoipa::path(
    put, path = "/api/v1/lens/finished", tag = "calibration",
    responses(
        (status = 200, description = "it solves", body = LensStatus),
        (status = 409, description = "none is running", body = ErrorBody),
    ),
)]
pub async fn finish(State(api): State<Arc<ApiState>>) -> Result<Json<LensStatus>, ApiError> {
    api.lenses.finish()?;
    Ok(Json(newest(&api)))
}

/// The newest picture that was looked at, with what was found in it drawn in.
#[utoipa::path(
    get, path = "/api/v1/lens/picture.jpg", tag = "calibration",
    responses(
        (status = 200, description = "the picture", content_type = "image/jpeg"),
        (status = 503, description = "none was looked at yet", body = ErrorBody),
    ),
)]
pub async fn picture(State(api): State<Arc<ApiState>>) -> Result<Response, ApiError> {
    let Some(shown) = api.lenses.shown() else {
        let why = "no picture was looked at yet: start a calibration of a lens, and wait for its first picture";
        return Err(ApiError::Unavailable(why.to_owned()));
    };
    let ended = |error: String| ApiError::Internal(format!("drawing the picture: {error}"));
    let drawn = tokio::task::spawn_blocking(move || shown.jpeg()).await;
    let jpeg = drawn
        .map_err(|error| ended(error.to_string()))?
        .map_err(|error| ended(error.to_string()))?;
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static("image/jpeg")),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    Ok((headers, jpeg).into_response())
}

/// What was found, as ROS' `camera_info` YAML.
#[utoipa::path(
    get, path = "/api/v1/lens/file", tag = "calibration",
    responses(
        (status = 200, description = "the file", content_type = "application/yaml"),
        (status = 409, description = "no lens was found yet", body = ErrorBody),
    ),
)]
pub async fn file(State(api): State<Arc<ApiState>>) -> Result<Response, ApiError> {
    let found = api.lenses.found()?;
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/yaml"));
    let plain = |it: char| if it.is_ascii_alphanumeric() { it } else { '-' };
    let name: String = found.name.chars().map(plain).collect();
    let disposition = format!("attachment; filename=\"{name}.yaml\"");
    if let Ok(disposition) = HeaderValue::from_str(&disposition) {
        headers.insert(header::CONTENT_DISPOSITION, disposition);
    }
    Ok((headers, found.file()).into_response())
}

/// Keeps what was found beside the server's configuration, and has the camera use it from its next frame on; of a source
/// that is no camera's, the file is only kept.
#[utoipa::path(
    put, path = "/api/v1/lens/applied", tag = "calibration",
    responses(
        (status = 200, description = "`applied` says where it is kept", body = LensStatus),
        (status = 409, description = "no lens was found yet, or clients may not", body = ErrorBody),
    ),
)]
pub async fn apply(State(api): State<Arc<ApiState>>) -> Result<Json<LensStatus>, ApiError> {
    let found = api.lenses.found()?;
    let camera_manager = setup::manager_if_allowed(&api)?;
    let kept = setup::run_blocking(move || match &found.camera {
        Some(camera) => camera_manager.use_lens(camera, &found.file()).map(|(file, _)| file),
        None => camera_manager.save_lens(&found.name, &found.file()),
    })
    .await?;
    api.lenses.applied(&kept);
    Ok(Json(newest(&api)))
}

fn newest(api: &ApiState) -> LensStatus {
    let can_apply = api.camera_manager.is_some();
    LensStatus { can_apply, ..api.lenses.status() }
}

fn lens_run(api: &ApiState, request: &LensRequest) -> Result<LensRun, ApiError> {
    let (picture_source, shown) = picture_source(api, request)?;
    let wrong = |field| move |message: String| ApiError::Invalid { field, message };
    let sides = if request.board.is_empty() { BOARD } else { &request.board };
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
        "plumb_bob" => Some(Model::PlumbBob),
        "rational_polynomial" => Some(Model::Rational),
        "equidistant" => Some(Model::Equidistant),
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
    let most = request.views.unwrap_or(DEFAULT_VIEWS);
    Ok(LensRun { picture_source, name, shown, board, most, model })
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
            if api.source_probe.is_none() {
                return Err(ApiError::FailedPrecondition(
                    "this server is open to a network, and opens no sources for its clients: `setup = true` under [server] \
                     allows it, to everybody who reaches its port; `roundel calibrate lens SOURCE` does it on its machine"
                        .into(),
                ));
            }
            let size = (*width, *height);
            let is_side = |side: &usize| (1..=MAX_SIDE_PX).contains(side);
            if size != (0, 0) && ![width, height].into_iter().all(is_side) {
                let expected = format!("1 to {MAX_SIDE_PX} pixels each, or neither");
                return Err(ApiError::invalid("width", expected, format!("{width} x {height}")));
            }
            let size = (size != (0, 0)).then_some(size);
            Ok(api.lenses.source(source, size)?)
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
            LensError::Address(_) | LensError::Fed => {
                Self::Invalid { field: "source", message: error.to_string() }
            }
            LensError::Thread(_) => Self::Internal(error.to_string()),
            _ => Self::FailedPrecondition(error.to_string()),
        }
    }
}
