//! `/metrics` for Prometheus, and `/healthz` and `/readyz` for process managers.
//!
//! Values are read from the hub on request. Those of cameras have the label `camera`.

mod camera;

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
use roundel_core::world::{FusionCounts, KindPrintSize, LifeStage, PrintSizeState};
use roundel_proto::{
    json,
    v1::{self, roundel_server::RoundelServer},
};
use serde::Serialize;
use tokio::time::sleep;
use tonic::server::NamedService;
use tonic_health::{ServingStatus, server::HealthReporter};
use utoipa::ToSchema;

use super::{ApiState, error::SHUTTING_DOWN, grpc, handler::Api, queries};
use crate::model::hub::Installation;

/// A snapshot older than this, or than this many periods, means that fusion does not publish. Below 1 s by more than
/// [`READINESS_INTERVAL`].
const STALE_SECONDS: f64 = 0.7;
const STALE_PERIODS: f64 = 5.0;
/// Interval at which the gRPC health service follows the readiness.
const READINESS_INTERVAL: Duration = Duration::from_millis(250);

/// The service's name in gRPC health checks.
const SERVICE_NAME: &str = <RoundelServer<grpc::Service> as NamedService>::NAME;

/// Response of `/healthz` and `/readyz`.
#[derive(Debug, Serialize, ToSchema)]
pub struct Health {
    /// `ok`, or `unavailable`.
    pub status: &'static str,
    /// Reasons, one sentence each.
    pub missing: Vec<String>,
}

/// Whether the process is alive.
#[utoipa::path(
    get, path = "/healthz", tag = "server",
    responses((status = 200, description = "it is", body = Health)),
)]
pub async fn health() -> Json<Health> {
    Json(Health { status: "ok", missing: Vec::new() })
}

/// Whether clients receive poses: fusion publishes, and at least one camera runs.
#[utoipa::path(
    get, path = "/readyz", tag = "server",
    responses(
        (status = 200, description = "they do", body = Health),
        (status = 503, description = "lists the reasons", body = Health),
    ),
)]
pub async fn readiness(State(api): Api) -> Response {
    let missing = missing(&api);
    let (code, status) = match missing.is_empty() {
        true => (StatusCode::OK, "ok"),
        false => (StatusCode::SERVICE_UNAVAILABLE, "unavailable"),
    };
    (code, Json(Health { status, missing })).into_response()
}

/// Reasons why clients receive no poses.
fn missing(api: &ApiState) -> Vec<String> {
    let mut missing = Vec::new();
    if api.cancel.is_cancelled() {
        missing.push(SHUTTING_DOWN.to_owned());
    }
    let installation = api.hub.installation();
    let fused = api.hub.snapshots().borrow().clone();
    if api.hub.fusion_has_ended() {
        missing.push("fusion has ended".to_owned());
    } else if fused.sequence == 0 {
        missing.push("fusion has not published a snapshot yet".to_owned());
    } else {
        let age_s = api.clock.now().seconds_since(fused.fused_time);
        let allowed_s = STALE_SECONDS.max(STALE_PERIODS / installation.snapshot_rate_hz);
        if age_s > allowed_s {
            missing.push(format!("fusion's newest snapshot is {age_s:.1} s old"));
        }
    }
    let cameras = queries::cameras(api);
    if cameras.is_empty() {
        missing.push("the configuration has no camera".to_owned());
    } else if cameras.iter().all(|camera| camera.status() != v1::CameraStatus::Running) {
        let status = |camera: &v1::Camera| {
            format!("{} is {}", camera.name, json::camera_status::word(camera.status))
        };
        let statuses: Vec<String> = cameras.iter().map(status).collect();
        missing.push(format!("no camera runs: {}", statuses.join(", ")));
    }
    missing
}

/// Reports the readiness to the gRPC health service until shutdown.
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

/// Every metric of the server, in Prometheus' text format.
#[utoipa::path(
    get, path = "/metrics", tag = "server",
    responses((status = 200, description = "Prometheus' text format", body = String, content_type = "text/plain")),
)]
pub async fn metrics(State(api): Api) -> Response {
    let mut page = MetricsText::default();
    write_server(&mut page, &api);
    camera::write_cameras(&mut page, &api.hub.installation(), &api.hub.cameras());
    write_fusion(&mut page, &api);
    write_clients(&mut page, &api);
    if let Some(recorder) = &api.recorder {
        write_recording(&mut page, &recorder.status());
    }
    if let Some(history) = &api.history {
        let is_up = f64::from(u8::from(history.error().is_empty()));
        page.single("roundel_history_up", "1 while past positions are stored.", is_up);
    }
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], page.text)
        .into_response()
}

fn write_server(page: &mut MetricsText, api: &ApiState) {
    let installation = api.hub.installation();
    page.family("roundel_info", "Always 1; its labels identify the server.");
    let labels = [
        ("version", env!("CARGO_PKG_VERSION")),
        ("name", &installation.name),
        ("source_id", &installation.source_id),
    ];
    page.sample("roundel_info", &labels, 1.0);
    let start_s = installation.started.as_ns() as f64 * 1e-9;
    page.single("roundel_start_time_seconds", "Start of the server, Unix time.", start_s);
    let ready = f64::from(u8::from(missing(api).is_empty()));
    page.single("roundel_ready", "1 while /readyz reports readiness.", ready);
    let cameras = installation.cameras.len() as f64;
    page.single("roundel_cameras", "Configured cameras.", cameras);
    let name = "roundel_camera_changes_total";
    let changes = ["added", "changed", "removed"].into_iter().zip(api.hub.camera_change_counts());
    page.labelled(name, "Cameras added, changed or removed since the start.", "change", changes);
}

fn write_fusion(page: &mut MetricsText, api: &ApiState) {
    write_fusion_counts(page, &api.hub.fusion_counts());
    write_print_sizes(page, &api.hub.installation(), &api.hub.print_sizes());
    let fused = api.hub.snapshots().borrow().clone();
    let help = "Snapshots published by fusion.";
    page.single("roundel_snapshots_total", help, fused.sequence as f64);
    if fused.sequence > 0 {
        let age_s = api.clock.now().seconds_since(fused.fused_time);
        page.single("roundel_snapshot_age_seconds", "Age of the newest snapshot.", age_s);
    }
    let records = api.hub.objects();
    let stages = [
        ("tentative", LifeStage::Tentative),
        ("tracked", LifeStage::Tracked),
        ("predicted", LifeStage::Predicted),
        ("lost", LifeStage::Lost),
    ];
    let counts = stages.map(|(word, stage)| {
        (word, records.iter().filter(|record| record.stage == stage).count() as u64)
    });
    let help = "Objects by life stage; lost ones for a minute.";
    page.labelled("roundel_objects", help, "stage", counts);
}

/// Only measured sizes.
fn write_print_sizes(page: &mut MetricsText, installation: &Installation, sizes: &[KindPrintSize]) {
    let measured = || sizes.iter().filter(|size| size.state != PrintSizeState::Assumed);
    let label = |size: &KindPrintSize| installation.kind_name(Some(size.kind)).to_owned();
    let name = "roundel_print_size_ratio";
    page.family(name, "Measured diameters of a kind's prints relative to the configured ones.");
    for size in measured() {
        page.sample(name, &[("roundel", &label(size))], size.size.factor);
    }
    let name = "roundel_print_size_deviation_ratio";
    page.family(name, "Standard deviation of roundel_print_size_ratio.");
    for size in measured() {
        page.sample(name, &[("roundel", &label(size))], size.size.deviation);
    }
}

fn write_fusion_counts(page: &mut MetricsText, counts: &FusionCounts) {
    let taken = counts
        .frames
        .saturating_sub(counts.duplicate_frames + counts.late_frames + counts.jumped_frames);
    let outcomes = [
        ("taken", taken),
        ("duplicate", counts.duplicate_frames),
        ("late", counts.late_frames),
        ("jumped", counts.jumped_frames),
    ];
    let help = "Frames handed to fusion, by outcome.";
    page.labelled("roundel_fusion_frames_total", help, "outcome", outcomes);
    // Each detection has one outcome. Two reasons for a missing pose have outcomes of their own.
    let unknown_place = counts
        .no_camera_pose
        .saturating_sub(counts.carrier_unseen + counts.carrier_orientation_unknown);
    let outcomes = [
        ("used", counts.used),
        ("late", counts.late),
        ("duplicate", counts.duplicate),
        ("jumped", counts.jumped),
        ("no_camera_pose", unknown_place),
        ("carrier_unseen", counts.carrier_unseen),
        ("carrier_unturned", counts.carrier_orientation_unknown),
        ("of_landmark", counts.landmark_detections),
        ("of_carrier", counts.carrier_detections),
        ("no_pose", counts.no_pose),
        ("invalid", counts.invalid),
        ("contradicted", counts.contradicted),
        ("outranked", counts.outranked),
        ("over_max_objects", counts.over_max_objects),
        ("joined", counts.joined),
        ("left_out", counts.left_out),
        ("held_back", counts.held),
    ];
    let help = "Detections handed to fusion, by outcome.";
    page.labelled("roundel_fusion_detections_total", help, "outcome", outcomes);
    for (name, help, count) in [
        (
            "roundel_fusion_missing_frames_total",
            "Frames that never arrived, by frame numbers and regular intervals.",
            counts.missing_frames,
        ),
        (
            "roundel_fusion_out_of_order_total",
            "Detections used that arrived after newer ones of their object.",
            counts.out_of_order,
        ),
        (
            "roundel_fusion_gated_total",
            "Detections outside the gate of the object that their camera associated them with: contradicted, or used for another.",
            counts.gated,
        ),
        (
            "roundel_fusion_held_frames_total",
            "Frames not used because their camera seemed to have moved suddenly.",
            counts.held_frames,
        ),
        (
            "roundel_fusion_taken_back_total",
            "Detections removed from tracks because their camera had moved.",
            counts.retracted,
        ),
        ("roundel_fusion_tracks_begun_total", "Detections that began a track.", counts.begun),
        ("roundel_fusion_tracks_merged_total", "Tracks merged into another one.", counts.merged),
        (
            "roundel_fusion_clock_steps_total",
            "Steps of cameras' clocks: set, or changed to another epoch.",
            counts.clock_steps,
        ),
        (
            "roundel_fusion_objects_returned_total",
            "Lost objects recognized by their code.",
            counts.returned,
        ),
        (
            "roundel_fusion_ambiguous_codes_total",
            "Objects with the code of another visible object.",
            counts.ambiguous_codes,
        ),
        (
            "roundel_fusion_localized_total",
            "Frames in which a mounted camera localized its object from reference roundels.",
            counts.localized,
        ),
        ("roundel_fusion_restarts_total", "Times that all tracks were dropped.", counts.restarts),
    ] {
        page.single(name, help, count as f64);
    }
}

fn write_clients(page: &mut MetricsText, api: &ApiState) {
    let counters = &api.counters;
    for (name, help, counter) in [
        ("roundel_connections", "Open connections.", &counters.connections),
        (
            "roundel_connections_refused_total",
            "Connections refused because of limits.max_clients or limits.max_connections_per_peer.",
            &counters.connections_refused,
        ),
        (
            "roundel_connections_evicted_total",
            "Idle connections closed for new ones.",
            &counters.connections_evicted,
        ),
        (
            "roundel_subscribers",
            "Subscribers to snapshots, by gRPC or WebSocket.",
            &counters.snapshot_subscribers,
        ),
        (
            "roundel_snapshots_sent_total",
            "Snapshots handed to subscribers.",
            &counters.snapshots_sent,
        ),
        (
            "roundel_snapshots_missed_total",
            "Snapshots that slow subscribers skipped.",
            &counters.snapshots_missed,
        ),
        (
            "roundel_subscribers_cut_total",
            "Clients disconnected because they read nothing.",
            &counters.subscribers_cut,
        ),
    ] {
        page.single(name, help, counter.load(Ordering::Relaxed) as f64);
    }
}

fn write_recording(page: &mut MetricsText, status: &v1::Recording) {
    let states = [
        ("idle", v1::RecordingState::Idle),
        ("recording", v1::RecordingState::Recording),
        ("stopped", v1::RecordingState::Stopped),
        ("failed", v1::RecordingState::Failed),
    ];
    let states = states.map(|(word, state)| (word, u64::from(status.state() == state)));
    let help = "1 for the state of the newest recording.";
    page.labelled("roundel_recording_state", help, "state", states);
    for (name, help, number) in [
        ("roundel_recording_bytes", "Bytes in all its files.", status.bytes as f64),
        ("roundel_recording_files", "Its files.", f64::from(status.files)),
        ("roundel_recording_messages", "Messages in its files.", status.messages as f64),
        (
            "roundel_recording_dropped_messages",
            "Messages dropped because the disk was too slow.",
            status.dropped as f64,
        ),
        ("roundel_recording_seconds", "Its duration.", status.seconds),
        (
            "roundel_recording_disk_free_bytes",
            "Free bytes of its disk at the last check; 0 before the first recording.",
            status.disk_free_bytes as f64,
        ),
    ] {
        page.single(name, help, number);
    }
}

/// Prometheus' text format, version 0.0.4.
#[derive(Default)]
struct MetricsText {
    text: String,
}

impl MetricsText {
    /// By convention, counters alone have names that end in `_total`.
    fn family(&mut self, name: &str, help: &str) {
        let kind = if name.ends_with("_total") { "counter" } else { "gauge" };
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

    /// A family with a sample for each value of a label.
    fn labelled(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        samples: impl IntoIterator<Item = (&'static str, u64)>,
    ) {
        self.family(name, help);
        for (value, count) in samples {
            self.sample(name, &[(label, value)], count as f64);
        }
    }

    fn single(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, help);
        self.sample(name, &[], value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_recording_differs_from_a_running_one() {
        let mut page = MetricsText::default();
        let state = v1::RecordingState::Failed.into();
        write_recording(&mut page, &v1::Recording { state, dropped: 7, ..Default::default() });
        for line in [
            "roundel_recording_state{state=\"failed\"} 1",
            "roundel_recording_state{state=\"recording\"} 0",
            "roundel_recording_dropped_messages 7",
        ] {
            assert!(page.text.lines().any(|found| found == line), "{}", page.text);
        }
    }
}
