//! gRPC, REST, WebSocket, metrics and the dashboard, on one port.
//!
//! In: the [`Hub`], read only (except requests for pictures), and the services of the layers below. Out: bytes on sockets.
//! Requests whose content type is `application/grpc…` go to tonic, all others to axum; both serve HTTP/1.1 and HTTP/2,
//! with or without TLS.
//!
//! | module | purpose |
//! | --- | --- |
//! | `listener` | accepts connections, limits them, disconnects stalled clients, shuts down |
//! | [`tls`] | certificates, and TLS on the same port |
//! | [`peer`] | address and certificate of a client |
//! | `dispatch` | hands requests to tonic or axum |
//! | [`grpc`] | the service of `proto/roundel/v1/roundel.proto` |
//! | [`push`] | the service of `push.proto`: remote programs send frames and detections |
//! | [`rest`], [`calibration`], [`recording`], [`replay`], [`history`], [`openapi`] | `/api/v1/…` and its description |
//! | [`setup`], [`objects`], [`configuration`] | change cameras, objects and the whole configuration |
//! | [`print`] | printable roundels |
//! | [`lens`] | lens calibration of a camera |
//! | [`plan`] | predicted coverage and precision |
//! | [`simulation`] | simulated robots driven by clients |
//! | [`source_probe`] | probes a source |
//! | [`ws`] | `/api/v1/stream` |
//! | [`metrics`] | `/metrics`, `/healthz`, `/readyz` |
//! | [`dashboard`] | the dashboard's files |
//! | `handler` | arguments and results of handlers, which REST and gRPC share |
//! | `heavy` | budget of requests that take much memory or processor time |
//! | [`snapshot_encoder`] | encodes each snapshot once per filter and encoding |
//! | [`encoding_budget`] | processor time for the encodings of selections |
//! | [`selection`], [`snapshot_subscription`] | filters and rate limits of subscribers |
//! | `region` | a box of the world in a request |
//! | [`picture`] | a frame with its detections drawn in, as JPEG |
//! | `deadline` | deadlines of gRPC calls |
//! | [`access`] | who may do what: names, credentials, roles, sign-in |
//! | `cors` | access of web pages from other origins |
//! | [`error`] | errors and their codes in each protocol |
//!
//! No client can block another one or the server: a subscriber holds a handle on the newest snapshot and not a queue,
//! sockets buffer little more than one message, and a client that reads nothing is disconnected.

pub mod access;
pub mod calibration;
pub mod configuration;
mod cors;
pub mod dashboard;
mod deadline;
mod dispatch;
pub mod encoding_budget;
pub mod error;
pub mod grpc;
mod handler;
mod heavy;
pub mod history;
pub mod lens;
mod listener;
pub mod metrics;
pub mod objects;
mod observation_subscription;
pub mod openapi;
pub mod peer;
pub mod picture;
pub mod plan;
pub mod print;
pub mod push;
mod queries;
pub mod query;
pub mod recording;
mod region;
pub mod replay;
pub mod rest;
pub mod selection;
pub mod setup;
pub mod simulation;
pub mod snapshot_encoder;
pub mod snapshot_subscription;
pub mod source_probe;
pub mod tls;
pub mod ws;

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{Arc, atomic::AtomicU64},
    time::Duration,
};

use axum::{Router, extract::DefaultBodyLimit, middleware};
use roundel_core::{marker::Kind, plan::TrialCache};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use self::access::AccessControl;
pub use self::{cors::AllowedOrigins, heavy::HeavyWork};
use self::{
    encoding_budget::EncodingBudget, error::ApiError, heavy::half_of_the_processors,
    snapshot_encoder::SnapshotEncoder, tls::Tls,
};
use crate::{
    archive::{history::History, record::Recorder, replay::Replay},
    capture::{
        source::{fleet::Fleets, push::PushEndpoints},
        source_probe::SourceProbe,
    },
    fusion::{
        calibration::{Calibrator, file::CalibrationFile},
        camera_manager::CameraManager,
    },
    lab::lens::LensCalibrator,
    model::{clock::Clock, convert, hub::Hub},
};

/// Largest request of any protocol, except messages to [`push`].
const MAX_REQUEST_BYTES: usize = 256 * 1024;
/// Memory of all prints, plans, tables of codes and queries of the history that are made or sent at a time.
const FILE_BYTES: usize = 96 * 1024 * 1024;
/// Memory of all camera pictures that are encoded or sent at a time.
const PICTURE_BYTES: usize = 96 * 1024 * 1024;

#[derive(Clone, Copy, Debug)]
pub struct ApiLimits {
    /// Open connections; further ones are refused with an error that says so.
    pub max_clients: usize,
    /// Open connections of one peer: an IPv4 address, or an IPv6 network of 64 bits.
    pub max_connections_per_peer: usize,
    /// Time for clients to leave after the shutdown starts.
    pub grace: Duration,
    /// A client that reads nothing for this long is disconnected.
    pub send_timeout: Duration,
    /// Limit for the first bytes of a connection, for a request's head, and for a pause within its body.
    pub request_timeout: Duration,
}

impl Default for ApiLimits {
    fn default() -> Self {
        Self {
            max_clients: 2000,
            max_connections_per_peer: 1000,
            grace: Duration::from_secs(2),
            send_timeout: Duration::from_secs(10),
            request_timeout: Duration::from_secs(15),
        }
    }
}

#[derive(Debug, Default)]
pub struct ApiCounters {
    pub connections: AtomicU64,
    /// Connections refused because of the limits.
    pub connections_refused: AtomicU64,
    /// Idle connections closed for new ones.
    pub connections_evicted: AtomicU64,
    /// Subscribers to snapshots right now, by gRPC or WebSocket.
    pub snapshot_subscribers: AtomicU64,
    pub snapshots_sent: AtomicU64,
    /// Clients disconnected because they read nothing.
    pub subscribers_cut: AtomicU64,
    /// Snapshots that slow subscribers skipped.
    pub snapshots_missed: AtomicU64,
}

pub struct ApiState {
    pub hub: Arc<Hub>,
    pub clock: Clock,
    pub calibrator: Arc<Calibrator>,
    pub lenses: Arc<LensCalibrator>,
    /// Kinds of roundel, by [`roundel_core::id::KindId`]; empty where their sizes are not known.
    pub kinds: Vec<Kind>,
    pub fleets: Arc<Fleets>,
    pub ports: Arc<PushEndpoints>,
    /// Fusion drops observations that are older than this, milliseconds.
    pub late_window_ms: f64,
    /// `None`: clients must not probe sources.
    pub source_probe: Option<Arc<SourceProbe>>,
    /// `None`: clients must not change the configuration.
    pub camera_manager: Option<Arc<CameraManager>>,
    pub access: Arc<AccessControl>,
    pub recorder: Option<Arc<Recorder>>,
    /// `None`: the server does not play a recording.
    pub replay: Option<Replay>,
    pub history: Option<Arc<History>>,
    pub cancel: CancellationToken,
    pub limits: ApiLimits,
    pub tls: Tls,
    pub counters: ApiCounters,
    pub encoder: SnapshotEncoder,
    pub encoding_budget: Arc<EncodingBudget>,
    /// Prints, plans, tables of codes and queries of the history.
    pub files: HeavyWork,
    /// Camera pictures, which others must not delay.
    pub pictures: HeavyWork,
    pub trials: TrialCache,
}

impl ApiState {
    /// Serves the contents of a hub; everything else is unavailable.
    pub fn new(hub: Arc<Hub>, clock: Clock) -> Self {
        let file = CalibrationFile::default();
        let calibrator =
            Calibrator::new(hub.clone(), clock, BTreeMap::new(), Vec::new(), None, file);
        let calibrator = Arc::new(calibrator);
        let lenses = Arc::new(LensCalibrator::new(hub.clone(), Path::new("")));
        Self {
            hub,
            clock,
            calibrator,
            lenses,
            kinds: Vec::new(),
            fleets: Arc::default(),
            ports: Arc::default(),
            late_window_ms: 300.0,
            source_probe: None,
            camera_manager: None,
            access: Arc::default(),
            recorder: None,
            replay: None,
            history: None,
            cancel: CancellationToken::new(),
            limits: ApiLimits::default(),
            tls: Tls::default(),
            counters: ApiCounters::default(),
            encoder: SnapshotEncoder::default(),
            encoding_budget: Arc::default(),
            files: HeavyWork::new(half_of_the_processors(), FILE_BYTES),
            pictures: HeavyWork::new(half_of_the_processors(), PICTURE_BYTES),
            trials: TrialCache::default(),
        }
    }
}

/// Serves every API on `listener` until `state.cancel`, and then until the last client has left, at most for the grace
/// time.
///
/// On cancellation, streams end with UNAVAILABLE "server is shutting down", WebSockets with a close frame (1001), and no
/// connection is accepted any more.
pub async fn serve(listener: TcpListener, state: ApiState) {
    let api = Arc::new(state);
    let cors = cors::layer(api.access.origins());
    let (grpc_router, health) = grpc::router(&api);
    let http_router = http_router(api.clone());
    let readiness = tokio::spawn(metrics::report_readiness(api.clone(), health));
    let certificates = api.clone();
    let reload = tokio::spawn(async move { certificates.tls.follow_files().await });
    let body_timeout = api.limits.request_timeout;
    let access = api.access.clone();
    let dispatch = dispatch::Dispatch { grpc_router, http_router, access, cors, body_timeout };
    listener::run(listener, dispatch, api).await;
    // Its task watches the same token.
    let _ = readiness.await;
    reload.abort();
}

/// Everything except gRPC: the described paths, and the dashboard for all others.
pub fn http_router(api: Arc<ApiState>) -> Router {
    let (router, _) = openapi::described_routes().split_for_parts();
    router
        .fallback(dashboard::file)
        .method_not_allowed_fallback(async || ApiError::MethodNotAllowed)
        .layer(middleware::map_response_with_state(api.clone(), dashboard::with_security_headers))
        .layer(DefaultBodyLimit::max(MAX_REQUEST_BYTES))
        .with_state(api)
}
