//! Paths and queries of `GET` requests.

use std::{sync::LazyLock, time::Duration};

use axum::{Router, body::Body, http::Request};
use http_body_util::{BodyExt as _, Limited};
use roundel_server::{
    api::{self, ApiState},
    archive::history::History,
    model::config::HistoryConfig,
};
use tempfile::TempDir;
use tokio::{runtime::Runtime, time::timeout};
use tower::ServiceExt as _;

use super::lab;

/// Prints and plans may take longer; they stop with their client.
const PATIENCE: Duration = Duration::from_secs(1);
const MAX_ANSWER_BYTES: usize = 64 << 20;

struct Lab {
    runtime: Runtime,
    router: Router,
    _folder: TempDir,
}

static LAB: LazyLock<Lab> = LazyLock::new(|| {
    let (runtime, folder) = (lab::runtime(), tempfile::tempdir().unwrap());
    let mut api = lab::api();
    let file = folder.path().join("history.sqlite");
    let history = HistoryConfig { file, keep: Duration::from_secs(3600) };
    let history = History::start(history, api.hub.clone(), api.clock);
    api = ApiState { history: Some(history.into()), ..api };
    Lab { runtime, router: api::http_router(api.into()), _folder: folder }
});

/// Every request is answered without blaming the server, and an error is one of the API's.
pub fn run(data: &[u8]) {
    let Lab { runtime, router, .. } = &*LAB;
    let Ok(request) = Request::get(format!("/api/v1/{}", encoded(data))).body(Body::empty()) else {
        return;
    };
    let answer = async {
        let response = router.clone().oneshot(request).await.unwrap();
        let status = response.status();
        let body = Limited::new(response.into_body(), MAX_ANSWER_BYTES).collect().await;
        let body = body.unwrap_or_else(|error| panic!("{status}: {error}")).to_bytes();
        assert!(status.as_u16() != 500, "{}", String::from_utf8_lossy(&body));
        if status.is_client_error() || status.is_server_error() {
            let error: serde_json::Value = serde_json::from_slice(&body).unwrap();
            let message = error["error"]["message"].as_str().unwrap();
            assert!(!message.is_empty() && message.len() <= 20 * data.len() + 4096, "{message}");
        }
    };
    // Without an answer in time, the client goes.
    let _ = runtime.block_on(async { timeout(PATIENCE, answer).await });
}

/// Percent-encodes bytes that no request line has.
fn encoded(data: &[u8]) -> String {
    let each = data.iter().map(|&byte| match byte {
        b'#' | b'"' | b'<' | b'>' => format!("%{byte:02x}"),
        byte if byte.is_ascii_graphic() => char::from(byte).to_string(),
        byte => format!("%{byte:02x}"),
    });
    each.collect()
}
