//! Recordings.

use std::{sync::Arc, time::Duration};

use axum::{Json, extract::State};
use roundel_proto::v1;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, Body, Example, blocking},
};
use crate::archive::record::{RecordError, Recorder, RecordingOptions, folder::RecordingFile};

/// Longest duration of a recording: ten years.
const MAX_DURATION_S: f64 = 3.2e8;

impl Example for v1::StartRecordingRequest {
    const EXAMPLE: &str = r#"{"name": "trial", "frames_every": 0}"#;
}

/// The running recording, or the last one.
#[utoipa::path(
    get, path = "/api/v1/recording", tag = "recording",
    responses(
        (status = 200, description = "its status", body = v1::Recording),
        (status = 409, description = "this server cannot record", body = ErrorBody),
    ),
)]
pub async fn show(State(api): Api) -> Answer<v1::Recording> {
    Ok(Json(recorder(&api)?.status()))
}

/// Starts a recording, into files on the server's machine.
#[utoipa::path(
    post, path = "/api/v1/recording", tag = "recording",
    request_body = v1::StartRecordingRequest,
    responses(
        (status = 200, description = "it records", body = v1::Recording),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "a recording is running, the folder cannot be written, or the disk is too full", body = ErrorBody),
    ),
)]
pub async fn start(
    State(api): Api,
    Body(request): Body<v1::StartRecordingRequest>,
) -> Answer<v1::Recording> {
    let v1::StartRecordingRequest { name, frames_every, seconds } = request;
    if let Some(seconds) = seconds.filter(|it| !(*it > 0.0 && *it <= MAX_DURATION_S)) {
        let expected = format!("seconds above 0, at most {MAX_DURATION_S}");
        return Err(ApiError::invalid("seconds", expected, seconds));
    }
    let length = seconds.map(Duration::from_secs_f64);
    let options = RecordingOptions { name, frames_every, length, by_client: true };
    on_disk(&api, move |recorder| {
        recorder.start(&options)?;
        Ok(recorder.status())
    })
    .await
}

/// Ends the recording. Its files are complete when the response arrives.
#[utoipa::path(
    delete, path = "/api/v1/recording", tag = "recording",
    responses(
        (status = 200, description = "it has ended", body = v1::Recording),
        (status = 409, description = "no recording is running", body = ErrorBody),
    ),
)]
pub async fn stop(State(api): Api) -> Answer<v1::Recording> {
    on_disk(&api, |recorder| {
        recorder.stop()?;
        Ok(recorder.status())
    })
    .await
}

/// The files of recordings in the server's folder, the oldest first.
#[utoipa::path(
    get, path = "/api/v1/recordings", tag = "recording",
    responses(
        (status = 200, description = "the files", body = v1::ListRecordingsResponse),
        (status = 409, description = "this server cannot record", body = ErrorBody),
    ),
)]
pub async fn files(State(api): Api) -> Answer<v1::ListRecordingsResponse> {
    on_disk(&api, |recorder| {
        let (files, status) = (recorder.list()?, recorder.status());
        let is_recording = status.state() == v1::RecordingState::Recording;
        let file = |file: RecordingFile| v1::RecordingFile {
            open: is_recording && file.name == status.file,
            name: file.name,
            bytes: file.bytes,
            started_time_ns: file.started.as_ns(),
        };
        let files = files.into_iter().map(file).collect();
        Ok(v1::ListRecordingsResponse { files, folder: status.folder.clone() })
    })
    .await
}

fn recorder(api: &ApiState) -> Result<&Arc<Recorder>, ApiError> {
    api.recorder.as_ref().ok_or_else(|| {
        ApiError::FailedPrecondition("this server replays a recording and cannot record".to_owned())
    })
}

async fn on_disk<T: Send + 'static>(
    api: &ApiState,
    work: impl FnOnce(&Recorder) -> Result<T, RecordError> + Send + 'static,
) -> Answer<T> {
    let recorder = recorder(api)?.clone();
    blocking(move || work(&recorder)).await.map(Json)
}

impl From<RecordError> for ApiError {
    fn from(error: RecordError) -> Self {
        match error {
            RecordError::Name(message) => Self::Invalid { field: "name", message },
            RecordError::Thread(_) => Self::Internal(error.to_string()),
            _ => Self::FailedPrecondition(error.to_string()),
        }
    }
}
