//! Access of web pages from other origins.
//!
//! Browsers send the origin of a page in a header, also with simple requests and WebSocket handshakes, which they send for
//! any page. Requests with an origin that is not allowed are rejected, and so are those that a browser says another site makes. For allowed origins, responses have the headers that
//! let pages read them. Other programs send no origin and are not restricted.

use std::time::Duration;

use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, header};
use tower_http::cors::{AllowHeaders, AllowOrigin, CorsLayer};

use super::error::ApiError;

/// Time for which browsers may cache a preflight.
const PREFLIGHT_MAX_AGE: Duration = Duration::from_secs(600);
/// Response headers that pages may read in addition to the common ones.
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

/// Origins whose pages may send requests, in addition to the server's own; `*` allows any.
#[derive(Clone, Debug, Default)]
pub struct AllowedOrigins(pub Vec<String>);

impl AllowedOrigins {
    /// Whether only the server's own pages are allowed.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Rejects a request of a page whose origin is not allowed.
    pub(super) fn check(
        &self,
        headers: &HeaderMap,
        own_host: Option<&str>,
    ) -> Result<(), ApiError> {
        let Some(origin) = headers.get(header::ORIGIN) else {
            return self.check_embedding(headers);
        };
        let origin = String::from_utf8_lossy(origin.as_bytes()).to_ascii_lowercase();
        // The server's own pages have the host of this request as their origin, with any scheme: a proxy may add TLS.
        let host = origin.split_once("://").map(|(_, host)| host);
        let is_own = host.zip(own_host).is_some_and(|(host, own)| own.eq_ignore_ascii_case(host));
        if is_own || self.0.iter().any(|allowed| allowed == "*" || *allowed == origin) {
            return Ok(());
        }
        Err(ApiError::PermissionDenied(format!(
            "pages of {} must not use this server: add the origin to [server] allow_origins in its configuration",
            origin.escape_debug()
        )))
    }

    /// Rejects a request that another site's page makes without an origin, such as for a picture. Browsers describe it to
    /// servers on loopback and with TLS.
    fn check_embedding(&self, headers: &HeaderMap) -> Result<(), ApiError> {
        let is = |name: &str, value: &str| headers.get(name).is_some_and(|found| found == value);
        let is_foreign = is("sec-fetch-site", "cross-site") || is("sec-fetch-site", "same-site");
        if !is_foreign || is("sec-fetch-mode", "navigate") || !self.is_empty() {
            return Ok(());
        }
        Err(ApiError::PermissionDenied(
            "pages of other origins must not use this server: add the origin to [server] allow_origins in its configuration"
                .to_owned(),
        ))
    }
}

/// `None` if no other origin is allowed.
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
    // gRPC-Web libraries send headers of their own.
    let layer = layer.allow_headers(AllowHeaders::mirror_request()).expose_headers(exposed);
    Some(layer.max_age(PREFLIGHT_MAX_AGE).vary([header::ORIGIN]))
}
