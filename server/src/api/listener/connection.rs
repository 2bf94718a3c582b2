//! One connection. It takes a slot with its first request (HTTP/1.1) or preface (HTTP/2), hyper serves it, and it is closed
//! when its client stalls.

use std::{
    error::Error,
    io,
    net::SocketAddr,
    pin::pin,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use axum::{
    body::Body,
    http::{HeaderValue, Request, Response, header},
    response::IntoResponse,
};
use hyper::body::{Body as _, Incoming};
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::conn::auto,
};
use tokio::{
    net::TcpStream,
    sync::{Notify, OnceCell},
    time::{Instant, sleep_until, timeout},
};
use tonic::Status;

use super::{
    pending::Pending,
    slots::{Activity, Admission, Slots},
    stall::{ResponseWatch, WatchedBody},
    stream::{Detected, Protocol, detect},
};
use crate::api::{
    ApiLimits, ApiState,
    dispatch::{Dispatch, is_grpc},
    error::ApiError,
    peer::Peer,
};

/// Send buffer of one HTTP/2 stream.
const STREAM_BUFFER_BYTES: usize = 64 * 1024;
/// An HTTP/2 client that is silent for this long is pinged.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(10);
const KEEP_ALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// Concurrent requests on one HTTP/2 connection.
const MAX_STREAMS: u32 = 128;
const MAX_HEAD_BYTES: usize = 64 * 1024;
/// Time for a connection that was refused, or sent no request in time, to end.
const CLOSING_TIMEOUT: Duration = Duration::from_secs(2);

pub(super) struct Connection {
    pub(super) pending: Arc<Pending>,
    pub(super) slots: Arc<Slots>,
    pub(super) api: Arc<ApiState>,
}

impl Connection {
    /// Serves until the client leaves, stalls, or the server shuts down.
    pub(super) async fn serve(self, stream: TcpStream, address: SocketAddr, dispatch: Dispatch) {
        let Self { pending, slots, api } = self;
        let _pending_ends = EndOnDrop(&pending);
        let activity = Activity::new(Some(address.ip()));
        let _forgotten = ForgetOnDrop(&slots, &activity);
        let limits = api.limits;
        let detecting = detect(stream, address, &api.tls, limits.send_timeout);
        let detected = tokio::select! {
            // A client that has sent its request is not evicted because this task is late.
            biased;
            detected = timeout(limits.request_timeout, detecting) => detected,
            () = pending.evicted() => return,
            () = api.cancel.cancelled() => return,
        };
        let Ok(Ok(Some(Detected { stream, protocol, peer }))) = detected else { return };
        let requests = Arc::new(Requests {
            admission: OnceCell::new(),
            refused: Notify::new(),
            watch: ResponseWatch::default(),
            peer,
            activity: activity.clone(),
            pending: pending.clone(),
            slots: slots.clone(),
            api: api.clone(),
            dispatch,
        });
        let mut closing_until: Option<Instant> = None;
        // An HTTP/2 client may connect and make its first request much later.
        if protocol == Protocol::Http2 && requests.is_refused().await {
            closing_until = Some(Instant::now() + CLOSING_TIMEOUT);
        }
        let answering = requests.clone();
        let service = hyper::service::service_fn(move |request| answering.clone().answer(request));
        let builder = hyper_builder(&limits);
        let io = TokioIo::new(stream);
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
                () = activity.closed() => return,
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

/// State that the requests of one connection share.
struct Requests {
    admission: OnceCell<Admission>,
    refused: Notify,
    watch: ResponseWatch,
    peer: Peer,
    activity: Arc<Activity>,
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
        // The rest of a request may arrive slowly, so the connection is idle from here on until the response begins.
        let begun = self.activity.begin();
        let has_arrived = request.body().is_end_stream();
        let answering = has_arrived.then_some(begun);
        let response = match self.admission().await {
            Admission::Admitted(slot) => {
                request.extensions_mut().insert(slot.clone());
                request.extensions_mut().insert(self.peer.clone());
                match self.dispatch.clone().answer(request).await {
                    Ok(response) => response,
                    Err(never) => match never {},
                }
            }
            Admission::Refused(refusal) => match refusal.error(&self.api.limits) {
                Some(error) => {
                    self.refused.notify_one();
                    refused(&request, error)
                }
                None => return Err(io::Error::other("no slot is free")),
            },
        };
        let answering = answering.unwrap_or_else(|| self.activity.begin());
        Ok(response.map(|body| self.watch.watched(body).answering(answering)))
    }

    async fn admission(&self) -> &Admission {
        let admit = async || {
            self.pending.end();
            self.slots.admit(&self.api, &self.activity).await
        };
        self.admission.get_or_init(admit).await
    }

    async fn is_refused(&self) -> bool {
        matches!(self.admission().await, Admission::Refused(_))
    }
}

struct EndOnDrop<'a>(&'a Pending);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}

struct ForgetOnDrop<'a>(&'a Slots, &'a Arc<Activity>);

impl Drop for ForgetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.forget(self.1);
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

/// Counts a client that is disconnected because it has read nothing for `send_timeout`.
pub(in crate::api) fn count_stalled(api: &ApiState) {
    let limit = api.limits.send_timeout;
    tracing::info!(?limit, "disconnected a client that does not read");
    api.counters.subscribers_cut.fetch_add(1, Ordering::Relaxed);
}

fn refused(request: &Request<Incoming>, error: ApiError) -> Response<Body> {
    if is_grpc(request) {
        return Status::from(error).into_http();
    }
    let mut response = error.into_response();
    response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    response
}
