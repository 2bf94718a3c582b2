//! gRPC, REST, WebSocket, metrics and the dashboard, on one port.
//!
//! In: the [`Hub`], read only (but for the wish for a picture), and the [`Calibrator`]. Out: bytes on sockets. Requests
//! whose content type is `application/grpc…` go to tonic, all others to axum; both speak HTTP/1.1
//! or HTTP/2 without TLS, as the client likes.
//!
//! | module | what it does |
//! | --- | --- |
//! | `listener` | accepts connections, limits them, disconnects stalled clients, shuts down |
//! | `dispatch` | hands requests to tonic or axum |
//! | [`grpc`] | the service of `proto/roundel/v1/roundel.proto` |
//! | [`push`] | the service of `push.proto`: remote programs feed cameras |
//! | [`rest`], [`calibration`], [`recording`], [`replay`], [`history`], [`openapi`] | `/api/v1/…` and its description |
//! | [`setup`], [`objects`], [`configuration`] | cameras and objects that are added, changed and removed, and all of it |
//! | [`print`] | roundels as files to print |
//! | [`lens`] | the lens of a camera, while the board is moved before it |
//! | [`plan`] | what the cameras would make of roundels all over the arena |
//! | [`simulation`] | simulated robots that clients drive |
//! | [`source_probe`] | one try of a source |
//! | [`ws`] | `/api/v1/stream` |
//! | [`metrics`] | `/metrics`, `/healthz`, `/readyz` |
//! | [`dashboard`] | the dashboard's files |
//! | [`snapshot_encoder`] | snapshots as bytes, once for all who want the same |
//! | [`selection`], [`snapshot_subscription`] | which snapshots a subscriber gets, and what is in them |
//! | `region` | a box of the world that a client asks for |
//! | [`picture`] | a frame with its detections drawn in, as JPEG |
//! | `deadline` | calls that end when their client gives up |
//! | `cors` | pages of other servers |
//! | [`error`] | what can be wrong, and how each protocol says so |
//!
//! No client can hold up another one or the server: a subscriber holds a handle on the newest
//! snapshot and not a queue, sockets take little more than one message ahead, and a client that does not read at all is
//! disconnected.

pub mod calibration;
pub mod configuration;
pub(crate) mod convert;
mod cors;
pub mod dashboard;
mod deadline;
mod dispatch;
pub mod error;
pub mod grpc;
pub mod history;
pub mod lens;
mod listener;
pub mod metrics;
pub mod objects;
mod observation_subscription;
pub mod openapi;
mod path;
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
pub mod ws;

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{Arc, atomic::AtomicU64},
    time::Duration,
};

use axum::{Router, extract::DefaultBodyLimit, middleware};
use roundel_core::{marker::Kind, plan::Trials};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub use self::cors::AllowedOrigins;
use self::{error::ApiError, snapshot_encoder::SnapshotEncoder};
use crate::{
    archive::{history::History, record::Recorder, replay::Replay},
    capture::{
        source::{fleet::Fleets, push::PushEndpoints},
        source_probe::SourceProbe,
    },
    fusion::{
        calibration::{Calibrator, CalibratorParts, file::CalibrationFile},
        camera_manager::CameraManager,
    },
    lab::lens::LensCalibrator,
    model::{clock::Clock, hub::Hub},
};

/// Largest request, by whichever protocol; of pushed frames see [`push`].
const MAX_REQUEST_BYTES: usize = 256 * 1024;

#[derive(Clone, Copy, Debug)]
pub struct ApiLimits {
    /// Open connections; further ones are refused with an error that says so.
    pub max_clients: usize,
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
            grace: Duration::from_secs(2),
            send_timeout: Duration::from_secs(10),
            request_timeout: Duration::from_secs(15),
        }
    }
}

#[derive(Debug, Default)]
pub struct ApiCounters {
    pub connections: AtomicU64,
    /// Connections refused because of the limit.
    pub connections_refused: AtomicU64,
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
    /// `None`: clients may not try sources.
    pub source_probe: Option<Arc<SourceProbe>>,
    /// `None`: clients may not change the set-up.
    pub camera_manager: Option<Arc<CameraManager>>,
    /// Origins whose pages may send requests; `*` is any.
    pub allowed_origins: AllowedOrigins,
    pub recorder: Option<Arc<Recorder>>,
    /// The recording that is played; `None`: everything is live.
    pub replay: Option<Replay>,
    pub history: Option<Arc<History>>,
    pub cancel: CancellationToken,
    pub limits: ApiLimits,
    pub counters: ApiCounters,
    pub encoder: SnapshotEncoder,
    pub trials: Trials,
}

impl ApiState {
    /// Serves the contents of a hub; everything else is unavailable.
    pub fn new(hub: Arc<Hub>, clock: Clock) -> Self {
        let calibrator = Arc::new(Calibrator::new(CalibratorParts {
            hub: hub.clone(),
            clock,
            cameras: BTreeMap::new(),
            landmarks: Vec::new(),
            path: None,
            file: CalibrationFile::default(),
        }));
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
            allowed_origins: AllowedOrigins::default(),
            recorder: None,
            replay: None,
            history: None,
            cancel: CancellationToken::new(),
            limits: ApiLimits::default(),
            counters: ApiCounters::default(),
            encoder: SnapshotEncoder::default(),
            trials: Trials::default(),
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
    let cors = cors::layer(&api.allowed_origins);
    let (grpc_router, health) = grpc::router(&api);
    let http_router = http_router(api.clone());
    let readiness = tokio::spawn(metrics::report_readiness(api.clone(), health));
    let body_timeout = api.limits.request_timeout;
    let dispatch = dispatch::Dispatch { grpc_router, http_router, cors, body_timeout };
    listener::run(listener, dispatch, api).await;
    // It watches the same token, so it has ended.
    let _ = readiness.await;
}

/// Everything that is not gRPC: the described paths, and the dashboard for what is left.
fn http_router(api: Arc<ApiState>) -> Router {
    let (router, _) = openapi::described_routes().split_for_parts();
    router
        .fallback(dashboard::file)
        .method_not_allowed_fallback(async || ApiError::MethodNotAllowed)
        .layer(middleware::map_response(dashboard::with_security_headers))
        .layer(DefaultBodyLimit::max(MAX_REQUEST_BYTES))
        .with_state(api)
}
