//! What can go wrong, said so that a reader knows what to do.

use tonic::{Code, Status};

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
        /// Names the field or thing, what was expected, and what was found.
        message: String,
    },
    /// Somebody else was first: what the request builds on has changed since it was read. Read it again.
    #[error("somebody else was first: {message}")]
    Conflict {
        /// What has changed.
        message: String,
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
        matches!(self, Self::Unreachable { .. } | Self::Server { .. })
    }

    /// What a failed call to `address` means.
    pub(crate) fn from_status(address: &str, status: &Status) -> Self {
        let message = status.message().to_owned();
        // A status that came with an error of the transport was never sent by a server.
        if std::error::Error::source(status).is_some() {
            return Self::Unreachable { address: address.to_owned(), reason: chain(status) };
        }
        match status.code() {
            Code::InvalidArgument
            | Code::NotFound
            | Code::OutOfRange
            | Code::FailedPrecondition => Self::Refused { message },
            Code::Aborted => Self::Conflict { message },
            Code::Unimplemented => Self::NotRoundel {
                address: address.to_owned(),
                reason: format!("it does not know this call ({message})"),
            },
            code => Self::Server { code, message },
        }
    }
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
    use super::*;

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
