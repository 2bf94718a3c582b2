//! Errors of calls and streams.

use std::time::Duration;

use tonic::{Code, Status, TimeoutExpired};
use tonic_types::StatusExt;

use crate::{Link, tls::TlsFailure};

/// Why a call or a stream failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The address is malformed.
    #[error(
        "{address:?} is not a server address: {reason}; expected http://HOST:PORT or https://HOST:PORT, such as http://127.0.0.1:7670"
    )]
    InvalidAddress {
        /// The address as given.
        address: String,
        /// The cause.
        reason: String,
    },
    /// An option of the connection is wrong, or its file cannot be read.
    #[error("invalid option `{option}`: {reason}")]
    InvalidOption {
        /// The method of [`ConnectOptions`](crate::ConnectOptions).
        option: &'static str,
        /// The cause.
        reason: String,
    },
    /// The server does not answer.
    #[error(
        "no answer from {address}: {reason}; check the address and that the server is running (`roundel serve` and `roundel demo` print it)"
    )]
    Unreachable {
        /// The address as given.
        address: String,
        /// The error of the network.
        reason: String,
    },
    /// The address answers, but not as a Roundel server.
    #[error("{address} answers, but is not a Roundel server: {reason}")]
    NotRoundel {
        /// The address as given.
        address: String,
        /// Its response.
        reason: String,
    },
    /// The server's certificate is not the pinned one. It was replaced, or this is another server.
    #[error(
        "{address} has a certificate with the SHA-256 fingerprint {found}, expected {expected}; if the server's certificate was replaced, use the fingerprint that the server prints at start"
    )]
    WrongFingerprint {
        /// The address as given.
        address: String,
        /// The pinned fingerprint.
        expected: String,
        /// That of the server.
        found: String,
    },
    /// The server's certificate does not verify.
    #[error(
        "the certificate of {address} is not trusted: {reason}; name the file of its authority (`ca`), or its `fingerprint`"
    )]
    Untrusted {
        /// The address as given.
        address: String,
        /// The cause.
        reason: String,
    },
    /// The server requires a valid token or client certificate.
    #[error("the server requires a valid token or client certificate: {message}")]
    Unauthenticated {
        /// Message of the server.
        message: String,
    },
    /// The role of this client does not include the call.
    #[error("the server does not permit this: {message}")]
    PermissionDenied {
        /// Message of the server.
        message: String,
    },
    /// The server rejected the request; a retry will not help.
    #[error("the server rejected the request: {message}")]
    Refused {
        /// `InvalidArgument`, `NotFound`, `OutOfRange` or `FailedPrecondition`.
        code: Code,
        /// The invalid field, as named in the `.proto` files; `None` for other causes.
        field: Option<String>,
        /// The field or resource, with the expected and the found value.
        message: String,
    },
    /// Another client made a change after this one read the state that the request is based on. Read it again.
    #[error("conflict with another change: {message}")]
    Conflict {
        /// The change.
        message: String,
    },
    /// No response arrived within the timeout (see [`crate::Client::with_timeout`]). The server may or may not have executed
    /// the call.
    #[error("no answer from {address} in time: {message}")]
    TimedOut {
        /// The address as given.
        address: String,
        /// The side that gave up, and its timeout.
        message: String,
    },
    /// No snapshot is recent enough. A control loop should stop.
    #[error("no snapshot within the last {longest:?}: {}; {link}", describe_age(.age))]
    Stale {
        /// The maximum age.
        longest: Duration,
        /// Time since the newest snapshot arrived; `None` before the first.
        age: Option<Duration>,
        /// State of the connection.
        link: Box<Link>,
    },
    /// The server cannot answer now; a later retry may succeed.
    #[error("the server cannot answer now ({code:?}): {message}")]
    Server {
        /// Status code of gRPC.
        code: Code,
        /// Message of the server.
        message: String,
    },
}

impl Error {
    /// Whether a later retry can succeed.
    pub fn is_temporary(&self) -> bool {
        match self {
            Self::Unreachable { .. } | Self::TimedOut { .. } => true,
            Self::Stale { .. } | Self::Server { .. } => true,
            Self::InvalidAddress { .. } | Self::InvalidOption { .. } => false,
            Self::NotRoundel { .. } => false,
            Self::WrongFingerprint { .. } | Self::Untrusted { .. } => false,
            Self::Unauthenticated { .. } | Self::PermissionDenied { .. } => false,
            Self::Refused { .. } | Self::Conflict { .. } => false,
        }
    }

    /// Converts the status of a failed call.
    pub(crate) fn from_status(address: &str, status: &Status) -> Self {
        let message = status.message().to_owned();
        if status.code() == Code::DeadlineExceeded || has_expired(status) {
            return Self::TimedOut { address: address.to_owned(), message };
        }
        // A status with a source comes from the transport and not from a server.
        if std::error::Error::source(status).is_some() {
            return Self::from_transport(address, status);
        }
        match status.code() {
            Code::InvalidArgument
            | Code::NotFound
            | Code::OutOfRange
            | Code::FailedPrecondition => {
                Self::Refused { code: status.code(), field: invalid_field(status), message }
            }
            Code::Unauthenticated => Self::Unauthenticated { message },
            Code::PermissionDenied => Self::PermissionDenied { message },
            Code::Aborted => Self::Conflict { message },
            Code::Unimplemented => Self::NotRoundel {
                address: address.to_owned(),
                reason: format!("it does not support this call ({message})"),
            },
            code => Self::Server { code, message },
        }
    }

    /// Converts an error of the transport, also where it caused the end of a call.
    pub(crate) fn from_transport(address: &str, error: &(dyn std::error::Error + 'static)) -> Self {
        let address = address.to_owned();
        match tls_failure(error) {
            Some(TlsFailure::Fingerprint { expected, found }) => {
                Self::WrongFingerprint { address, expected, found }
            }
            Some(TlsFailure::Untrusted(reason)) => Self::Untrusted { address, reason },
            Some(TlsFailure::NoTls(_)) | None => {
                Self::Unreachable { address, reason: error_chain(error) }
            }
        }
    }
}

fn describe_age(age: &Option<Duration>) -> String {
    age.map_or("none has arrived yet".to_owned(), |age| format!("the newest arrived {age:.1?} ago"))
}

/// The invalid field according to the details of the status.
fn invalid_field(status: &Status) -> Option<String> {
    let mut violations = status.get_details_bad_request()?.field_violations;
    (!violations.is_empty()).then(|| violations.swap_remove(0).field)
}

/// The failure of a TLS handshake among the causes.
fn tls_failure(error: &(dyn std::error::Error + 'static)) -> Option<TlsFailure> {
    let mut next = Some(error);
    while let Some(error) = next {
        if let Some(failure) = error.downcast_ref::<TlsFailure>() {
            return Some(failure.clone());
        }
        next = error.source();
    }
    None
}

/// Whether the timeout of this side expired.
fn has_expired(status: &Status) -> bool {
    let mut next = std::error::Error::source(status);
    while let Some(error) = next {
        if error.is::<TimeoutExpired>() {
            return true;
        }
        next = error.source();
    }
    false
}

/// An error with its chain of causes, without repetitions.
pub(crate) fn error_chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut text = String::new();
    let mut next = Some(error);
    while let Some(error) = next {
        // tonic's statuses print as debug records, so use their message.
        let message = match error.downcast_ref::<Status>() {
            Some(status) => status.message().to_owned(),
            None => error.to_string(),
        };
        if !text.contains(&message) {
            let separator = if text.is_empty() { "" } else { ": " };
            text = format!("{text}{separator}{message}");
        }
        next = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use tonic_types::ErrorDetails;

    use super::*;

    #[test]
    fn a_refusal_names_the_invalid_field() {
        let details = ErrorDetails::with_bad_request_violation("horizon_ms", "expected less");
        let status =
            Status::with_error_details(Code::InvalidArgument, "horizon_ms: expected less", details);
        let expected = Error::Refused {
            code: Code::InvalidArgument,
            field: Some("horizon_ms".to_owned()),
            message: "horizon_ms: expected less".to_owned(),
        };
        assert_eq!(Error::from_status("http://a", &status), expected);
        let error = Error::from_status("http://a", &Status::not_found("no camera \"x\""));
        assert!(matches!(error, Error::Refused { code: Code::NotFound, field: None, .. }));
    }

    #[test]
    fn a_timeout_is_temporary() {
        let error = Error::from_status("http://a", &Status::deadline_exceeded("after 1s"));
        assert!(matches!(&error, Error::TimedOut { message, .. } if message == "after 1s"));
        assert!(error.is_temporary());
        let error =
            Error::from_status("http://a", &Status::from_error(Box::new(TimeoutExpired(()))));
        assert!(matches!(error, Error::TimedOut { .. }), "{error:?}");
    }

    #[test]
    fn missing_credentials_and_roles_are_typed_and_not_temporary() {
        let message = "the token is unknown".to_owned();
        let error = Error::from_status("http://a", &Status::unauthenticated(&message));
        assert_eq!(error, Error::Unauthenticated { message: message.clone() });
        assert!(!error.is_temporary());
        let error = Error::from_status("http://a", &Status::permission_denied(&message));
        assert_eq!(error, Error::PermissionDenied { message });
        assert!(!error.is_temporary());
    }

    #[test]
    fn an_aborted_call_is_a_conflict_and_not_temporary() {
        let status = Status::aborted("the camera has changed");
        let error = Error::from_status("http://a", &status);
        assert_eq!(error, Error::Conflict { message: "the camera has changed".to_owned() });
        assert!(!error.is_temporary());
        let error = Error::from_status("http://a", &Status::unavailable("too many clients"));
        assert!(error.is_temporary());
    }
}
