//! Arguments and results of request handlers.
//!
//! REST and gRPC call the same handlers: axum extracts the arguments from an HTTP request, [`super::grpc`] builds them
//! from a message.

use std::sync::Arc;

use axum::{
    Json,
    extract::{
        FromRequest, FromRequestParts, Path, Request, State,
        rejection::{BytesRejection, JsonRejection},
    },
    http::{HeaderName, HeaderValue, StatusCode, header, request::Parts},
    response::{IntoResponse, Response},
};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::{ApiState, error::ApiError};

pub type Api = State<Arc<ApiState>>;
pub type Answer<T> = Result<Json<T>, ApiError>;

/// Header of responses that change with every request.
pub(super) const NO_STORE: (HeaderName, HeaderValue) =
    (header::CACHE_CONTROL, HeaderValue::from_static("no-store"));

/// A variable segment of the path.
#[derive(Debug)]
pub struct Segment(pub String);

impl<S: Send + Sync> FromRequestParts<S> for Segment {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        match Path::from_request_parts(parts, state).await {
            Ok(Path(text)) => Ok(Self(text)),
            Err(error) => Err(ApiError::invalid("path", "percent-encoded UTF-8", error)),
        }
    }
}

impl Segment {
    pub(super) fn object_id(&self) -> Result<u64, ApiError> {
        let expected = "the number of an object (object_id)";
        self.0.parse().map_err(|_| ApiError::invalid("id", expected, format!("{:?}", self.0)))
    }
}

/// A valid body as JSON, which errors show.
pub trait Example {
    const EXAMPLE: &str;
}

/// A JSON body.
#[derive(Debug)]
pub struct Body<T>(pub T);

impl<T: DeserializeOwned + Example, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, ApiError> {
        json(request, state, T::EXAMPLE).await.map(Self)
    }
}

/// A JSON body whose fields replace those of an existing resource; null removes a value.
#[derive(Debug)]
pub struct Changes<T> {
    pub values: T,
    /// Names of the fields in the body.
    pub fields: Vec<String>,
}

impl<T: DeserializeOwned + Example, S: Send + Sync> FromRequest<S> for Changes<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, ApiError> {
        let mut body: Map<String, Value> = json(request, state, T::EXAMPLE).await?;
        let fields = body.keys().cloned().collect();
        body.retain(|_, value| !value.is_null());
        let values = serde_json::from_value(Value::Object(body));
        let values = values.map_err(|error| wrong_json(T::EXAMPLE, error))?;
        Ok(Self { values, fields })
    }
}

impl<T> Changes<T> {
    /// Rejects a field that is not one of `known`.
    pub(super) fn check(&self, known: &[&str]) -> Result<(), ApiError> {
        match self.fields.iter().find(|field| !known.contains(&field.as_str())) {
            None => Ok(()),
            Some(unknown) => {
                let expected = format!("any of {}", known.join(", "));
                Err(ApiError::invalid("fields", expected, format!("{unknown:?}")))
            }
        }
    }
}

async fn json<T: DeserializeOwned, S: Send + Sync>(
    request: Request,
    state: &S,
    example: &str,
) -> Result<T, ApiError> {
    match Json::from_request(request, state).await {
        Ok(Json(body)) => Ok(body),
        Err(JsonRejection::BytesRejection(error)) => Err(body_error(&error)),
        Err(JsonRejection::MissingJsonContentType(_)) => {
            Err(ApiError::UnsupportedMediaType("application/json"))
        }
        Err(other) => Err(wrong_json(example, other.body_text())),
    }
}

pub(super) fn wrong_json(example: &str, found: impl ToString) -> ApiError {
    ApiError::invalid("body", format!("JSON such as {example}"), found)
}

/// The error of a body that was not read to its end.
pub(super) fn body_error(error: &BytesRejection) -> ApiError {
    match error.status() {
        StatusCode::PAYLOAD_TOO_LARGE => ApiError::TooLarge,
        _ => ApiError::invalid("body", "all of it", error.body_text()),
    }
}

/// Runs blocking work (files, devices, long computations) on a separate thread.
pub(super) async fn blocking<T: Send + 'static, E: Into<ApiError> + Send + 'static>(
    work: impl FnOnce() -> Result<T, E> + Send + 'static,
) -> Result<T, ApiError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done.map_err(E::into),
        Err(error) => Err(ApiError::Internal(format!("the request's work was aborted: {error}"))),
    }
}

/// A response that browsers save as a file of this name.
pub(super) fn download(
    content_type: &'static str,
    name: &str,
    content: impl IntoResponse,
) -> Result<Response, ApiError> {
    let disposition = HeaderValue::from_str(&format!("attachment; filename=\"{name}\""));
    let disposition = disposition.map_err(|error| ApiError::Internal(error.to_string()))?;
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(content_type)),
        (header::CONTENT_DISPOSITION, disposition),
    ];
    Ok((headers, content).into_response())
}
