//! `/metrics` for Prometheus, and `/healthz` and `/readyz` for whoever restarts the server.
//!
//! The numbers are read from the hub when they are asked for, so that they cost nothing otherwise; those of
//! cameras by `camera`.

mod camera;
mod recording;

use std::{
    fmt::Write,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use roundel_core::{
    id::CameraId,
    world::{FusionCounts, LifeStage},
};
use roundel_proto::v1::roundel_server;
use serde::Serialize;
use tokio::time::sleep;
use tonic::server::NamedService;
use tonic_health::{ServingStatus, server::HealthReporter};
use utoipa::ToSchema;

use super::{ApiState, grpc};
use crate::model::hub::{CameraState, CameraStatus};

/// A snapshot older than this, or than this many periods, means that fusion does not publish.
const STALE_SECONDS: f64 = 1.0;
const STALE_PERIODS: f64 = 5.0;
/// How often the readiness is looked at for gRPC's health service.
const READINESS_INTERVAL: Duration = Duration::from_millis(250);

/// The name under which the service's health is known.
const SERVICE_NAME: &str = <roundel_server::RoundelServer<grpc::Service> as NamedService>::NAME;

/// The answer of `/healthz` and `/readyz`.
#[derive(Debug, Serialize, ToSchema)]
pub struct Health {
    /// `ok`, or `unavailable`.
    pub status: &'static str,
    /// What is missing, one sentence each.
    pub missing: Vec<String>,
}

/// Whether the process works.
#[utoipa::path(
    get, path = "/healthz", tag = "server",
    responses((status = 200, description = "it does", body = Health)),
)]
pub async fn health() -> Json<Health> {
    Json(Health { status: "ok", missing: Vec::new() })
}

/// Whether clients get poses: fusion publishes, and at least one camera runs.
#[utoipa::path(
    get, path = "/readyz", tag = "server",
    responses(
        (status = 200, description = "they do", body = Health),
        (status = 503, description = "says what is missing", body = Health),
    ),
)]
pub async fn readiness(State(api): State<Arc<ApiState>>) -> Response {
    let missing = missing(&api);
    if missing.is_empty() {
        Json(Health { status: "ok", missing }).into_response()
    } else {
        let body = Json(Health { status: "unavailable", missing });
        (StatusCode::SERVICE_UNAVAILABLE, body).into_response()
    }
}

/// What keeps clients from getting poses; empty when they do.
fn missing(api: &ApiState) -> Vec<String> {
    let mut missing = Vec::new();
    if api.cancel.is_cancelled() {
        missing.push(super::error::SHUTTING_DOWN.to_owned());
    }
    let installation = api.hub.installation();
    let fused = api.hub.snapshots().borrow().clone();
    if fused.sequence == 0 {
        missing.push("fusion has not published a snapshot yet".to_owned());
    } else {
        let age_s = api.clock.now().seconds_since(fused.fused_time);
        let allowed_s = STALE_SECONDS.max(STALE_PERIODS / installation.snapshot_rate_hz);
        if age_s > allowed_s {
            missing.push(format!("fusion's newest snapshot is {age_s:.1} s old"));
        }
    }
    let cameras = api.hub.cameras();
    if cameras.is_empty() {
        missing.push("the configuration names no camera".to_owned());
    } else if !cameras.values().any(|camera| camera.status == CameraStatus::Running) {
        let shown = |(id, state): (&CameraId, &CameraState)| {
            format!("{} is {}", installation.camera_name(*id), status_word(state.status))
        };
        let states: Vec<String> = cameras.iter().map(shown).collect();
        missing.push(format!("no camera runs: {}", states.join(", ")));
    }
    missing
}

/// Tells gRPC's health service about the readiness, until the server goes down.
pub async fn report_readiness(api: Arc<ApiState>, reporter: HealthReporter) {
    loop {
        let is_ready = missing(&api).is_empty();
        let status = if is_ready { ServingStatus::Serving } else { ServingStatus::NotServing };
        reporter.set_service_status(SERVICE_NAME, status).await;
        if api.cancel.is_cancelled() {
            reporter.set_service_status("", ServingStatus::NotServing).await;
            return;
        }
        tokio::select! {
            () = sleep(READINESS_INTERVAL) => {}
            () = api.cancel.cancelled() => {}
        }
    }
}

/// Every number of the server, as Prometheus reads it.
#[utoipa::path(
    get, path = "/metrics", tag = "server",
    responses((status = 200, description = "Prometheus' text format", body = String, content_type = "text/plain")),
)]
pub async fn metrics(State(api): State<Arc<ApiState>>) -> Response {
    let mut page = MetricsText::default();
    write_server(&mut page, &api);
    camera::write_cameras(&mut page, &api.hub.installation(), &api.hub.cameras());
    write_fusion(&mut page, &api);
    write_clients(&mut page, &api);
    if let Some(recorder) = &api.recorder {
        recording::write_recording(&mut page, &recorder.status());
    }
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], page.text)
        .into_response()
}

fn write_server(page: &mut MetricsText, api: &ApiState) {
    let installation = api.hub.installation();
    page.family("roundel_info", "gauge", "Always 1; its labels name the server.");
    let labels = [
        ("version", env!("CARGO_PKG_VERSION")),
        ("name", &installation.name),
        ("source_id", &installation.source_id),
    ];
    page.sample("roundel_info", &labels, 1.0);
    let start_s = installation.started.as_ns() as f64 * 1e-9;
    page.single("roundel_start_time_seconds", "gauge", "Start of the server, Unix time.", start_s);
    let ready = f64::from(u8::from(missing(api).is_empty()));
    page.single("roundel_ready", "gauge", "1 while /readyz says yes.", ready);
    let cameras = installation.cameras.len() as f64;
    page.single("roundel_cameras", "gauge", "Cameras that are configured now.", cameras);
    let name = "roundel_camera_changes_total";
    page.family(name, "counter", "Cameras that were set up anew while the server runs.");
    for (change, count) in
        ["added", "changed", "removed"].into_iter().zip(api.hub.camera_change_counts())
    {
        page.sample(name, &[("change", change)], count as f64);
    }
}

fn write_fusion(page: &mut MetricsText, api: &ApiState) {
    write_fusion_counts(page, &api.hub.fusion_counts());
    let fused = api.hub.snapshots().borrow().clone();
    let help = "Snapshots that fusion made.";
    page.single("roundel_snapshots_total", "counter", help, fused.sequence as f64);
    if fused.sequence > 0 {
        let age_s = api.clock.now().seconds_since(fused.fused_time);
        page.single("roundel_snapshot_age_seconds", "gauge", "Age of the newest snapshot.", age_s);
    }
    page.family("roundel_objects", "gauge", "Objects by life stage; lost ones of the last minute.");
    let records = api.hub.objects();
    for (stage, word) in [
        (LifeStage::Tentative, "tentative"),
        (LifeStage::Tracked, "tracked"),
        (LifeStage::Predicted, "predicted"),
        (LifeStage::Lost, "lost"),
    ] {
        let count = records.iter().filter(|record| record.stage == stage).count();
        page.sample("roundel_objects", &[("stage", word)], count as f64);
    }
}

fn write_fusion_counts(page: &mut MetricsText, counts: &FusionCounts) {
    let taken = counts
        .frames
        .saturating_sub(counts.duplicate_frames + counts.late_frames + counts.jumped_frames);
    let name = "roundel_fusion_frames_total";
    page.family(name, "counter", "Frames handed to fusion, by what became of them.");
    for (outcome, count) in [
        ("taken", taken),
        ("duplicate", counts.duplicate_frames),
        ("late", counts.late_frames),
        ("jumped", counts.jumped_frames),
    ] {
        page.sample(name, &[("outcome", outcome)], count as f64);
    }
    write_detection_outcomes(page, counts);
    write_fusion_events(page, counts);
}

/// What became of detections: each counts once, so that all of them add up.
fn write_detection_outcomes(page: &mut MetricsText, counts: &FusionCounts) {
    // What carries a camera being out of sight is counted by itself.
    let unknown_place =
        counts.no_camera_pose.saturating_sub(counts.carrier_unseen + counts.carrier_unturned);
    let name = "roundel_fusion_detections_total";
    page.family(name, "counter", "Detections handed to fusion, by what became of them.");
    for (outcome, count) in [
        ("used", counts.used),
        ("late", counts.late),
        ("duplicate", counts.duplicate),
        ("jumped", counts.jumped),
        ("no_camera_pose", unknown_place),
        ("carrier_unseen", counts.carrier_unseen),
        ("carrier_unturned", counts.carrier_unturned),
        ("of_landmark", counts.of_landmarks),
        ("of_carrier", counts.of_carriers),
        ("no_pose", counts.no_pose),
        ("invalid", counts.invalid),
        ("contradicted", counts.contradicted),
        ("over_max_objects", counts.over_max_objects),
        ("joined", counts.joined),
        ("left_out", counts.left_out),
        ("held_back", counts.held),
    ] {
        page.sample(name, &[("outcome", outcome)], count as f64);
    }
}

fn write_fusion_events(page: &mut MetricsText, counts: &FusionCounts) {
    for (name, help, count) in [
        (
            "roundel_fusion_missing_frames_total",
            "Frames that never came, by their cameras' numbers and regular intervals.",
            counts.missing_frames,
        ),
        (
            "roundel_fusion_out_of_order_total",
            "Detections used that came after newer ones of their object.",
            counts.out_of_order,
        ),
        (
            "roundel_fusion_gated_total",
            "Detections outside the gate of the object that their camera took them for: contradicted, or used for another.",
            counts.gated,
        ),
        (
            "roundel_fusion_held_frames_total",
            "Frames not used since their camera seemed to have moved all of a sudden.",
            counts.held_frames,
        ),
        (
            "roundel_fusion_taken_back_total",
            "Detections taken out of tracks again, since their camera had moved.",
            counts.taken_back,
        ),
        ("roundel_fusion_tracks_begun_total", "Detections that began a track.", counts.begun),
        ("roundel_fusion_tracks_merged_total", "Tracks joined with another one.", counts.merged),
        (
            "roundel_fusion_clock_steps_total",
            "Times that a camera's clock was found to have been set, or to be of another epoch.",
            counts.clock_steps,
        ),
        (
            "roundel_fusion_objects_returned_total",
            "Objects that were known again by their code.",
            counts.returned,
        ),
        (
            "roundel_fusion_ambiguous_codes_total",
            "Objects with the code of another one that is seen as well.",
            counts.ambiguous_codes,
        ),
        (
            "roundel_fusion_localized_total",
            "Frames by which a camera on an object found where that is, from reference roundels.",
            counts.localized,
        ),
        ("roundel_fusion_restarts_total", "Times that all tracks were ended.", counts.restarts),
    ] {
        page.single(name, "counter", help, count as f64);
    }
}

fn write_clients(page: &mut MetricsText, api: &ApiState) {
    let counters = &api.counters;
    for (name, kind, help, counter) in [
        ("roundel_connections", "gauge", "Open connections.", &counters.connections),
        (
            "roundel_connections_refused_total",
            "counter",
            "Connections refused because limits.max_clients were open.",
            &counters.connections_refused,
        ),
        (
            "roundel_subscribers",
            "gauge",
            "Subscribers to snapshots, by gRPC or WebSocket.",
            &counters.snapshot_subscribers,
        ),
        (
            "roundel_snapshots_sent_total",
            "counter",
            "Snapshots handed to subscribers.",
            &counters.snapshots_sent,
        ),
        (
            "roundel_snapshots_missed_total",
            "counter",
            "Snapshots that subscribers wanted and were too slow for.",
            &counters.snapshots_missed,
        ),
        (
            "roundel_subscribers_cut_total",
            "counter",
            "Clients cut off since they took nothing of what there was for them.",
            &counters.subscribers_cut,
        ),
    ] {
        page.single(name, kind, help, counter.load(Ordering::Relaxed) as f64);
    }
}

/// Prometheus' text format, version 0.0.4.
#[derive(Default)]
struct MetricsText {
    text: String,
}

impl MetricsText {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.text, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        self.text.push_str(name);
        for (place, (label, content)) in labels.iter().enumerate() {
            let open = if place == 0 { '{' } else { ',' };
            let content = content.replace('\\', r"\\").replace('"', "\\\"").replace('\n', r"\n");
            let _ = write!(self.text, "{open}{label}=\"{content}\"");
        }
        let close = if labels.is_empty() { "" } else { "}" };
        let _ = writeln!(self.text, "{close} {value}");
    }

    fn single(&mut self, name: &str, kind: &str, help: &str, value: f64) {
        self.family(name, kind, help);
        self.sample(name, &[], value);
    }
}

fn status_word(status: CameraStatus) -> &'static str {
    match status {
        CameraStatus::Starting => "starting",
        CameraStatus::Running => "running",
        CameraStatus::Failed => "failed",
        CameraStatus::Finished => "finished",
    }
}
