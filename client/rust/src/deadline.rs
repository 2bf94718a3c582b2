//! How long a call's answer is waited for: said to the server (`grpc-timeout`), and kept to by the connection itself, since
//! a server that hangs says nothing.

use std::time::Duration;

use tonic::{
    Request, Status,
    service::{Interceptor, interceptor::InterceptedService},
    transport::Channel,
};

use crate::v1::roundel_client::RoundelClient;

/// A handle on a connection, for one call.
pub(crate) type Service = RoundelClient<InterceptedService<Channel, Deadline>>;

/// How long an answer is waited for if nobody says otherwise: the slowest of these calls, a picture, takes some seconds.
const USUAL: Duration = Duration::from_secs(15);
/// The same of calls for which the server opens, writes or searches something.
const LONG: Duration = Duration::from_secs(60);

/// For so long; `None`: for ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Deadline(Option<Duration>);

impl Deadline {
    /// Of a stream.
    pub(crate) const NEVER: Self = Self(None);

    /// Of a call with one answer; `told` is how long its client was told to wait, whatever it asks for.
    pub(crate) fn usual(told: Option<Duration>) -> Self {
        Self(Some(told.unwrap_or(USUAL)))
    }

    /// Likewise of one for which the server opens, writes or searches something.
    pub(crate) fn long(told: Option<Duration>) -> Self {
        Self(Some(told.unwrap_or(LONG)))
    }
}

impl Interceptor for Deadline {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(timeout) = self.0 {
            request.set_timeout(timeout);
        }
        Ok(request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_client_was_told_counts_for_every_call() {
        assert_eq!(Deadline::usual(None), Deadline(Some(Duration::from_secs(15))));
        assert_eq!(Deadline::long(None), Deadline(Some(Duration::from_secs(60))));
        for told in [Duration::from_millis(200), Duration::from_secs(300)] {
            for deadline in [Deadline::usual(Some(told)), Deadline::long(Some(told))] {
                assert_eq!(deadline, Deadline(Some(told)));
            }
        }
    }
}
