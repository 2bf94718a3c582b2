//! Cameras that are added, changed and removed while they are being served, over REST; the same functions answer gRPC.

use std::sync::Arc;

use axum::{
    Json,
    extract::{State, rejection::JsonRejection},
};
use roundel_core::id::CameraId;
use roundel_proto::v1;
use serde_json::{Map, Value};

use super::{
    ApiState,
    error::{ApiError, ErrorBody, SHUTTING_DOWN},
    path::{Segment, text_of},
    queries,
};
use crate::{
    fusion::camera_manager::{CameraManager, CameraManagerError},
    model::config::edit::Message,
};

const EXAMPLE: &str = concat!(
    r#"{"name": "north", "source": "v4l2:/dev/video0", "calibration": "north.yaml", "#,
    r#""pose": {"pose": {"position": {"x": 0, "y": 0, "z": 3}, "orientation": {"x": 1, "y": 0, "z": 0, "w": 0}}}} "#,
    r#"(or "pose": {"unknown": true})"#
);

/// A camera as the configuration says it.
#[utoipa::path(
    get, path = "/api/v1/cameras/{name}/setup", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    responses(
        (status = 200, description = "what is written there, but for user and password", body = v1::CameraSetup),
        (status = 404, description = "names the cameras that there are", body = ErrorBody),
        (status = 409, description = "clients may not", body = ErrorBody),
    ),
)]
pub async fn show(
    State(api): State<Arc<ApiState>>,
    name: Segment,
) -> Result<Json<v1::CameraSetup>, ApiError> {
    written(&api, text_of(name)?).await.map(Json)
}

/// Adds a camera while everything else goes on, and writes it into the configuration.
#[utoipa::path(
    post, path = "/api/v1/cameras", tag = "cameras",
    request_body = v1::CameraSetup,
    responses(
        (status = 200, description = "it is there, and tries to open its source", body = v1::CameraChange),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, the arena is being calibrated, or clients may not", body = ErrorBody),
    ),
)]
pub async fn add(
    State(api): State<Arc<ApiState>>,
    body: Result<Json<v1::CameraSetup>, JsonRejection>,
) -> Result<Json<v1::CameraChange>, ApiError> {
    add_camera(&api, ApiError::body(body, EXAMPLE)?).await.map(Json)
}

/// Changes a camera while everything else goes on, and writes that into the configuration.
///
/// Keys that the body does not name stay as they are; null removes a key. A lens, a pose and a clock uncertainty take
/// effect between two frames; any other change restarts the camera. Files that the configuration names are read again in
/// any case.
#[utoipa::path(
    patch, path = "/api/v1/cameras/{name}", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    request_body = v1::CameraSetup,
    responses(
        (status = 200, description = "it is as wanted", body = v1::CameraChange),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "names the cameras that there are", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, the arena is being calibrated, or clients may not", body = ErrorBody),
    ),
)]
pub async fn change(
    State(api): State<Arc<ApiState>>,
    name: Segment,
    body: Result<Json<Map<String, Value>>, JsonRejection>,
) -> Result<Json<v1::CameraChange>, ApiError> {
    let (name, body) = (text_of(name)?, ApiError::body(body, EXAMPLE)?);
    let (camera, fields) = ApiError::fields(body, EXAMPLE)?;
    let request = v1::ChangeCameraRequest { name, camera: Some(camera), fields };
    change_camera(&api, request).await.map(Json)
}

/// Removes a camera while everything else goes on, and takes it out of the configuration.
#[utoipa::path(
    delete, path = "/api/v1/cameras/{name}", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    responses(
        (status = 200, description = "it is there no more", body = v1::CameraChange),
        (status = 404, description = "names the cameras that there are", body = ErrorBody),
        (status = 409, description = "it is the last one, the configuration cannot be written, the arena is being calibrated, or clients may not", body = ErrorBody),
    ),
)]
pub async fn remove(
    State(api): State<Arc<ApiState>>,
    name: Segment,
) -> Result<Json<v1::CameraChange>, ApiError> {
    remove_camera(&api, text_of(name)?).await.map(Json)
}

pub(super) async fn written(
    api: &Arc<ApiState>,
    name: String,
) -> Result<v1::CameraSetup, ApiError> {
    with_camera_manager(api, Some(&name), move |camera_manager, name| {
        camera_manager.camera_setup(name)
    })
    .await
}

pub(super) async fn add_camera(
    api: &Arc<ApiState>,
    camera: v1::CameraSetup,
) -> Result<v1::CameraChange, ApiError> {
    let name = camera.name.clone();
    let kept = with_camera_manager(api, None, move |camera_manager, _| camera_manager.add(&camera))
        .await?;
    change_of(api, &name, kept)
}

pub(super) async fn change_camera(
    api: &Arc<ApiState>,
    request: v1::ChangeCameraRequest,
) -> Result<v1::CameraChange, ApiError> {
    let v1::ChangeCameraRequest { name, camera, fields } = request;
    let known = v1::CameraSetup::KEYS;
    if let Some(unknown) = fields.iter().find(|field| !known.contains(&field.as_str())) {
        let expected = format!("any of {}", known.join(", "));
        return Err(ApiError::invalid("fields", expected, format!("{unknown:?}")));
    }
    let camera = camera.unwrap_or_default();
    let change = move |camera_manager: &CameraManager, name: &str| {
        let fields: Vec<&str> = fields.iter().map(String::as_str).collect();
        camera_manager.change(name, &camera, &fields)
    };
    let (name, kept) = with_camera_manager(api, Some(&name), change).await?;
    change_of(api, &name, kept)
}

pub(super) async fn remove_camera(
    api: &Arc<ApiState>,
    name: String,
) -> Result<v1::CameraChange, ApiError> {
    let kept =
        with_camera_manager(api, Some(&name), |camera_manager, name| camera_manager.remove(name))
            .await?;
    Ok(v1::CameraChange { camera: None, kept })
}

/// Does something with a camera, which has to be there if one is named.
async fn with_camera_manager<T: Send + 'static>(
    api: &Arc<ApiState>,
    name: Option<&str>,
    act: impl FnOnce(&CameraManager, &str) -> Result<T, CameraManagerError> + Send + 'static,
) -> Result<T, ApiError> {
    let camera_manager = manager_if_allowed(api)?;
    let _: Option<CameraId> = name.map(|name| queries::camera_id(api, name)).transpose()?;
    let name = name.unwrap_or_default().to_owned();
    run_blocking(move || act(&camera_manager, &name)).await
}

/// Whom clients may have change what is configured, if they may.
pub(super) fn manager_if_allowed(api: &ApiState) -> Result<Arc<CameraManager>, ApiError> {
    api.camera_manager.clone().ok_or_else(|| {
        ApiError::FailedPrecondition(
            "this server is open to a network, and lets no client change what is configured: `setup = true` under \
             [server] allows it, to everybody who reaches its port; or edit the configuration and start the server anew"
                .into(),
        )
    })
}

/// Does something on a thread that may wait for files and workers.
pub(super) async fn run_blocking<T: Send + 'static>(
    act: impl FnOnce() -> Result<T, CameraManagerError> + Send + 'static,
) -> Result<T, ApiError> {
    let done = tokio::task::spawn_blocking(act).await;
    let ended =
        |error| ApiError::Internal(format!("the change of a configuration ended badly: {error}"));
    Ok(done.map_err(ended)??)
}

fn change_of(api: &ApiState, name: &str, kept: String) -> Result<v1::CameraChange, ApiError> {
    let camera = queries::camera(api, queries::camera_id(api, name)?)?;
    Ok(v1::CameraChange { camera: Some(camera), kept })
}

impl From<CameraManagerError> for ApiError {
    fn from(error: CameraManagerError) -> Self {
        let message = error.to_string();
        match error {
            CameraManagerError::Invalid { key, .. } => Self::Invalid { field: key, message },
            CameraManagerError::NoCamera(name) => {
                let known = "it was removed meanwhile, or has another name now".to_owned();
                Self::NotFound { what: "camera", name, known }
            }
            CameraManagerError::NoObject(name) => {
                let known = "GET /api/v1/configuration lists those that are configured".to_owned();
                Self::NotFound { what: "object", name, known }
            }
            CameraManagerError::NotSeen(id) => {
                let known = "/api/v1/objects lists those seen within the last minute".to_owned();
                Self::NotFound { what: "object", name: id.to_string(), known }
            }
            CameraManagerError::Problems(_) => Self::Invalid { field: "toml", message },
            CameraManagerError::Stale => Self::Aborted(message),
            CameraManagerError::Ambiguous { .. }
            | CameraManagerError::NeedsRestart(_)
            | CameraManagerError::CodeNotRead(_)
            | CameraManagerError::LastCamera
            | CameraManagerError::Calibrating
            | CameraManagerError::NoFolder
            | CameraManagerError::Lens { .. }
            | CameraManagerError::File(_) => Self::FailedPrecondition(message),
            CameraManagerError::Mask(_) => Self::Invalid { field: "mask", message },
            CameraManagerError::ShuttingDown => Self::Unavailable(SHUTTING_DOWN.into()),
            CameraManagerError::Thread { .. } => Self::ResourceExhausted(message),
            CameraManagerError::Detector(_) => Self::Internal(message),
        }
    }
}
