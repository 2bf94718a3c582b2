//! Probes a source before a camera is configured with it.

use axum::{Json, extract::State};
use roundel_proto::v1;

use super::{
    convert::{capture_clock, pixels},
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, Body, Example, blocking},
};
use crate::capture::source_probe::{ProbeError, ProbeReport};

impl Example for v1::TestSourceRequest {
    const EXAMPLE: &str = r#"{"source": "http://10.0.0.2:81/stream"}"#;
}

/// Opens a source for about two seconds and reports what it delivers: size, rate, clock, roundels, or why it fails.
///
/// Running cameras are not affected, and nothing is stored. A server that is open to a network allows this only with
/// `setup = true` in its configuration.
#[utoipa::path(
    post, path = "/api/v1/sources/test", tag = "cameras",
    request_body = v1::TestSourceRequest,
    responses(
        (status = 200, description = "what it delivers; `error` says why it fails", body = v1::SourceTest),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "another source is being probed, or clients must not open sources", body = ErrorBody),
    ),
)]
pub async fn test(
    State(api): Api,
    Body(request): Body<v1::TestSourceRequest>,
) -> Answer<v1::SourceTest> {
    let (Some(source_probe), Some(manager)) =
        (api.source_probe.clone(), api.camera_manager.clone())
    else {
        return Err(ApiError::FailedPrecondition(
            "this server is open to a network, so clients must not open sources: `setup = true` under [server] allows \
             it, for every client that reaches its port; `roundel cameras --test SOURCE` opens one on its machine"
                .into(),
        ));
    };
    let size = (request.width as usize, request.height as usize);
    let size = (size != (0, 0)).then_some(size);
    let probe =
        move || source_probe.probe(&request.source, size, |address| manager.admit_source(address));
    let report = blocking(probe).await?;
    Ok(Json(message(&report)))
}

impl From<ProbeError> for ApiError {
    fn from(error: ProbeError) -> Self {
        let message = error.to_string();
        match error {
            ProbeError::Address(_) | ProbeError::Rule(_) | ProbeError::Fed => {
                Self::Invalid { field: "source", message }
            }
            ProbeError::Size(..) => Self::Invalid { field: "width", message },
            ProbeError::Busy => Self::FailedPrecondition(message),
            ProbeError::Internal(_) => Self::Internal(message),
        }
    }
}

pub fn message(report: &ProbeReport) -> v1::SourceTest {
    v1::SourceTest {
        error: report.error.clone(),
        width: pixels(report.width),
        height: pixels(report.height),
        frames: report.frames,
        broken: report.broken,
        rate_hz: report.rate_hz,
        promised_rate_hz: report.promised_hz,
        capture_clock: report.capture_clock.map(capture_clock),
        roundels: pixels(report.roundels),
        decode_ms: report.decode_ms,
        detect_ms: report.detect_ms,
    }
}
