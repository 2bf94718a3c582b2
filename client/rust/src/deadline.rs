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

/// For so long; `None`: for ever.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Deadline(pub(crate) Option<Duration>);

impl Interceptor for Deadline {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(timeout) = self.0 {
            request.set_timeout(timeout);
        }
        Ok(request)
    }
}
