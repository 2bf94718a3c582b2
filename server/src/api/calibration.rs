//! Calibration of the arena, over REST; the same functions answer gRPC.

use std::sync::Arc;

use axum::{
    Json,
    extract::{State, rejection::JsonRejection},
};
use roundel_proto::v1;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
};
use crate::{
    api::convert,
    fusion::calibration::{
        ApplyPolicy, CalibrationError, CalibrationRequest, DEFAULT_DURATION_S, DURATION_RANGE_S,
    },
};

/// The newest calibration of the arena: how far it is, and what came out.
#[utoipa::path(
    get, path = "/api/v1/calibration", tag = "calibration",
    responses((status = 200, description = "the newest one", body = v1::Calibration)),
)]
pub async fn show(State(api): State<Arc<ApiState>>) -> Json<v1::Calibration> {
    Json(newest(&api))
}

/// Begins to calibrate the arena. Let robots drive about while it records; tracks go on meanwhile.
#[utoipa::path(
    post, path = "/api/v1/calibration", tag = "calibration",
    request_body = v1::StartCalibrationRequest,
    responses(
        (status = 200, description = "it records", body = v1::Calibration),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "one is running, or references are missing", body = ErrorBody),
    ),
)]
pub async fn start(
    State(api): State<Arc<ApiState>>,
    body: Result<Json<v1::StartCalibrationRequest>, JsonRejection>,
) -> Result<Json<v1::Calibration>, ApiError> {
    let request = ApiError::body(body, r#"{"seconds": 60}"#)?;
    begin(&api, &request).map(Json)
}

/// Ends the calibration that is running, without a result.
#[utoipa::path(
    delete, path = "/api/v1/calibration", tag = "calibration",
    responses(
        (status = 200, description = "it ends", body = v1::Calibration),
        (status = 409, description = "none is running", body = ErrorBody),
    ),
)]
pub async fn cancel(State(api): State<Arc<ApiState>>) -> Result<Json<v1::Calibration>, ApiError> {
    api.calibrator.cancel()?;
    Ok(Json(newest(&api)))
}

/// Has the cameras take over what the newest calibration found.
#[utoipa::path(
    put, path = "/api/v1/calibration/applied", tag = "calibration",
    responses(
        (status = 200, description = "they do from their next frames on", body = v1::Calibration),
        (status = 409, description = "it found nothing", body = ErrorBody),
    ),
)]
pub async fn apply(State(api): State<Arc<ApiState>>) -> Result<Json<v1::Calibration>, ApiError> {
    take_over(&api).await.map(Json)
}

pub(super) fn newest(api: &ApiState) -> v1::Calibration {
    let status = api.calibrator.status().borrow().clone();
    convert::calibration(&api.hub.installation(), &status, api.calibrator.version())
}

pub(super) fn begin(
    api: &ApiState,
    request: &v1::StartCalibrationRequest,
) -> Result<v1::Calibration, ApiError> {
    let apply = match v1::CalibrationApply::try_from(request.apply) {
        Ok(v1::CalibrationApply::Unspecified | v1::CalibrationApply::IfSound) => {
            ApplyPolicy::IfSound
        }
        Ok(v1::CalibrationApply::Always) => ApplyPolicy::Always,
        Ok(v1::CalibrationApply::Never) => ApplyPolicy::Never,
        Err(_) => {
            let expected = "a value of CalibrationApply";
            return Err(ApiError::invalid("apply", expected, request.apply));
        }
    };
    api.calibrator.start(CalibrationRequest {
        seconds: request.seconds.unwrap_or(DEFAULT_DURATION_S),
        refine_lenses: request.refine_lenses,
        apply,
    })?;
    Ok(newest(api))
}

/// On a thread that may wait for the disk.
pub(super) async fn take_over(api: &Arc<ApiState>) -> Result<v1::Calibration, ApiError> {
    let calibrator = api.calibrator.clone();
    let applied = tokio::task::spawn_blocking(move || calibrator.apply()).await;
    applied
        .map_err(|error| ApiError::Internal(format!("the take-over ended badly: {error}")))??;
    Ok(newest(api))
}

impl From<CalibrationError> for ApiError {
    fn from(error: CalibrationError) -> Self {
        match error {
            CalibrationError::Seconds(found) => {
                let [least, most] = DURATION_RANGE_S;
                Self::invalid("seconds", format!("{least} to {most} seconds"), found)
            }
            CalibrationError::Thread(_) => Self::Internal(error.to_string()),
            _ => Self::FailedPrecondition(error.to_string()),
        }
    }
}
