//! One try of a source, over REST and gRPC: what a camera gives before it is configured.

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
use crate::{api::convert, capture::source_probe::ProbeError};

/// Opens a source for about two seconds, and says what it gives: size, rate, clock, roundels, or why nothing comes.
///
/// Nothing else is disturbed, and nothing is kept. A server that is open to a network allows it only with
/// `setup = true` in its configuration.
#[utoipa::path(
    post, path = "/api/v1/sources/test", tag = "cameras",
    request_body = v1::TestSourceRequest,
    responses(
        (status = 200, description = "what it gives; `error` says why it fails", body = v1::SourceTest),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "another one is being tried, or clients may not", body = ErrorBody),
    ),
)]
pub async fn test(
    State(api): State<Arc<ApiState>>,
    body: Result<Json<v1::TestSourceRequest>, JsonRejection>,
) -> Result<Json<v1::SourceTest>, ApiError> {
    let request = ApiError::body(body, r#"{"source": "http://10.0.0.2:81/stream"}"#)?;
    probe(&api, request).await.map(Json)
}

/// On a thread that may wait for the source.
pub(super) async fn probe(
    api: &ApiState,
    request: v1::TestSourceRequest,
) -> Result<v1::SourceTest, ApiError> {
    let Some(source_probe) = api.source_probe.clone() else {
        return Err(ApiError::FailedPrecondition(
            "this server is open to a network, and tries no sources for its clients: `setup = true` under [server] \
             allows it, to everybody who reaches its port; `roundel cameras --test SOURCE` tries one on its machine"
                .into(),
        ));
    };
    let size = (request.width as usize, request.height as usize);
    let size = (size != (0, 0)).then_some(size);
    let tried =
        tokio::task::spawn_blocking(move || source_probe.probe(&request.source, size)).await;
    let tried = tried
        .map_err(|error| ApiError::Internal(format!("the try of a source ended badly: {error}")))?;
    Ok(convert::trial(&tried?))
}

impl From<ProbeError> for ApiError {
    fn from(error: ProbeError) -> Self {
        let message = error.to_string();
        match error {
            ProbeError::Address(_) | ProbeError::Fed => Self::Invalid { field: "source", message },
            ProbeError::Size(..) => Self::Invalid { field: "width", message },
            ProbeError::Busy => Self::FailedPrecondition(message),
            ProbeError::Internal(_) => Self::Internal(message),
        }
    }
}
