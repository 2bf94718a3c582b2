//! Reads, checks and applies the configuration as a whole.

use axum::{
    Json,
    body::Bytes,
    extract::{State, rejection::BytesRejection},
    http::{HeaderMap, HeaderValue, header},
    response::{IntoResponse, Response},
};
use roundel_core::{
    id::KindId,
    marker::{Kind, Pattern},
    world::MotionClass,
};
use roundel_proto::v1;
use serde::de::DeserializeOwned;

use super::{
    convert::{pixels as count, quaternion, vector},
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, blocking, body_error, wrong_json},
    setup::manager_if_allowed,
};
use crate::{
    fusion::camera_manager::{ActiveConfig, ApplyPlan},
    model::config::{
        Config, MODES, POLARITIES, Problem, ReferenceConfig,
        edit::{EditError, read_all},
        word,
    },
};

const TOML: &str = "application/toml";
const JSON: &str = "application/json";
const EXAMPLE: &str = r#"{"toml": "name = \"lab\"\n…"}, or the text itself as application/toml"#;

/// The active configuration, as text and key by key.
#[utoipa::path(
    get, path = "/api/v1/configuration", tag = "configuration",
    responses(
        (status = 200, description = "the active configuration", body = v1::Configuration),
        (status = 409, description = "clients must not read the configuration", body = ErrorBody),
    ),
)]
pub async fn show(State(api): Api) -> Answer<v1::Configuration> {
    let manager = manager_if_allowed(&api)?;
    blocking(move || manager.configuration().and_then(|active| Ok(message(active)?)))
        .await
        .map(Json)
}

/// The text of the active configuration with its comments, without user and password of sources.
///
/// The header `etag` has its version.
#[utoipa::path(
    get, path = "/api/v1/configuration.toml", tag = "configuration",
    responses(
        (status = 200, description = "the text", body = String, content_type = "application/toml"),
        (status = 409, description = "clients must not read the configuration", body = ErrorBody),
    ),
)]
pub async fn text(api: Api) -> Result<Response, ApiError> {
    let Json(v1::Configuration { toml, version, .. }) = show(api).await?;
    let version = HeaderValue::from_str(&format!("\"{version}\""));
    let version = version.map_err(|error| ApiError::Internal(error.to_string()))?;
    let headers = [(header::CONTENT_TYPE, HeaderValue::from_static(TOML)), (header::ETAG, version)];
    Ok((headers, toml).into_response())
}

/// Reports the problems of a configuration, or what applying it would change, without applying it.
#[utoipa::path(
    post, path = "/api/v1/configuration/check", tag = "configuration",
    request_body(content(
        (v1::CheckConfigurationRequest = "application/json"),
        (String = "application/toml"),
    )),
    responses(
        (status = 200, description = "problems with their locations, or what would change", body = v1::ConfigurationCheck),
        (status = 400, description = "the request is malformed", body = ErrorBody),
        (status = 409, description = "clients must not read the configuration", body = ErrorBody),
        (status = 415, description = "another content type", body = ErrorBody),
    ),
)]
pub async fn check(
    api: Api,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Answer<v1::ConfigurationCheck> {
    let of_text = |toml| v1::CheckConfigurationRequest { toml };
    check_text(api, request(&headers, body, of_text)?).await
}

/// Replaces the active configuration and its file. Whatever is equal in both keeps running.
///
/// Cameras, objects, `[detection]`, `[fusion]` except `late_window_ms`, and `[limits]` except the numbers of connections
/// can change. Any other difference requires a restart of the server and is rejected. With `version`, or the header
/// `if-match`, only that version of the configuration is replaced.
#[utoipa::path(
    put, path = "/api/v1/configuration", tag = "configuration",
    request_body(content(
        (v1::ApplyConfigurationRequest = "application/json"),
        (String = "application/toml"),
    )),
    responses(
        (status = 200, description = "the changes", body = v1::AppliedConfiguration),
        (status = 400, description = "lists every problem", body = ErrorBody),
        (status = 409, description = "it requires a restart of the server, replaces another version, or cannot be written, a calibration is running, or clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn apply(
    api: Api,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Answer<v1::AppliedConfiguration> {
    let of_text = |toml| v1::ApplyConfigurationRequest { toml, version: String::new() };
    let mut request = request(&headers, body, of_text)?;
    if let Some(version) = headers.get(header::IF_MATCH).filter(|_| request.version.is_empty()) {
        let version = String::from_utf8_lossy(version.as_bytes());
        let version = version.trim().trim_matches('"');
        // `*` matches any version.
        request.version = if version == "*" { String::new() } else { version.to_owned() };
    }
    apply_text(api, request).await
}

pub(super) async fn check_text(
    State(api): Api,
    request: v1::CheckConfigurationRequest,
) -> Answer<v1::ConfigurationCheck> {
    let manager = manager_if_allowed(&api)?;
    let check = move || Ok::<_, ApiError>(check_message(manager.check(&request.toml)));
    blocking(check).await.map(Json)
}

pub(super) async fn apply_text(
    State(api): Api,
    request: v1::ApplyConfigurationRequest,
) -> Answer<v1::AppliedConfiguration> {
    let manager = manager_if_allowed(&api)?;
    let apply = move || {
        let (changes, kept) = manager.apply(&request.toml, &request.version)?;
        Ok::<_, ApiError>(v1::AppliedConfiguration { changes, version: manager.version(), kept })
    };
    blocking(apply).await.map(Json)
}

/// A request as JSON, or its text alone.
fn request<T: DeserializeOwned>(
    headers: &HeaderMap,
    body: Result<Bytes, BytesRejection>,
    of_text: impl FnOnce(String) -> T,
) -> Result<T, ApiError> {
    let body = body.map_err(|error| body_error(&error))?;
    let content_type = headers.get(header::CONTENT_TYPE).map_or(&b""[..], HeaderValue::as_bytes);
    if content_type.starts_with(TOML.as_bytes()) {
        let text = String::from_utf8(body.to_vec());
        return text.map(of_text).map_err(|error| wrong_json(EXAMPLE, error));
    }
    if !content_type.starts_with(JSON.as_bytes()) {
        return Err(ApiError::UnsupportedMediaType("application/json or application/toml"));
    }
    serde_json::from_slice(&body).map_err(|error| wrong_json(EXAMPLE, error))
}

fn message(active: ActiveConfig) -> Result<v1::Configuration, EditError> {
    let ActiveConfig { text, config } = active;
    let (cameras, objects) = (read_all(&text)?, read_all(&text)?);
    let motion = |index: usize| config.motions.get(index).copied().unwrap_or_default();
    let tolerance = |index: usize| config.tolerances.get(index).copied().unwrap_or(0.0);
    let kinds = config.kinds.iter().enumerate();
    let calibration = config.server.calibration.as_ref();
    let millis = |seconds: f64| (seconds * 1e9).round() * 1e-6;
    Ok(v1::Configuration {
        toml: text,
        version: config.file.version(),
        kept: config.file.kept(),
        name: config.name.clone(),
        cameras,
        objects,
        roundels: kinds
            .map(|(index, kind)| roundel(kind, motion(index), tolerance(index)))
            .collect(),
        references: config.references.iter().map(|it| reference(it, &config)).collect(),
        server: Some(v1::ServerSetup {
            listen: config.server.listen.to_string(),
            snapshot_rate_hz: config.server.snapshot_rate_hz,
            calibration: calibration.map(|it| it.display().to_string()).unwrap_or_default(),
            watch: config.server.monitors_cameras,
            setup: config.server.setup,
            allow_origins: config.server.allow_origins.clone(),
            prompt: config.server.publishes_per_frame,
        }),
        detection: Some(v1::DetectionSetup {
            mode: word(&MODES, config.mode).to_owned(),
            time_budget: config.time_budget,
        }),
        fusion: Some(v1::FusionSetup {
            acceleration_m_s2: config.fusion.acceleration_m_s2,
            focal_deviation: config.fusion.focal_deviation,
            late_window_ms: millis(config.fusion.late_window_s),
            predicted_after_ms: millis(config.fusion.predicted_after_s),
            lost_after_ms: millis(config.fusion.lost_after_s),
        }),
        limits: Some(v1::LimitsSetup {
            max_objects: count(config.limits.max_objects),
            max_roundels_per_camera: count(config.limits.max_roundels_per_camera),
            max_clients: count(config.limits.max_clients),
            max_connections_per_peer: count(config.limits.max_connections_per_peer),
        }),
    })
}

fn check_message(checked: Result<ApplyPlan, Vec<Problem>>) -> v1::ConfigurationCheck {
    match checked {
        Ok(ApplyPlan { changes, needs_restart }) => {
            v1::ConfigurationCheck { problems: Vec::new(), changes, needs_restart }
        }
        Err(problems) => v1::ConfigurationCheck {
            problems: problems.into_iter().map(problem).collect(),
            ..v1::ConfigurationCheck::default()
        },
    }
}

fn problem(problem: Problem) -> v1::ConfigurationProblem {
    let Problem { message, help, place } = problem;
    let (line, column, width) =
        place.as_ref().map_or((0, 0, 0), |place| (place.line, place.column, place.width));
    v1::ConfigurationProblem {
        message,
        help: help.unwrap_or_default(),
        line: count(line),
        column: count(column),
        text: place.map(|place| place.text).unwrap_or_default(),
        width: count(width),
    }
}

fn roundel(kind: &Kind, motion: MotionClass, tolerance: f64) -> v1::RoundelSetup {
    let mm = |metres: f64| (metres * 1e9).round() * 1e-6;
    let (layout, minor_m) = match kind.pattern {
        Pattern::Plain => (None, None),
        Pattern::Coded(layout) => (Some(layout), None),
        Pattern::Elliptical { minor_diameter_m } => (None, Some(minor_diameter_m)),
    };
    let (motion, height_m) = match motion {
        MotionClass::Free => ("free", None),
        MotionClass::Ground { height_m } => ("ground", height_m),
    };
    v1::RoundelSetup {
        name: kind.name.clone(),
        outer_mm: mm(kind.outer_diameter_m),
        inner_mm: mm(kind.inner_diameter_m),
        inner_minor_mm: minor_m.map(mm),
        code_bits: layout.map(|layout| u32::from(layout.bits)),
        code_min_distance: layout.map(|layout| u32::from(layout.min_distance)),
        polarity: word(&POLARITIES, kind.polarity).to_owned(),
        motion: motion.to_owned(),
        height_m,
        tolerance,
    }
}

fn reference(reference: &ReferenceConfig, config: &Config) -> v1::ReferenceSetup {
    let KindId(kind) = reference.kind;
    let kind = config.kinds.get(usize::from(kind));
    v1::ReferenceSetup {
        roundel: kind.map(|kind| kind.name.clone()).unwrap_or_default(),
        code: reference.code.map(|code| code.number.into()),
        position_m: Some(vector(&reference.position_m)),
        uncertainty_mm: (reference.deviation_m * 1e9).round() * 1e-6,
        orientation: reference.orientation.as_ref().map(quaternion),
    }
}
