//! What can be wrong with a request, and the one table that says how gRPC and HTTP put it.

use axum::{
    Json,
    extract::rejection::{BytesRejection, JsonRejection},
    http::StatusCode,
    response::{IntoResponse, Response},
};
use roundel_proto::v1;
use serde::{Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};
use utoipa::ToSchema;

use super::MAX_REQUEST_BYTES;

/// Said to every stream and connection that the end of the server cuts off.
pub const SHUTTING_DOWN: &str = "server is shutting down";

/// Whose reasons the details of gRPC's errors name.
const DOMAIN: &str = "roundel.v1";

/// Why a request is not answered as asked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ApiError {
    /// A field or query parameter does not hold what it should.
    #[error("{field}: expected {expected}, found {found}")]
    InvalidArgument {
        /// Name of the field or query parameter, as the client wrote it.
        field: String,
        /// What it may be.
        expected: String,
        found: String,
    },
    /// The same, in a sentence of its own.
    #[error("{field}: {message}")]
    Invalid {
        field: &'static str,
        /// What is wrong, and what to do.
        message: String,
    },
    /// No such thing here.
    #[error("no {what} {name:?}; {known}")]
    NotFound {
        /// What kind of thing was looked for.
        what: &'static str,
        name: String,
        /// What there is, or where to look.
        known: String,
    },
    /// Not as things are now.
    #[error("{0}")]
    FailedPrecondition(String),
    /// Somebody has taken this one's place.
    #[error("{0}")]
    Aborted(String),
    /// Not for whoever asks.
    #[error("{0}")]
    PermissionDenied(String),
    /// The path exists, but not with this method.
    #[error("this path does not answer to this method: /openapi.json says to which it does")]
    MethodNotAllowed,
    /// The WebSocket's path was asked for without an upgrade.
    #[error("expected a WebSocket handshake (open it as ws://HOST:PORT/api/v1/stream): {0}")]
    UpgradeRequired(String),
    /// Nothing to give yet, or any more; worth another try.
    #[error("{0}")]
    Unavailable(String),
    /// A limit of the server is reached.
    #[error("{0}")]
    ResourceExhausted(String),
    /// A request is larger than the server takes.
    #[error("expected a request of at most {MAX_REQUEST_BYTES} bytes, and this one has more")]
    TooLarge,
    /// A fault of the server's own.
    #[error("{0}")]
    Internal(String),
}

impl ApiError {
    /// A field or parameter that holds something else than expected.
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

    /// What a request's body holds; where it does not, what it may be, such as `example`.
    pub(super) fn body<T>(
        body: Result<Json<T>, JsonRejection>,
        example: &str,
    ) -> Result<T, ApiError> {
        let refused = |error| match error {
            JsonRejection::BytesRejection(error) => Self::body_error(&error),
            other => Self::invalid("body", format!("JSON such as {example}"), other.body_text()),
        };
        body.map(|Json(body)| body).map_err(refused)
    }

    /// Why a body did not come whole.
    pub(super) fn body_error(error: &BytesRejection) -> Self {
        match error.status() {
            StatusCode::PAYLOAD_TOO_LARGE => Self::TooLarge,
            _ => Self::invalid("body", "all of it", error.body_text()),
        }
    }

    /// What a body that changes some fields holds, and which these are; null stands for none.
    pub(super) fn fields<T: DeserializeOwned>(
        mut body: Map<String, Value>,
        example: &str,
    ) -> Result<(T, Vec<String>), ApiError> {
        let fields = body.keys().cloned().collect();
        body.retain(|_, value| !value.is_null());
        let wrong = |error| Self::invalid("body", format!("JSON such as {example}"), error);
        Ok((serde_json::from_value(Value::Object(body)).map_err(wrong)?, fields))
    }

    /// The table: what each error is called in JSON, in gRPC and in HTTP.
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

/// The body of every response that is no success.
#[derive(Debug, Serialize, ToSchema)]
pub struct ErrorBody {
    /// What went wrong.
    pub error: ErrorDetail,
}

/// What went wrong.
#[derive(Debug, Serialize, ToSchema)]
pub struct ErrorDetail {
    /// A word for programs, such as `invalid_argument` or `not_found`.
    pub code: &'static str,
    /// A sentence for people: what was expected, what was found, and where.
    pub message: String,
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let (code, _, status) = self.codes();
        let body = ErrorBody { error: ErrorDetail { code, message: self.to_string() } };
        (status, Json(body)).into_response()
    }
}
