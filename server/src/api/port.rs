//! The one port: accepts connections up to the limit, hands requests to gRPC or HTTP, and takes
//! everything apart on shutdown.

mod gather;

use std::{
    convert::Infallible,
    future::poll_fn,
    io,
    pin::{Pin, pin},
    sync::{Arc, atomic::Ordering},
    task::{Context, Poll},
    time::Duration,
};

use axum::{
    Router,
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
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    sync::{Notify, OwnedSemaphorePermit, Semaphore},
    task::JoinSet,
    time::{sleep, timeout},
};
use tokio_util::sync::CancellationToken;
use tonic::Status;
use tower::{Layer, ServiceExt, service_fn};
use tower_http::cors::CorsLayer;

use self::gather::Gather;
use super::{Api, deadline, error::ApiError, grpc::Cut, push::Peer};

/// Bytes that the kernel may hold unsent for a client. More would be stale snapshots: a slow client
/// is to find the newest one when it comes back.
const UNSENT_LIMIT_BYTES: u32 = 64 * 1024;
/// The same for what HTTP/2 holds for one stream.
const STREAM_BUFFER_BYTES: usize = 64 * 1024;
/// A client that has connected says something within this time; also between two requests.
const HEADER_TIMEOUT: Duration = Duration::from_secs(15);
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

    async fn route(self, request: Request<Incoming>) -> Result<Response<Body>, Infallible> {
        if is_grpc_web(&request) {
            self.answer_web(request).await
        } else if is_grpc(&request) {
            self.answer_grpc(request.map(Body::new)).await
        } else {
            self.http_router.oneshot(request.map(Body::new)).await
        }
    }

    async fn answer_grpc(self, request: Request<Body>) -> Result<Response<Body>, Infallible> {
        let headers = request.headers().clone();
        deadline::answer(&headers, self.grpc_router.oneshot(request)).await
    }

    /// gRPC as pages in browsers speak it: over HTTP/1.1 too, with the trailers in the body.
    async fn answer_web(self, request: Request<Incoming>) -> Result<Response<Body>, Infallible> {
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
        if let Ok(permit) = slots.clone().try_acquire_owned() {
            let stream = Counted::new(stream, permit, api.clone());
            connections.spawn(converse(stream, dispatch.clone(), api.clone()));
            continue;
        }
        api.counters.connections_refused.fetch_add(1, Ordering::Relaxed);
        if let Ok(permit) = refusals.clone().try_acquire_owned() {
            connections.spawn(refuse(stream, permit, max_clients));
        }
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

fn protocol() -> auto::Builder<TokioExecutor> {
    let mut builder = auto::Builder::new(TokioExecutor::new());
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIMEOUT)
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

/// Serves one connection to its end.
async fn converse(stream: Counted, dispatch: Dispatch, api: Arc<Api>) {
    if !speaks(&stream.stream, &api).await {
        return;
    }
    let peer = stream.stream.peer_addr().ok().map(Peer);
    let cut = Cut(CancellationToken::new());
    let given = cut.clone();
    let service = hyper::service::service_fn(move |mut request: Request<Incoming>| {
        peer.map(|peer| request.extensions_mut().insert(peer));
        request.extensions_mut().insert(given.clone());
        dispatch.clone().answer(request)
    });
    let protocol = protocol();
    let stream = Gather::new(stream);
    let io = TokioIo::new(stream.clone());
    let mut connection = pin!(protocol.serve_connection_with_upgrades(io, service));
    let ended = tokio::select! {
        ended = poll_fn(|context| stream.poll_through(connection.as_mut(), context)) => ended,
        () = cut.0.cancelled() => return,
        () = api.cancel.cancelled() => {
            connection.as_mut().graceful_shutdown();
            poll_fn(|context| stream.poll_through(connection.as_mut(), context)).await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(error, "a connection ended early");
    }
}

/// Waits for the first byte; false if the client only holds the line.
async fn speaks(stream: &TcpStream, api: &Api) -> bool {
    tokio::select! {
        ready = timeout(HEADER_TIMEOUT, stream.readable()) => matches!(ready, Ok(Ok(()))),
        () = api.cancel.cancelled() => false,
    }
}

/// Answers the first request with the reason for having no room, and hangs up.
async fn refuse(stream: TcpStream, _permit: OwnedSemaphorePermit, max_clients: usize) {
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
    let protocol = protocol();
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

/// A socket that holds its place among the connections for as long as it is open, also when a
/// WebSocket has taken it over.
struct Counted {
    stream: TcpStream,
    api: Arc<Api>,
    _permit: OwnedSemaphorePermit,
}

impl Counted {
    fn new(stream: TcpStream, permit: OwnedSemaphorePermit, api: Arc<Api>) -> Self {
        api.counters.connections.fetch_add(1, Ordering::Relaxed);
        Self { stream, api, _permit: permit }
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.api.counters.connections.fetch_sub(1, Ordering::Relaxed);
    }
}

impl AsyncRead for Counted {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Counted {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, parts)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
