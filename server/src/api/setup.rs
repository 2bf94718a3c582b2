//! Adds, changes and removes cameras of the running system.

use std::sync::Arc;

use axum::{Json, extract::State};
use roundel_proto::v1;

use super::{
    ApiState,
    error::{ApiError, ErrorBody, SHUTTING_DOWN},
    handler::{Answer, Api, Body, Changes, Example, Segment, blocking},
    queries,
};
use crate::{
    fusion::camera_manager::{CameraManager, CameraManagerError},
    model::config::edit::Message,
};

impl Example for v1::CameraSetup {
    const EXAMPLE: &str = concat!(
        r#"{"name": "north", "source": "v4l2:/dev/video0", "calibration": "north.yaml", "#,
        r#""pose": {"pose": {"position": {"x": 0, "y": 0, "z": 3}, "orientation": {"x": 1, "y": 0, "z": 0, "w": 0}}}} "#,
        r#"(or "pose": {"unknown": true})"#
    );
}

/// A camera's configuration.
#[utoipa::path(
    get, path = "/api/v1/cameras/{name}/setup", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    responses(
        (status = 200, description = "the configuration, without user and password", body = v1::CameraSetup),
        (status = 404, description = "lists the existing cameras", body = ErrorBody),
        (status = 409, description = "clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn show(State(api): Api, Segment(name): Segment) -> Answer<v1::CameraSetup> {
    let manager = manager_of(&api, &name)?;
    blocking(move || manager.camera_setup(&name)).await.map(Json)
}

/// Adds a camera to the running system and the configuration file.
#[utoipa::path(
    post, path = "/api/v1/cameras", tag = "cameras",
    request_body = v1::CameraSetup,
    responses(
        (status = 200, description = "the camera was added and opens its source", body = v1::CameraChange),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, the arena is being calibrated, or clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn add(State(api): Api, Body(camera): Body<v1::CameraSetup>) -> Answer<v1::CameraChange> {
    let (manager, name) = (manager_if_allowed(&api)?, camera.name.clone());
    let kept = blocking(move || manager.add(&camera)).await?;
    Ok(Json(v1::CameraChange { camera: Some(queries::camera(&api, &name)?), kept }))
}

/// Changes a camera of the running system and the configuration file.
///
/// Keys that the body does not name keep their values; null removes a key. A lens, a pose and a clock uncertainty take
/// effect between two frames; any other change restarts the camera. Files that the configuration names are always read
/// again.
#[utoipa::path(
    patch, path = "/api/v1/cameras/{name}", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    request_body = v1::CameraSetup,
    responses(
        (status = 200, description = "the camera was changed", body = v1::CameraChange),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "lists the existing cameras", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, the arena is being calibrated, or clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn change(
    State(api): Api,
    Segment(name): Segment,
    changes: Changes<v1::CameraSetup>,
) -> Answer<v1::CameraChange> {
    changes.check(v1::CameraSetup::KEYS)?;
    let manager = manager_of(&api, &name)?;
    let change = move || {
        let fields: Vec<&str> = changes.fields.iter().map(String::as_str).collect();
        manager.change(&name, &changes.values, &fields)
    };
    let (name, kept) = blocking(change).await?;
    Ok(Json(v1::CameraChange { camera: Some(queries::camera(&api, &name)?), kept }))
}

/// Removes a camera from the running system and the configuration file.
#[utoipa::path(
    delete, path = "/api/v1/cameras/{name}", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    responses(
        (status = 200, description = "the camera was removed", body = v1::CameraChange),
        (status = 404, description = "lists the existing cameras", body = ErrorBody),
        (status = 409, description = "it is the last one, the configuration cannot be written, the arena is being calibrated, or clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn remove(State(api): Api, Segment(name): Segment) -> Answer<v1::CameraChange> {
    let manager = manager_of(&api, &name)?;
    let kept = blocking(move || manager.remove(&name)).await?;
    Ok(Json(v1::CameraChange { camera: None, kept }))
}

/// The camera manager for a request about an existing camera.
fn manager_of(api: &ApiState, name: &str) -> Result<Arc<CameraManager>, ApiError> {
    let manager = manager_if_allowed(api)?;
    queries::camera_id(api, name)?;
    Ok(manager)
}

/// The camera manager, or an error where clients must not change the configuration.
pub(super) fn manager_if_allowed(api: &ApiState) -> Result<Arc<CameraManager>, ApiError> {
    api.camera_manager.clone().ok_or_else(|| {
        ApiError::FailedPrecondition(
            "this server is open to a network, so clients must not change its configuration: `setup = true` under \
             [server] allows it, for every client that reaches its port; or edit the configuration and restart the server"
                .into(),
        )
    })
}

impl From<CameraManagerError> for ApiError {
    fn from(error: CameraManagerError) -> Self {
        let message = error.to_string();
        match error {
            CameraManagerError::Invalid { key, .. } => Self::Invalid { field: key, message },
            CameraManagerError::NoCamera(name) => {
                let known = "it was removed or renamed meanwhile".to_owned();
                Self::NotFound { what: "camera", name, known }
            }
            CameraManagerError::NoObject(name) => {
                let known = "GET /api/v1/configuration lists the configured ones".to_owned();
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
            CameraManagerError::Busy => Self::Unavailable(message),
            CameraManagerError::ShuttingDown => Self::Unavailable(SHUTTING_DOWN.into()),
            CameraManagerError::Thread { .. } => Self::ResourceExhausted(message),
            CameraManagerError::Detector(_) => Self::Internal(message),
        }
    }
}
