//! The one port: accepts connections, enforces the limits on them, and ends them on shutdown.
//!
//! A connection is *pending* until its first request has arrived (its preface for HTTP/2). Only then does it take one of
//! the [`ApiLimits::max_clients`](super::ApiLimits) slots, so that silent connections do not block other clients. One peer
//! gets only a part of them, and idle connections give theirs up (`slots`). TLS, if configured, is on the same port: the
//! first byte tells. hyper
//! serves HTTP/1.1 and HTTP/2; `dispatch` hands each request to tonic or axum.

mod connection;
mod pending;
mod slots;
mod stall;
mod stream;

use std::{sync::Arc, time::Duration};

use tokio::{
    net::{TcpListener, TcpStream},
    task::JoinSet,
    time::{sleep, timeout},
};

use connection::Connection;
pub(super) use connection::count_stalled;
use pending::PendingConnections;
use slots::Slots;
pub(super) use slots::{ConnectionSlot, encoding_share, stream_permit};

use super::{ApiState, dispatch::Dispatch};

/// Bytes that the kernel may hold unsent for a client. More would be stale snapshots.
const UNSENT_LIMIT_BYTES: u32 = 64 * 1024;
/// Pause after a failed accept, which usually means that no file descriptor is left.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Accepts until cancellation, then waits for the last client, at most for the grace time.
pub(super) async fn run(listener: TcpListener, dispatch: Dispatch, api: Arc<ApiState>) {
    let slots = Arc::new(Slots::new(&api.limits));
    let mut connections = JoinSet::new();
    let mut pending = PendingConnections::default();
    loop {
        let (stream, address) = tokio::select! {
            () = api.cancel.cancelled() => break,
            Some(_) = connections.join_next(), if !connections.is_empty() => continue,
            accepted = listener.accept() => match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!(%error, "could not accept a connection");
                    sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            },
        };
        set_options(&stream);
        let connection =
            Connection { pending: pending.add(), slots: slots.clone(), api: api.clone() };
        connections.spawn(connection.serve(stream, address, dispatch.clone()));
    }
    drop(listener);
    // A WebSocket outlives the task of its connection, and holds its slot until it ends.
    let all_gone = async {
        while connections.join_next().await.is_some() {}
        slots.all_free().await;
    };
    if timeout(api.limits.grace, all_gone).await.is_err() {
        tracing::info!("closing the connections that did not end within the grace time");
        connections.shutdown().await;
    }
}

fn set_options(stream: &TcpStream) {
    let unsent_limit = socket2::SockRef::from(stream).set_tcp_notsent_lowat(UNSENT_LIMIT_BYTES);
    // Without these options, latency is a little higher.
    if let Err(error) = stream.set_nodelay(true).and(unsent_limit) {
        tracing::debug!(%error, "could not set a connection's options");
    }
}
