//! Pages of other servers: whether a browser lets them ask this one, over REST and gRPC-Web.
//!
//! Browsers ask first (a preflight) and keep answers from pages whose origin is not allowed. WebSockets they do not
//! restrict, and programs other than browsers never.

use std::time::Duration;

use axum::http::{HeaderName, HeaderValue, Method, header};
use tower_http::cors::{AllowHeaders, AllowOrigin, CorsLayer};

/// How long a browser may remember that it may ask.
const REMEMBERED: Duration = Duration::from_secs(600);
/// Headers of answers that pages may read beside the common ones: gRPC's, and those of REST.
const EXPOSED: [&str; 6] = [
    "grpc-status",
    "grpc-message",
    "grpc-status-details-bin",
    "grpc-encoding",
    "roundel-capture-time-ns",
    "etag",
];
const METHODS: [Method; 5] =
    [Method::GET, Method::POST, Method::PUT, Method::PATCH, Method::DELETE];

/// What pages of these origins may; `None`: of none. `*` stands for any origin.
pub(super) fn layer(origins: &[String]) -> Option<CorsLayer> {
    if origins.is_empty() {
        return None;
    }
    let origins = if origins.iter().any(|origin| origin == "*") {
        AllowOrigin::any()
    } else {
        AllowOrigin::list(origins.iter().filter_map(|it| HeaderValue::from_str(it).ok()))
    };
    let exposed = EXPOSED.map(HeaderName::from_static);
    let layer = CorsLayer::new().allow_origin(origins).allow_methods(METHODS);
    // Whatever gRPC-Web's libraries send; nothing here follows from a header but the forms of bodies.
    let layer = layer.allow_headers(AllowHeaders::mirror_request()).expose_headers(exposed);
    Some(layer.max_age(REMEMBERED).vary([header::ORIGIN]))
}
