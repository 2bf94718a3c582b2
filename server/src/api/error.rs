//! Errors of requests, and their codes in JSON, gRPC and HTTP.

use std::time::Duration;

use axum::{
    Json,
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use roundel_proto::v1;
use serde::Serialize;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};
use utoipa::ToSchema;

use super::MAX_REQUEST_BYTES;

/// Message of the error that ends streams and connections on shutdown.
pub const SHUTTING_DOWN: &str = "server is shutting down";

/// Error domain in the details of gRPC errors.
const DOMAIN: &str = "roundel.v1";
/// When clients may retry after a temporary error, seconds.
const RETRY_AFTER_S: u16 = 1;

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ApiError {
    #[error("{field}: expected {expected}, found {found}")]
    InvalidArgument {
        /// Name of the field or query parameter, as the client wrote it.
        field: String,
        expected: String,
        found: String,
    },
    /// An invalid field or query parameter, described by a sentence.
    #[error("{field}: {message}")]
    Invalid { field: &'static str, message: String },
    #[error("no {what} {name:?}; {known}")]
    NotFound {
        /// Kind of the missing resource.
        what: &'static str,
        name: String,
        /// Existing names, or where to look them up.
        known: String,
    },
    /// The state of the server does not permit the request.
    #[error("{0}")]
    FailedPrecondition(String),
    /// Another client's request takes precedence.
    #[error("{0}")]
    Aborted(String),
    #[error("{0}")]
    PermissionDenied(String),
    /// Credentials are missing, wrong or expired.
    #[error("{0}")]
    Unauthenticated(String),
    #[error("this server needs TLS: connect to https:// in place of http://")]
    TlsRequired,
    /// The request names another host.
    #[error("{0}")]
    Misdirected(String),
    #[error("this path does not support this method: /openapi.json lists those it does")]
    MethodNotAllowed,
    /// A request for the WebSocket's path that is no handshake.
    #[error("expected a WebSocket handshake (open it as ws://HOST:PORT/api/v1/stream): {0}")]
    UpgradeRequired(String),
    /// Temporary; clients may retry.
    #[error("{0}")]
    Unavailable(String),
    /// A limit of the server is reached.
    #[error("{0}")]
    ResourceExhausted(String),
    /// The content type is not one that browsers ask for permission to send.
    #[error("content-type: expected {0}, found another one or none")]
    UnsupportedMediaType(&'static str),
    #[error("expected a request of at most {MAX_REQUEST_BYTES} bytes, found more")]
    TooLarge,
    /// A fault of the server.
    #[error("{0}")]
    Internal(String),
}

impl ApiError {
    pub fn invalid(
        field: impl Into<String>,
        expected: impl Into<String>,
        found: impl ToString,
    ) -> Self {
        Self::InvalidArgument {
            field: field.into(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }

    /// Codes in JSON, gRPC and HTTP.
    pub fn codes(&self) -> (&'static str, Code, StatusCode) {
        match self {
            Self::InvalidArgument { .. } | Self::Invalid { .. } => {
                ("invalid_argument", Code::InvalidArgument, StatusCode::BAD_REQUEST)
            }
            Self::NotFound { .. } => ("not_found", Code::NotFound, StatusCode::NOT_FOUND),
            Self::FailedPrecondition(_) => {
                ("failed_precondition", Code::FailedPrecondition, StatusCode::CONFLICT)
            }
            Self::Aborted(_) => ("aborted", Code::Aborted, StatusCode::CONFLICT),
            Self::PermissionDenied(_) => {
                ("permission_denied", Code::PermissionDenied, StatusCode::FORBIDDEN)
            }
            Self::Unauthenticated(_) => {
                ("unauthenticated", Code::Unauthenticated, StatusCode::UNAUTHORIZED)
            }
            Self::TlsRequired => ("tls_required", Code::PermissionDenied, StatusCode::FORBIDDEN),
            Self::Misdirected(_) => {
                ("misdirected", Code::PermissionDenied, StatusCode::MISDIRECTED_REQUEST)
            }
            Self::MethodNotAllowed => {
                ("method_not_allowed", Code::Unimplemented, StatusCode::METHOD_NOT_ALLOWED)
            }
            Self::UpgradeRequired(_) => {
                ("upgrade_required", Code::FailedPrecondition, StatusCode::UPGRADE_REQUIRED)
            }
            Self::Unavailable(_) => {
                ("unavailable", Code::Unavailable, StatusCode::SERVICE_UNAVAILABLE)
            }
            Self::ResourceExhausted(_) => {
                ("resource_exhausted", Code::ResourceExhausted, StatusCode::SERVICE_UNAVAILABLE)
            }
            Self::UnsupportedMediaType(_) => (
                "unsupported_media_type",
                Code::InvalidArgument,
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
            ),
            Self::TooLarge => ("too_large", Code::OutOfRange, StatusCode::PAYLOAD_TOO_LARGE),
            Self::Internal(_) => ("internal", Code::Internal, StatusCode::INTERNAL_SERVER_ERROR),
        }
    }
}

impl From<ApiError> for Status {
    fn from(error: ApiError) -> Self {
        let (reason, code, _) = error.codes();
        let (message, info) = (error.to_string(), [("code".to_owned(), reason.to_owned())]);
        let mut details = ErrorDetails::with_error_info(reason.to_uppercase(), DOMAIN, info);
        match error {
            ApiError::InvalidArgument { field, expected, found } => {
                let violation = format!("expected {expected}, found {found}");
                details.add_bad_request_violation(field, violation);
            }
            ApiError::Invalid { field, message } => {
                details.add_bad_request_violation(field, message);
            }
            ApiError::NotFound { what, name, known } => {
                details.set_resource_info(what, name, "", known);
            }
            ApiError::FailedPrecondition(why) => {
                details.add_precondition_failure_violation(reason, "", why);
            }
            ApiError::Unavailable(_) | ApiError::ResourceExhausted(_) => {
                details.set_retry_info(Some(Duration::from_secs(RETRY_AFTER_S.into())));
            }
            _ => {}
        }
        Status::with_error_details(code, message, details)
    }
}

impl From<ApiError> for v1::StreamError {
    fn from(error: ApiError) -> Self {
        let (code, _, _) = error.codes();
        Self { code: code.to_owned(), message: error.to_string() }
    }
}

/// Body of every error response.
#[derive(Debug, Serialize, ToSchema)]
pub struct ErrorBody {
    pub error: ErrorDetail,
}

#[derive(Debug, Serialize, ToSchema)]
pub struct ErrorDetail {
    /// A code for programs, such as `invalid_argument` or `not_found`.
    pub code: &'static str,
    /// A sentence for people: the expected value, the one found, and the field.
    pub message: String,
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let (code, _, status) = self.codes();
        let body = ErrorBody { error: ErrorDetail { code, message: self.to_string() } };
        let mut response = (status, Json(body)).into_response();
        if status == StatusCode::UNAUTHORIZED {
            let scheme = HeaderValue::from_static("Bearer");
            response.headers_mut().insert(header::WWW_AUTHENTICATE, scheme);
        }
        if status == StatusCode::SERVICE_UNAVAILABLE {
            let after = HeaderValue::from(RETRY_AFTER_S);
            response.headers_mut().insert(header::RETRY_AFTER, after);
        }
        response
    }
}
