//! Control of a replay.

use axum::{Json, extract::State};
use roundel_proto::v1;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, Body, Example},
};
use crate::archive::replay::{Replay, ReplayFrom, SPEEDS};

impl Example for v1::ControlReplayRequest {
    const EXAMPLE: &str = r#"{"paused": false, "position_s": 12.5}"#;
}

/// The recording being played, and its position.
#[utoipa::path(
    get, path = "/api/v1/replay", tag = "recording",
    responses(
        (status = 200, description = "its state", body = v1::Replay),
        (status = 409, description = "this server plays no recording", body = ErrorBody),
    ),
)]
pub async fn show(State(api): Api) -> Answer<v1::Replay> {
    Ok(Json(message(replay(&api)?)))
}

/// Pauses or resumes the replay, seeks, or changes its speed. Absent fields stay as they are.
#[utoipa::path(
    patch, path = "/api/v1/replay", tag = "recording",
    request_body = v1::ControlReplayRequest,
    responses(
        (status = 200, description = "its new state", body = v1::Replay),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "this server plays no recording", body = ErrorBody),
    ),
)]
pub async fn control(
    State(api): Api,
    Body(request): Body<v1::ControlReplayRequest>,
) -> Answer<v1::Replay> {
    let replay = replay(&api)?;
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
    replay.control(&request);
    Ok(Json(message(replay)))
}

fn replay(api: &ApiState) -> Result<&Replay, ApiError> {
    api.replay.as_ref().ok_or_else(|| {
        ApiError::FailedPrecondition(
            "this server is live: `roundel replay FILE` serves a recording".to_owned(),
        )
    })
}

fn message(replay: &Replay) -> v1::Replay {
    let status = replay.status();
    let (begin, end) = status.span;
    let from = match status.from {
        ReplayFrom::Snapshots => v1::ReplayFrom::Snapshots,
        ReplayFrom::Observations => v1::ReplayFrom::Observations,
        ReplayFrom::Frames => v1::ReplayFrom::Frames,
    };
    v1::Replay {
        file: status.file.display().to_string(),
        from: from.into(),
        paused: status.paused,
        speed: status.speed,
        looping: status.looping,
        position_s: status.position.seconds_since(begin),
        duration_s: end.seconds_since(begin),
        begin_time_ns: begin.as_ns(),
        position_time_ns: status.position.as_ns(),
        ended: status.ended,
        damage: status.damage.join("; "),
    }
}
