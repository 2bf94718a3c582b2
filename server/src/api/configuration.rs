//! The configuration as a whole, over REST; the same functions answer gRPC.

use std::sync::Arc;

use axum::{
    Json,
    body::Bytes,
    extract::{State, rejection::BytesRejection},
    http::{HeaderMap, HeaderValue, header},
    response::{IntoResponse, Response},
};
use roundel_proto::v1;
use serde::de::DeserializeOwned;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    setup::{manager_if_allowed, run_blocking},
};
use crate::api::convert;

const TOML: &str = "application/toml";
const EXAMPLE: &str = r#"{"toml": "name = \"lab\"\n…"}, or the text itself as application/toml"#;

/// The configuration in force, as text and key by key.
#[utoipa::path(
    get, path = "/api/v1/configuration", tag = "configuration",
    responses(
        (status = 200, description = "the configuration in force", body = v1::Configuration),
        (status = 409, description = "clients may not", body = ErrorBody),
    ),
)]
pub async fn show(State(api): State<Arc<ApiState>>) -> Result<Json<v1::Configuration>, ApiError> {
    in_force(&api).await.map(Json)
}

/// The configuration in force as it is written, comments included, but for user and password of sources.
///
/// The header `etag` has its version.
#[utoipa::path(
    get, path = "/api/v1/configuration.toml", tag = "configuration",
    responses(
        (status = 200, description = "the text", body = String, content_type = "application/toml"),
        (status = 409, description = "clients may not", body = ErrorBody),
    ),
)]
pub async fn text(State(api): State<Arc<ApiState>>) -> Result<Response, ApiError> {
    let v1::Configuration { toml, version, .. } = in_force(&api).await?;
    let version = HeaderValue::from_str(&format!("\"{version}\""));
    let version = version.map_err(|error| ApiError::Internal(error.to_string()))?;
    let headers = [(header::CONTENT_TYPE, HeaderValue::from_static(TOML)), (header::ETAG, version)];
    Ok((headers, toml).into_response())
}

/// Says what is wrong with a configuration, and what applying it would change; nothing is changed.
#[utoipa::path(
    post, path = "/api/v1/configuration/check", tag = "configuration",
    request_body(content(
        (v1::CheckConfigurationRequest = "application/json"),
        (String = "application/toml"),
    )),
    responses(
        (status = 200, description = "problems with their places, or what would change", body = v1::ConfigurationCheck),
        (status = 400, description = "the request is none", body = ErrorBody),
        (status = 409, description = "clients may not", body = ErrorBody),
    ),
)]
pub async fn check(
    State(api): State<Arc<ApiState>>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Json<v1::ConfigurationCheck>, ApiError> {
    let of_text = |toml| v1::CheckConfigurationRequest { toml };
    check_text(&api, request(&headers, body, of_text)?).await.map(Json)
}

/// Puts a configuration in the place of the one in force, in its file too, while all that is the same in both goes on.
///
/// Cameras, objects, `[detection]`, `[fusion]` but for `late_window_ms`, and `[limits]` but for `max_clients` can change;
/// what else differs takes a start of the server, and is refused. With `version`, or the header `if-match`, only the
/// configuration that it was made from is replaced.
#[utoipa::path(
    put, path = "/api/v1/configuration", tag = "configuration",
    request_body(content(
        (v1::ApplyConfigurationRequest = "application/json"),
        (String = "application/toml"),
    )),
    responses(
        (status = 200, description = "what has changed", body = v1::AppliedConfiguration),
        (status = 400, description = "names all that is wrong", body = ErrorBody),
        (status = 409, description = "needs a start of the server, was made from another version, cannot be written, a calibration runs, or clients may not", body = ErrorBody),
    ),
)]
pub async fn apply(
    State(api): State<Arc<ApiState>>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Json<v1::AppliedConfiguration>, ApiError> {
    let of_text = |toml| v1::ApplyConfigurationRequest { toml, version: String::new() };
    let mut request = request(&headers, body, of_text)?;
    if let Some(version) = headers.get(header::IF_MATCH).filter(|_| request.version.is_empty()) {
        let version = String::from_utf8_lossy(version.as_bytes());
        let version = version.trim().trim_matches('"');
        // Any there is.
        request.version = if version == "*" { String::new() } else { version.to_owned() };
    }
    apply_text(&api, request).await.map(Json)
}

pub(super) async fn in_force(api: &ApiState) -> Result<v1::Configuration, ApiError> {
    let camera_manager = manager_if_allowed(api)?;
    run_blocking(move || Ok(convert::configuration(camera_manager.configuration()?)?)).await
}

pub(super) async fn check_text(
    api: &ApiState,
    request: v1::CheckConfigurationRequest,
) -> Result<v1::ConfigurationCheck, ApiError> {
    let camera_manager = manager_if_allowed(api)?;
    run_blocking(move || Ok(convert::configuration_check(camera_manager.check(&request.toml))))
        .await
}

pub(super) async fn apply_text(
    api: &ApiState,
    request: v1::ApplyConfigurationRequest,
) -> Result<v1::AppliedConfiguration, ApiError> {
    let camera_manager = manager_if_allowed(api)?;
    run_blocking(move || {
        let (changes, kept) = camera_manager.apply(&request.toml, &request.version)?;
        let version = camera_manager.version();
        Ok(v1::AppliedConfiguration { changes, version, kept })
    })
    .await
}

/// A request, or the text alone.
fn request<T: DeserializeOwned>(
    headers: &HeaderMap,
    body: Result<Bytes, BytesRejection>,
    of_text: impl FnOnce(String) -> T,
) -> Result<T, ApiError> {
    let body = body.map_err(|error| ApiError::body_error(&error))?;
    let content_type = headers.get(header::CONTENT_TYPE).map_or(&b""[..], HeaderValue::as_bytes);
    let wrong = |found: String| ApiError::invalid("body", format!("JSON such as {EXAMPLE}"), found);
    if content_type.starts_with(TOML.as_bytes()) {
        let text = String::from_utf8(body.to_vec());
        return text.map(of_text).map_err(|error| wrong(error.to_string()));
    }
    serde_json::from_slice(&body).map_err(|error| wrong(error.to_string()))
}
