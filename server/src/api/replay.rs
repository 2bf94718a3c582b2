//! A recording that is played, over REST; the same functions answer gRPC.

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
    archive::replay::{Control, Replay, SPEEDS},
};

/// The recording that is played, and how far it is.
#[utoipa::path(
    get, path = "/api/v1/replay", tag = "recording",
    responses(
        (status = 200, description = "how far it is", body = v1::Replay),
        (status = 409, description = "everything here is live", body = ErrorBody),
    ),
)]
pub async fn show(State(api): State<Arc<ApiState>>) -> Result<Json<v1::Replay>, ApiError> {
    newest(&api).map(Json)
}

/// Pauses the recording that is played, goes on, seeks, changes its speed; absent fields stay as they are.
#[utoipa::path(
    patch, path = "/api/v1/replay", tag = "recording",
    request_body = v1::ControlReplayRequest,
    responses(
        (status = 200, description = "it does", body = v1::Replay),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "everything here is live", body = ErrorBody),
    ),
)]
pub async fn control(
    State(api): State<Arc<ApiState>>,
    body: Result<Json<v1::ControlReplayRequest>, JsonRejection>,
) -> Result<Json<v1::Replay>, ApiError> {
    apply_control(&api, &ApiError::body(body, r#"{"paused": false, "position_s": 12.5}"#)?)
        .map(Json)
}

pub(super) fn newest(api: &ApiState) -> Result<v1::Replay, ApiError> {
    Ok(convert::replay(&replay(api)?.status()))
}

pub(super) fn apply_control(
    api: &ApiState,
    request: &v1::ControlReplayRequest,
) -> Result<v1::Replay, ApiError> {
    let replay = replay(api)?;
    let [slowest, fastest] = SPEEDS;
    if let Some(speed) = request.speed.filter(|speed| !(slowest..=fastest).contains(speed)) {
        return Err(ApiError::invalid("speed", format!("{slowest} to {fastest}"), speed));
    }
    let (begin, end) = replay.status().span;
    let length_s = end.seconds_since(begin);
    if let Some(position_s) = request.position_s.filter(|at| !(0.0..=length_s).contains(at)) {
        let expected = format!("0 to {length_s:.3} seconds, the recording's length");
        return Err(ApiError::invalid("position_s", expected, position_s));
    }
    replay.control(&Control {
        paused: request.paused,
        speed: request.speed,
        position_s: request.position_s,
        looping: request.looping,
    });
    newest(api)
}

fn replay(api: &ApiState) -> Result<&Replay, ApiError> {
    api.replay.as_ref().ok_or_else(|| {
        ApiError::FailedPrecondition(
            "everything here is live: `roundel replay FILE` serves a recording".to_owned(),
        )
    })
}
