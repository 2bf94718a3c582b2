//! What can go wrong, said so that a reader knows what to do.

use std::time::Duration;

use tonic::{Code, Status, TimeoutExpired};
use tonic_types::StatusExt;

use crate::Link;

/// Why a call or a stream failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The address cannot be one.
    #[error(
        "{address:?} is no server's address: {reason}; expected http://HOST:PORT, such as http://127.0.0.1:7670"
    )]
    InvalidAddress {
        /// As it was given.
        address: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Nobody answers there, or no longer.
    #[error(
        "no answer from {address}: {reason}; check the address, and that the server runs (`roundel serve` or `roundel demo` print theirs)"
    )]
    Unreachable {
        /// As it was given.
        address: String,
        /// What the network said.
        reason: String,
    },
    /// Somebody answers there, but not a Roundel server.
    #[error("{address} answers, but is no Roundel server: {reason}")]
    NotRoundel {
        /// As it was given.
        address: String,
        /// What it said.
        reason: String,
    },
    /// The server refuses the request as it is; asking again will not help.
    #[error("the server refuses the request: {message}")]
    Refused {
        /// gRPC's word for it: `InvalidArgument`, `NotFound`, `OutOfRange`, `FailedPrecondition` or `PermissionDenied`.
        code: Code,
        /// The field that is wrong, as the messages call it, if it is one.
        field: Option<String>,
        /// Names the field or thing, what was expected, and what was found.
        message: String,
    },
    /// Somebody else was first: what the request builds on has changed since it was read. Read it again.
    #[error("somebody else was first: {message}")]
    Conflict {
        /// What has changed.
        message: String,
    },
    /// No answer came within the time that [`crate::Client::with_timeout`] tells. Whether the server has done what it was asked is
    /// not known.
    #[error("no answer from {address} in time: {message}")]
    TimedOut {
        /// As it was given.
        address: String,
        /// Who gave up, and when.
        message: String,
    },
    /// No snapshot is as new as was asked for: who steers by them had better stop.
    #[error("no snapshot within the last {longest:?}: {}; {link}", told(.age))]
    Stale {
        /// How old it might have been.
        longest: Duration,
        /// How long ago the newest one came; `None` before the first.
        age: Option<Duration>,
        /// What became of the connection.
        link: Box<Link>,
    },
    /// The server cannot answer now; a later try may succeed.
    #[error("the server cannot answer now ({code:?}): {message}")]
    Server {
        /// gRPC's word for it.
        code: Code,
        /// What the server said.
        message: String,
    },
}

impl Error {
    /// Whether asking again later can help.
    pub fn is_temporary(&self) -> bool {
        match self {
            Self::Unreachable { .. } | Self::TimedOut { .. } => true,
            Self::Stale { .. } | Self::Server { .. } => true,
            Self::InvalidAddress { .. } | Self::NotRoundel { .. } => false,
            Self::Refused { .. } | Self::Conflict { .. } => false,
        }
    }

    /// What a failed call to `address` means.
    pub(crate) fn from_status(address: &str, status: &Status) -> Self {
        let message = status.message().to_owned();
        if status.code() == Code::DeadlineExceeded || has_expired(status) {
            return Self::TimedOut { address: address.to_owned(), message };
        }
        // A status that came with an error of the transport was never sent by a server.
        if std::error::Error::source(status).is_some() {
            return Self::Unreachable { address: address.to_owned(), reason: chain(status) };
        }
        match status.code() {
            Code::InvalidArgument
            | Code::NotFound
            | Code::OutOfRange
            | Code::FailedPrecondition
            | Code::PermissionDenied => {
                Self::Refused { code: status.code(), field: wrong_field(status), message }
            }
            Code::Aborted => Self::Conflict { message },
            Code::Unimplemented => Self::NotRoundel {
                address: address.to_owned(),
                reason: format!("it does not know this call ({message})"),
            },
            code => Self::Server { code, message },
        }
    }
}

fn told(age: &Option<Duration>) -> String {
    age.map_or("none has come yet".to_owned(), |age| format!("the newest came {age:.1?} ago"))
}

/// The field that the server's details name.
fn wrong_field(status: &Status) -> Option<String> {
    let mut violations = status.get_details_bad_request()?.field_violations;
    (!violations.is_empty()).then(|| violations.swap_remove(0).field)
}

/// Whether this side of the connection gave up waiting.
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

/// An error with all its causes, each said once.
pub(crate) fn chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut text = String::new();
    let mut next = Some(error);
    while let Some(error) = next {
        // tonic's statuses and errors print as debug records; their causes say what happened.
        let said = match error.downcast_ref::<Status>() {
            Some(status) => status.message().to_owned(),
            None => error.to_string(),
        };
        if !text.contains(&said) {
            let separator = if text.is_empty() { "" } else { ": " };
            text = format!("{text}{separator}{said}");
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
    fn what_is_refused_says_which_field_is_wrong() {
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
    fn who_waited_in_vain_may_ask_again() {
        let error = Error::from_status("http://a", &Status::deadline_exceeded("after 1s"));
        assert!(matches!(&error, Error::TimedOut { message, .. } if message == "after 1s"));
        assert!(error.is_temporary());
        let error =
            Error::from_status("http://a", &Status::from_error(Box::new(TimeoutExpired(()))));
        assert!(matches!(error, Error::TimedOut { .. }), "{error:?}");
    }

    #[test]
    fn who_was_second_is_told_to_read_again_and_not_to_try_again() {
        let status = Status::aborted("the camera has changed");
        let error = Error::from_status("http://a", &status);
        assert_eq!(error, Error::Conflict { message: "the camera has changed".to_owned() });
        assert!(!error.is_temporary());
        let error = Error::from_status("http://a", &Status::unavailable("no room"));
        assert!(error.is_temporary());
    }
}
