//! Recordings, over REST; the same functions answer gRPC.

use std::{sync::Arc, time::Duration};

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
    archive::record::{RecordError, Recorder, RecordingOptions, RecordingState as Stage},
};

/// A recording may be told to end after so long: ten years.
const LONGEST_S: f64 = 3.2e8;

/// The recording that is being made, or the last one.
#[utoipa::path(
    get, path = "/api/v1/recording", tag = "recording",
    responses(
        (status = 200, description = "how it is doing", body = v1::Recording),
        (status = 409, description = "this server cannot record", body = ErrorBody),
    ),
)]
pub async fn show(State(api): State<Arc<ApiState>>) -> Result<Json<v1::Recording>, ApiError> {
    newest(&api).map(Json)
}

/// Begins to record, into files on the server's machine.
#[utoipa::path(
    post, path = "/api/v1/recording", tag = "recording",
    request_body = v1::StartRecordingRequest,
    responses(
        (status = 200, description = "it records", body = v1::Recording),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "it records already, or cannot write, or the disk is too full", body = ErrorBody),
    ),
)]
pub async fn start(
    State(api): State<Arc<ApiState>>,
    body: Result<Json<v1::StartRecordingRequest>, JsonRejection>,
) -> Result<Json<v1::Recording>, ApiError> {
    let request = ApiError::body(body, r#"{"name": "trial", "frames_every": 0}"#)?;
    begin(&api, request).await.map(Json)
}

/// Ends the recording; its files are whole when the answer comes.
#[utoipa::path(
    delete, path = "/api/v1/recording", tag = "recording",
    responses(
        (status = 200, description = "it has ended", body = v1::Recording),
        (status = 409, description = "nothing is recorded", body = ErrorBody),
    ),
)]
pub async fn stop(State(api): State<Arc<ApiState>>) -> Result<Json<v1::Recording>, ApiError> {
    end(&api).await.map(Json)
}

/// The files of recordings in the server's folder, the oldest first.
#[utoipa::path(
    get, path = "/api/v1/recordings", tag = "recording",
    responses(
        (status = 200, description = "the files", body = v1::ListRecordingsResponse),
        (status = 409, description = "this server cannot record", body = ErrorBody),
    ),
)]
pub async fn files(
    State(api): State<Arc<ApiState>>,
) -> Result<Json<v1::ListRecordingsResponse>, ApiError> {
    list(&api).await.map(Json)
}

pub(super) fn newest(api: &ApiState) -> Result<v1::Recording, ApiError> {
    Ok(convert::recording(&recorder(api)?.status()))
}

pub(super) async fn begin(
    api: &ApiState,
    request: v1::StartRecordingRequest,
) -> Result<v1::Recording, ApiError> {
    let length = match request.seconds {
        Some(seconds) if !(seconds > 0.0 && seconds <= LONGEST_S) => {
            let expected = format!("seconds above 0, at most {LONGEST_S}");
            return Err(ApiError::invalid("seconds", expected, seconds));
        }
        seconds => seconds.map(Duration::from_secs_f64),
    };
    let wanted =
        RecordingOptions { name: request.name, frames_every: request.frames_every, length };
    on_disk(api, move |recorder| {
        recorder.start(&wanted)?;
        Ok(convert::recording(&recorder.status()))
    })
    .await
}

pub(super) async fn end(api: &ApiState) -> Result<v1::Recording, ApiError> {
    on_disk(api, |recorder| {
        recorder.stop()?;
        Ok(convert::recording(&recorder.status()))
    })
    .await
}

pub(super) async fn list(api: &ApiState) -> Result<v1::ListRecordingsResponse, ApiError> {
    on_disk(api, |recorder| {
        let (files, status) = (recorder.list()?, recorder.status());
        let open = (status.state == Stage::Recording).then_some(status.file.as_str());
        Ok(convert::recordings(&status.folder, &files, open))
    })
    .await
}

fn recorder(api: &ApiState) -> Result<&Arc<Recorder>, ApiError> {
    api.recorder.as_ref().ok_or_else(|| {
        ApiError::FailedPrecondition("this server plays a recording, and makes none".to_owned())
    })
}

/// On a thread that may wait for the disk.
async fn on_disk<T: Send + 'static>(
    api: &ApiState,
    work: impl FnOnce(&Recorder) -> Result<T, RecordError> + Send + 'static,
) -> Result<T, ApiError> {
    let recorder = recorder(api)?.clone();
    let done = tokio::task::spawn_blocking(move || work(&recorder)).await;
    let done =
        done.map_err(|error| ApiError::Internal(format!("the recorder ended badly: {error}")))?;
    Ok(done?)
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
