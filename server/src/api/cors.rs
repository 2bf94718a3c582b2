//! Pages of other servers: whether they may ask this one.
//!
//! Over REST and gRPC-Web browsers ask first (a preflight) and keep answers from pages whose origin is not allowed.
//! WebSockets they open for any page, and say which origin it is of; what is not allowed is refused here. Programs other
//! than browsers name no origin, and are not restricted.

use std::time::Duration;

use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, header};
use tower_http::cors::{AllowHeaders, AllowOrigin, CorsLayer};

use super::error::ApiError;

/// How long a browser may remember that it may ask.
const PREFLIGHT_MAX_AGE: Duration = Duration::from_secs(600);
/// Headers of answers that pages may read beside the common ones: gRPC's, and those of REST.
const EXPOSED_HEADERS: [&str; 6] = [
    "grpc-status",
    "grpc-message",
    "grpc-status-details-bin",
    "grpc-encoding",
    "roundel-capture-time-ns",
    "etag",
];
const METHODS: [Method; 5] =
    [Method::GET, Method::POST, Method::PUT, Method::PATCH, Method::DELETE];

/// Whose pages may open WebSockets.
#[derive(Clone, Debug, Default)]
pub struct AllowedOrigins(Vec<String>);

impl AllowedOrigins {
    /// These, and the server's own; `*` stands for any.
    pub fn new(origins: Vec<String>) -> Self {
        Self(origins)
    }

    /// Refuses the page of another origin that has sent these headers.
    pub(super) fn check(&self, headers: &HeaderMap) -> Result<(), ApiError> {
        let Some(origin) = headers.get(header::ORIGIN) else { return Ok(()) };
        let origin = String::from_utf8_lossy(origin.as_bytes()).to_ascii_lowercase();
        // A page of this server was asked for under the name that the WebSocket is asked for: whatever that is, and
        // whether somebody before this server speaks TLS.
        let own = headers.get(header::HOST).and_then(|host| host.to_str().ok());
        let host = origin.split_once("://").map(|(_, host)| host);
        let is_own = host.zip(own).is_some_and(|(host, own)| own.eq_ignore_ascii_case(host));
        if is_own || self.0.iter().any(|allowed| allowed == "*" || *allowed == origin) {
            return Ok(());
        }
        Err(ApiError::PermissionDenied(format!(
            "pages of {origin} may not ask this server: [server] allow_origins in its configuration says whose may"
        )))
    }
}

/// What pages of these origins may; `None`: of none. `*` stands for any origin.
pub(super) fn layer(AllowedOrigins(origins): &AllowedOrigins) -> Option<CorsLayer> {
    if origins.is_empty() {
        return None;
    }
    let origins = if origins.iter().any(|origin| origin == "*") {
        AllowOrigin::any()
    } else {
        AllowOrigin::list(origins.iter().filter_map(|it| HeaderValue::from_str(it).ok()))
    };
    let exposed = EXPOSED_HEADERS.map(HeaderName::from_static);
    let layer = CorsLayer::new().allow_origin(origins).allow_methods(METHODS);
    // Whatever gRPC-Web's libraries send; nothing here follows from a header but the forms of bodies.
    let layer = layer.allow_headers(AllowHeaders::mirror_request()).expose_headers(exposed);
    Some(layer.max_age(PREFLIGHT_MAX_AGE).vary([header::ORIGIN]))
}
