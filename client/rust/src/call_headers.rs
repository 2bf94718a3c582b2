//! Headers of every call: its deadline, and the client's token.
//!
//! tonic sends deadlines to the server (`grpc-timeout`) and also enforces them on this side, in case the server hangs.

use std::time::Duration;

use tonic::{
    Request, Status,
    metadata::{Ascii, MetadataValue},
    service::{Interceptor, interceptor::InterceptedService},
    transport::Channel,
};

use crate::v1::roundel_client::RoundelClient;

/// The stub for one call.
pub(crate) type Service = RoundelClient<InterceptedService<Channel, CallHeaders>>;

/// Default for most calls. The slowest of them, a picture, takes some seconds.
const DEFAULT: Duration = Duration::from_secs(15);
/// Default for calls for which the server opens, writes or searches something.
const LONG: Duration = Duration::from_secs(60);

/// The timeout of a call; `None` for streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Deadline(Option<Duration>);

impl Deadline {
    pub(crate) const NONE: Self = Self(None);

    /// Deadline of a unary call; `timeout` is that of the client.
    pub(crate) fn unary(timeout: Option<Duration>) -> Self {
        Self(Some(timeout.unwrap_or(DEFAULT)))
    }

    /// Deadline of a unary call for which the server opens, writes or searches something.
    pub(crate) fn long_unary(timeout: Option<Duration>) -> Self {
        Self(Some(timeout.unwrap_or(LONG)))
    }
}

#[derive(Clone, Debug)]
pub(crate) struct CallHeaders {
    pub(crate) deadline: Deadline,
    pub(crate) authorization: Option<MetadataValue<Ascii>>,
}

impl Interceptor for CallHeaders {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Deadline(Some(timeout)) = self.deadline {
            request.set_timeout(timeout);
        }
        if let Some(authorization) = &self.authorization {
            request.metadata_mut().insert("authorization", authorization.clone());
        }
        Ok(request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_timeout_of_the_client_applies_to_every_call() {
        assert_eq!(Deadline::unary(None), Deadline(Some(Duration::from_secs(15))));
        assert_eq!(Deadline::long_unary(None), Deadline(Some(Duration::from_secs(60))));
        for timeout in [Duration::from_millis(200), Duration::from_secs(300)] {
            for deadline in [Deadline::unary(Some(timeout)), Deadline::long_unary(Some(timeout))] {
                assert_eq!(deadline, Deadline(Some(timeout)));
            }
        }
    }
}
