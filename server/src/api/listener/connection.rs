//! One connection: takes a slot with its first request (HTTP/1.1) or preface (HTTP/2), is served by hyper, and is closed when its client stalls.

use std::{
    error::Error,
    io,
    pin::{Pin, pin},
    sync::{Arc, OnceLock, atomic::Ordering},
    time::Duration,
};

use axum::{
    body::Body,
    http::{HeaderValue, Request, Response, header},
    response::IntoResponse,
};
use hyper::body::Incoming;
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::conn::auto,
};
use tokio::{
    net::TcpStream,
    sync::{Notify, OwnedSemaphorePermit, Semaphore},
    time::{Instant, sleep, sleep_until, timeout},
};
use tokio_io_timeout::TimeoutStream;
use tonic::Status;

use super::{
    pending::Pending,
    stall::{ResponseWatch, WatchedBody},
};
use crate::api::{
    ApiLimits, ApiState,
    dispatch::{Dispatch, is_grpc},
    error::ApiError,
    push::PeerAddress,
};

/// Send buffer of one HTTP/2 stream.
const STREAM_BUFFER_BYTES: usize = 64 * 1024;
/// An HTTP/2 client that is silent for this long is pinged.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(10);
const KEEP_ALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// Concurrent requests on one HTTP/2 connection.
const MAX_STREAMS: u32 = 128;
const MAX_HEAD_BYTES: usize = 64 * 1024;
/// First bytes of an HTTP/2 connection (RFC 9113, section 3.4).
const HTTP2_PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
/// Time between two looks at an incomplete preface.
const PREFACE_POLL: Duration = Duration::from_millis(50);
/// Connections that are answered at once with the reason why there is no slot; further ones are closed without.
const MAX_REFUSALS: usize = 32;
/// Time for a connection that was refused, or sent no request in time, to end.
const CLOSING_TIMEOUT: Duration = Duration::from_secs(2);

/// Slots for the connections that the server allows.
pub(super) struct Slots {
    max_clients: usize,
    free: Arc<Semaphore>,
    refusals: Arc<Semaphore>,
}

impl Slots {
    pub(super) fn new(max_clients: usize) -> Self {
        let free = Arc::new(Semaphore::new(max_clients));
        Self { max_clients, free, refusals: Arc::new(Semaphore::new(MAX_REFUSALS)) }
    }

    pub(super) async fn all_free(&self) {
        let _ = self.free.acquire_many(self.max_clients as u32).await;
    }
}

/// Held for as long as a connection is open, by its task and by a WebSocket that took it over.
pub(in crate::api) struct ConnectionSlot {
    api: Arc<ApiState>,
    _permit: OwnedSemaphorePermit,
}

impl ConnectionSlot {
    fn new(api: Arc<ApiState>, permit: OwnedSemaphorePermit) -> Self {
        api.counters.connections.fetch_add(1, Ordering::Relaxed);
        Self { api, _permit: permit }
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        self.api.counters.connections.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Whether a connection got a slot.
enum Admission {
    Admitted(Arc<ConnectionSlot>),
    /// The permit lasts as long as the connection; without one the client is not answered.
    Refused(Option<OwnedSemaphorePermit>),
}

pub(super) struct Connection {
    pub(super) pending: Arc<Pending>,
    pub(super) slots: Arc<Slots>,
    pub(super) api: Arc<ApiState>,
}

impl Connection {
    /// Serves until the client leaves, stalls, or the server shuts down.
    pub(super) async fn serve(self, stream: TcpStream, dispatch: Dispatch) {
        let Self { pending, slots, api } = self;
        let _pending_ends = EndOnDrop(&pending);
        let requests = Arc::new(Requests {
            admission: OnceLock::new(),
            refused: Notify::new(),
            watch: ResponseWatch::default(),
            peer: stream.peer_addr().ok().map(PeerAddress),
            pending: pending.clone(),
            slots,
            api: api.clone(),
            dispatch,
        });
        let limits = api.limits;
        let protocol = tokio::select! {
            // A client that has sent its request is not evicted because this task is late.
            biased;
            protocol = timeout(limits.request_timeout, detect_protocol(&stream)) => protocol,
            () = pending.evicted() => return,
            () = api.cancel.cancelled() => return,
        };
        let Ok(Ok(Some(protocol))) = protocol else { return };
        let mut closing_until: Option<Instant> = None;
        // An HTTP/2 client may connect and make its first request much later.
        if protocol == Protocol::Http2 && requests.is_refused() {
            closing_until = Some(Instant::now() + CLOSING_TIMEOUT);
        }
        let answering = requests.clone();
        let service = hyper::service::service_fn(move |request| answering.clone().answer(request));
        let builder = hyper_builder(&limits);
        let io = with_write_timeout(stream, limits.send_timeout);
        let mut connection = pin!(builder.serve_connection_with_upgrades(io, service));
        let mut stalled = pin!(requests.watch.stalled(limits.send_timeout));
        let mut is_shutting_down = false;
        loop {
            let is_closing = closing_until.is_some();
            tokio::select! {
                biased;
                ended = connection.as_mut() => {
                    if let Err(error) = ended {
                        log_error(error.as_ref(), &api);
                    }
                    return;
                }
                () = stalled.as_mut() => return count_stalled(&api),
                () = pending.evicted(), if !pending.is_over() => return,
                () = sleep_until(closing_until.unwrap_or_else(Instant::now)), if is_closing => return,
                () = requests.refused.notified() => {
                    connection.as_mut().graceful_shutdown();
                    closing_until = Some(Instant::now() + CLOSING_TIMEOUT);
                }
                () = api.cancel.cancelled(), if !is_shutting_down => {
                    connection.as_mut().graceful_shutdown();
                    is_shutting_down = true;
                }
            }
        }
    }
}

struct Requests {
    admission: OnceLock<Admission>,
    refused: Notify,
    watch: ResponseWatch,
    peer: Option<PeerAddress>,
    pending: Arc<Pending>,
    slots: Arc<Slots>,
    api: Arc<ApiState>,
    dispatch: Dispatch,
}

impl Requests {
    async fn answer(
        self: Arc<Self>,
        mut request: Request<Incoming>,
    ) -> io::Result<Response<WatchedBody>> {
        let response = match self.admission() {
            Admission::Admitted(slot) => {
                request.extensions_mut().insert(slot.clone());
                self.peer.map(|peer| request.extensions_mut().insert(peer));
                match self.dispatch.clone().answer(request).await {
                    Ok(response) => response,
                    Err(never) => match never {},
                }
            }
            Admission::Refused(Some(_)) => {
                self.refused.notify_one();
                refusal(&request, &self.api.limits)
            }
            Admission::Refused(None) => return Err(io::Error::other("no slot is free")),
        };
        Ok(response.map(|body| self.watch.watched(body)))
    }

    fn admission(&self) -> &Admission {
        self.admission.get_or_init(|| self.admit())
    }

    fn is_refused(&self) -> bool {
        matches!(self.admission(), Admission::Refused(_))
    }

    fn admit(&self) -> Admission {
        self.pending.end();
        if let Ok(permit) = self.slots.free.clone().try_acquire_owned() {
            return Admission::Admitted(Arc::new(ConnectionSlot::new(self.api.clone(), permit)));
        }
        self.api.counters.connections_refused.fetch_add(1, Ordering::Relaxed);
        Admission::Refused(self.slots.refusals.clone().try_acquire_owned().ok())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Protocol {
    /// HTTP/1.1, or bytes that hyper will reject.
    Http1,
    Http2,
}

/// Waits until the first bytes show the protocol; `None` if the client has left. hyper would wait for the rest of an
/// incomplete HTTP/2 preface without a time limit.
async fn detect_protocol(stream: &TcpStream) -> io::Result<Option<Protocol>> {
    let mut first = [0; HTTP2_PREFACE.len()];
    loop {
        let length = stream.peek(&mut first).await?;
        if length == 0 {
            return Ok(None);
        }
        if !HTTP2_PREFACE.starts_with(&first[..length]) {
            return Ok(Some(Protocol::Http1));
        }
        if length == HTTP2_PREFACE.len() {
            return Ok(Some(Protocol::Http2));
        }
        // Peeking returns at once as long as there is a byte.
        sleep(PREFACE_POLL).await;
    }
}

struct EndOnDrop<'a>(&'a Pending);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}

fn hyper_builder(limits: &ApiLimits) -> auto::Builder<TokioExecutor> {
    let mut builder = auto::Builder::new(TokioExecutor::new());
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.request_timeout)
        .max_buf_size(MAX_HEAD_BYTES);
    builder
        .http2()
        .timer(TokioTimer::new())
        .keep_alive_interval(KEEP_ALIVE_INTERVAL)
        .keep_alive_timeout(KEEP_ALIVE_TIMEOUT)
        .max_concurrent_streams(MAX_STREAMS)
        .max_header_list_size(MAX_HEAD_BYTES as u32)
        .max_send_buf_size(STREAM_BUFFER_BYTES);
    builder
}

/// A write that makes no progress for `timeout` fails with [`io::ErrorKind::TimedOut`].
fn with_write_timeout(
    stream: TcpStream,
    timeout: Duration,
) -> TokioIo<Pin<Box<TimeoutStream<TcpStream>>>> {
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(timeout));
    TokioIo::new(Box::pin(stream))
}

fn log_error(error: &(dyn Error + 'static), api: &ApiState) {
    if is_write_timeout(error) {
        count_stalled(api);
    } else {
        tracing::debug!(error, "a connection ended early");
    }
}

fn is_write_timeout(error: &(dyn Error + 'static)) -> bool {
    let io_error = error.downcast_ref::<io::Error>();
    io_error.is_some_and(|error| error.kind() == io::ErrorKind::TimedOut)
        || error.source().is_some_and(is_write_timeout)
}

/// Counts a client that was disconnected since it took nothing for too long.
pub(in crate::api) fn count_stalled(api: &ApiState) {
    let limit = api.limits.send_timeout;
    tracing::info!(?limit, "disconnected a client that does not read");
    api.counters.subscribers_cut.fetch_add(1, Ordering::Relaxed);
}

fn refusal(request: &Request<Incoming>, limits: &ApiLimits) -> Response<Body> {
    let max_clients = limits.max_clients;
    let error = ApiError::ResourceExhausted(format!(
        "all {max_clients} connections that this server allows are in use; close one, or raise limits.max_clients"
    ));
    if is_grpc(request) {
        return Status::from(error).into_http();
    }
    let mut response = error.into_response();
    response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    response
}
