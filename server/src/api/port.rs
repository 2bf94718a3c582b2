//! The one port: accepts connections up to the limit, hands requests to gRPC or HTTP, and takes
//! everything apart on shutdown.

mod arrival;
mod direct;
mod frames;
mod gather;
mod http2;
mod sheet;
mod socket;
mod stuck;
mod windows;
#[cfg(test)]
mod wire;

use std::{
    convert::Infallible,
    future::poll_fn,
    pin::pin,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use axum::{
    Router,
    body::Body,
    http::{HeaderValue, Request, Response, Version, header},
    response::IntoResponse,
};
use hyper::body::Incoming;
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::conn::auto,
};
use tokio::{
    net::{TcpListener, TcpStream},
    sync::{Notify, OwnedSemaphorePermit, Semaphore},
    task::JoinSet,
    time::{sleep, timeout},
};
use tokio_util::sync::CancellationToken;
use tonic::Status;
use tower::{Layer, ServiceExt, service_fn};
use tower_http::{cors::CorsLayer, timeout::TimeoutBody};

use self::{
    arrival::{Language, Silent, language},
    gather::Gather,
    socket::Counted,
    stuck::{Answers, stuck},
};
pub(super) use self::{
    direct::{Direct, Line},
    sheet::Sheet,
};
use super::{Api, Limits, deadline, error::ApiError, push::Peer};

/// Bytes that the kernel may hold unsent for a client. More would be stale snapshots: a slow client
/// is to find the newest one when it comes back.
const UNSENT_LIMIT_BYTES: u32 = 64 * 1024;
/// The same for what HTTP/2 holds for one stream.
const STREAM_BUFFER_BYTES: usize = 64 * 1024;
/// An HTTP/2 client that is silent for this long is asked whether it lives.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(10);
/// And has this long to answer.
const KEEP_ALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// Requests at once on one HTTP/2 connection.
const MAX_STREAMS: u32 = 128;
/// Largest head of a request.
const MAX_HEAD_BYTES: usize = 64 * 1024;
/// Connections that are being told at once that there is no room; beyond, they are just closed.
const MAX_REFUSALS: usize = 32;
/// Time for telling a client that there is no room.
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(2);

/// Where requests go.
#[derive(Clone)]
pub(super) struct Dispatch {
    /// Those with a content type of `application/grpc…`.
    pub grpc_router: Router,
    /// All others.
    pub http_router: Router,
    /// What pages of other origins may.
    pub cors: Option<CorsLayer>,
    /// How long a request's body may pause.
    pub body_timeout: Duration,
}

impl Dispatch {
    async fn answer(mut self, request: Request<Incoming>) -> Result<Response<Body>, Infallible> {
        match self.cors.take() {
            None => self.route(request).await,
            Some(cors) => {
                let route = service_fn(move |request| self.clone().route(request));
                cors.layer(route).oneshot(request).await
            }
        }
    }

    async fn route(self, mut request: Request<Incoming>) -> Result<Response<Body>, Infallible> {
        // The trailers of gRPC-Web are in its body, and a deadline ends one between two messages: both have to see all
        // of it.
        if is_grpc_web(&request) || deadline::is_set(request.headers()) {
            request.extensions_mut().remove::<Line>();
        }
        // Streams of gRPC rest for as long as they like, and HTTP/2 asks whether their client lives.
        let may_rest = request.version() >= Version::HTTP_2 && is_grpc(&request);
        let request = request.map(|body| match may_rest {
            true => Body::new(body),
            false => Body::new(TimeoutBody::new(self.body_timeout, body)),
        });
        if is_grpc_web(&request) {
            self.answer_web(request).await
        } else if is_grpc(&request) {
            self.answer_grpc(request).await
        } else {
            self.http_router.oneshot(request).await
        }
    }

    async fn answer_grpc(self, request: Request<Body>) -> Result<Response<Body>, Infallible> {
        let headers = request.headers().clone();
        deadline::answer(&headers, self.grpc_router.oneshot(request)).await
    }

    /// gRPC as pages in browsers speak it: over HTTP/1.1 too, with the trailers in the body.
    async fn answer_web(self, request: Request<Body>) -> Result<Response<Body>, Infallible> {
        let plain = service_fn(move |request: Request<tonic::body::Body>| {
            let this = self.clone();
            async move {
                let response = this.answer_grpc(request.map(Body::new)).await?;
                Ok::<_, Infallible>(response.map(tonic::body::Body::new))
            }
        });
        let service = tonic_web::GrpcWebLayer::new().layer(plain);
        Ok(service.oneshot(request).await?.map(Body::new))
    }
}

fn is_grpc_web<B>(request: &Request<B>) -> bool {
    let content_type = request.headers().get(header::CONTENT_TYPE);
    content_type.is_some_and(|value| value.as_bytes().starts_with(b"application/grpc-web"))
}

/// Merging both routers would let tonic answer unknown REST paths.
fn is_grpc<B>(request: &Request<B>) -> bool {
    let content_type = request.headers().get(header::CONTENT_TYPE);
    content_type.is_some_and(|value| value.as_bytes().starts_with(b"application/grpc"))
}

/// Accepts until cancellation, then waits for the last client within the grace time.
pub(super) async fn run(listener: TcpListener, dispatch: Dispatch, api: Arc<Api>) {
    let max_clients = api.limits.max_clients.clamp(1, u32::MAX as usize >> 4);
    let slots = Arc::new(Semaphore::new(max_clients));
    let refusals = Arc::new(Semaphore::new(MAX_REFUSALS));
    let mut connections = JoinSet::new();
    let mut silent = Silent::default();
    loop {
        let stream = tokio::select! {
            () = api.cancel.cancelled() => break,
            Some(_) = connections.join_next(), if !connections.is_empty() => continue,
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => stream,
                Err(error) => {
                    tracing::warn!(%error, "could not accept a connection");
                    // Out of open files, most likely: without a pause this would spin.
                    sleep(Duration::from_millis(100)).await;
                    continue;
                }
            },
        };
        prepare(&stream);
        let newcomer = Newcomer {
            stream,
            has_spoken: silent.add(),
            slots: slots.clone(),
            refusals: refusals.clone(),
        };
        connections.spawn(newcomer.converse(dispatch.clone(), api.clone()));
    }
    drop(listener);
    // WebSockets have left their connection's task; they hold a slot until they end.
    let all_gone = async {
        while connections.join_next().await.is_some() {}
        let _ = slots.acquire_many(max_clients as u32).await;
    };
    if timeout(api.limits.grace, all_gone).await.is_err() {
        tracing::info!("cutting off the clients that did not end within the grace time");
        connections.shutdown().await;
    }
}

fn prepare(stream: &TcpStream) {
    let unsent_limit = socket2::SockRef::from(stream).set_tcp_notsent_lowat(UNSENT_LIMIT_BYTES);
    // Without either, the client is only served a little later.
    if let Err(error) = stream.set_nodelay(true).and(unsent_limit) {
        tracing::debug!(%error, "could not set a connection's options");
    }
}

fn protocol(limits: &Limits) -> auto::Builder<TokioExecutor> {
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

/// A connection that has just been accepted, and takes a place once it has said something.
struct Newcomer {
    stream: TcpStream,
    /// One of [`Silent`].
    has_spoken: CancellationToken,
    slots: Arc<Semaphore>,
    refusals: Arc<Semaphore>,
}

impl Newcomer {
    async fn converse(self, dispatch: Dispatch, api: Arc<Api>) {
        let Self { stream, has_spoken, slots, refusals } = self;
        let limits = api.limits;
        let _is_over = has_spoken.clone().drop_guard();
        let language = tokio::select! {
            language = timeout(limits.request_timeout, language(&stream)) => language,
            () = api.cancel.cancelled() => return,
            () = has_spoken.cancelled() => return,
        };
        has_spoken.cancel();
        let Ok(Ok(Some(language))) = language else { return };
        if let Ok(permit) = slots.try_acquire_owned() {
            let stream = Counted::new(stream, permit, api.clone());
            return converse(stream, language, dispatch, api).await;
        }
        api.counters.connections_refused.fetch_add(1, Ordering::Relaxed);
        if let Ok(permit) = refusals.try_acquire_owned() {
            refuse(stream, permit, &limits).await;
        }
    }
}

/// Serves one connection to its end.
async fn converse(stream: Counted, language: Language, dispatch: Dispatch, api: Arc<Api>) {
    let peer = stream.stream.peer_addr().ok().map(Peer);
    let stream = Gather::new(stream, language == Language::Http2);
    let _ending = Ending(&stream);
    let line = Line(stream.clone());
    let answers = Arc::new(Answers::default());
    let given = answers.clone();
    let service = hyper::service::service_fn(move |mut request: Request<Incoming>| {
        peer.map(|peer| request.extensions_mut().insert(peer));
        request.extensions_mut().insert(line.clone());
        let (answer, answers) = (dispatch.clone().answer(request), given.clone());
        async move { Ok::<_, Infallible>(answer.await?.map(|body| answers.watched(body))) }
    });
    let protocol = protocol(&api.limits);
    let io = TokioIo::new(stream.clone());
    let mut connection = pin!(protocol.serve_connection_with_upgrades(io, service));
    let ended = tokio::select! {
        ended = poll_fn(|context| stream.poll_through(connection.as_mut(), context)) => ended,
        () = stuck(|| answers.waiting().max(stream.stuck_for()), api.limits.send_timeout) => {
            let limit = api.limits.send_timeout;
            tracing::info!(?limit, "cutting off a client that takes nothing of what there is for it");
            api.counters.subscribers_cut.fetch_add(1, Ordering::Relaxed);
            return;
        }
        () = api.cancel.cancelled() => {
            connection.as_mut().graceful_shutdown();
            poll_fn(|context| stream.poll_through(connection.as_mut(), context)).await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(error, "a connection ended early");
    }
}

/// With this the connection ends, also for what goes past the library that speaks on it.
struct Ending<'a>(&'a Gather<Counted>);

impl Drop for Ending<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}

/// Answers the first request with the reason for having no room, and hangs up.
async fn refuse(stream: TcpStream, _permit: OwnedSemaphorePermit, limits: &Limits) {
    let max_clients = limits.max_clients;
    let told = Arc::new(Notify::new());
    let teller = told.clone();
    let service = hyper::service::service_fn(move |request: Request<Incoming>| {
        teller.notify_one();
        let error = ApiError::ResourceExhausted(format!(
            "all {max_clients} connections that this server allows are in use; close one, or raise limits.max_clients"
        ));
        let response = if is_grpc(&request) {
            Status::from(error).into_http()
        } else {
            let mut response = error.into_response();
            response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
            response
        };
        std::future::ready(Ok::<_, Infallible>(response))
    });
    let protocol = protocol(limits);
    let mut connection = pin!(protocol.serve_connection(TokioIo::new(stream), service));
    let conversation = async {
        tokio::select! {
            _ = connection.as_mut() => {}
            () = told.notified() => {
                connection.as_mut().graceful_shutdown();
                let _ = connection.await;
            }
        }
    };
    let _ = timeout(REFUSAL_TIMEOUT, conversation).await;
}
