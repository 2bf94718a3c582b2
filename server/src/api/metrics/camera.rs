//! What `/metrics` says of each camera.

use std::{collections::BTreeMap, sync::Arc};

use roundel_core::{id::CameraId, marker::Reject};

use super::MetricsText;
use crate::model::{
    hub::{CameraInfo, CameraState, CameraStatus, Installation, PoseStatus},
    reason,
};

/// A number of each camera: name, type, help, and where it stands.
type CameraFamily = (&'static str, &'static str, &'static str, fn(&CameraState) -> f64);

const CAMERA_FAMILIES: [CameraFamily; 26] = [
    ("roundel_camera_up", "gauge", "1 while frames arrive.", |camera| {
        f64::from(u8::from(camera.status == CameraStatus::Running))
    }),
    ("roundel_camera_placed", "gauge", "1 while its pose is known.", |camera| {
        f64::from(u8::from(camera.pose.placement.is_some()))
    }),
    ("roundel_camera_frames_total", "counter", "Frames processed.", |camera| camera.frames as f64),
    (
        "roundel_camera_frames_dropped_total",
        "counter",
        "Frames that gave way to newer ones because the worker was busy.",
        |camera| camera.dropped as f64,
    ),
    (
        "roundel_camera_frames_broken_total",
        "counter",
        "Frames that arrived broken and were left out.",
        |camera| camera.broken as f64,
    ),
    (
        "roundel_camera_restarts_total",
        "counter",
        "Times that the source was opened again after a failure.",
        |camera| camera.restarts as f64,
    ),
    ("roundel_camera_rate_hertz", "gauge", "Frames a second, mean over the last seconds.", |c| {
        c.rate_hz
    }),
    (
        "roundel_camera_promised_rate_hertz",
        "gauge",
        "Frames a second that its driver or its configuration promises; 0: none.",
        |camera| camera.promised_hz,
    ),
    ("roundel_camera_fed", "gauge", "1 while a remote program feeds it.", |camera| {
        f64::from(u8::from(camera.link.as_ref().is_some_and(|link| link.connected)))
    }),
    (
        "roundel_camera_frames_missing_total",
        "counter",
        "Frames that a remote program numbered and that never came, part of those dropped.",
        |camera| camera.link.as_ref().map_or(0.0, |link| link.missing as f64),
    ),
    (
        "roundel_camera_frames_repeated_total",
        "counter",
        "Frames of a remote program that came twice, and count once.",
        |camera| camera.link.as_ref().map_or(0.0, |link| link.repeated as f64),
    ),
    ("roundel_camera_detections", "gauge", "Roundels in the newest frame.", |camera| {
        camera.detections as f64
    }),
    (
        "roundel_camera_detect_seconds",
        "gauge",
        "Time that a frame takes to detect, median of the newest ones.",
        |camera| camera.detect_ms * 1e-3,
    ),
    (
        "roundel_camera_decode_seconds",
        "gauge",
        "Time that decoding a frame takes, before that, median of the newest ones.",
        |camera| camera.decode_ms * 1e-3,
    ),
    (
        "roundel_camera_latency_seconds",
        "gauge",
        "From capture to fused, median of the newest frames.",
        |camera| camera.latency_ms * 1e-3,
    ),
    (
        "roundel_camera_blur_pixels",
        "gauge",
        "Standard deviation of the blur, median of the newest frames; 0 where none was fitted.",
        |camera| camera.blur_px,
    ),
    (
        "roundel_camera_noise_levels",
        "gauge",
        "Standard deviation of the noise, grey levels of 255, likewise.",
        |camera| camera.noise,
    ),
    (
        "roundel_camera_reprojection_pixels",
        "gauge",
        "How far from where other cameras have objects it sees them, rms of the last seconds; 0: no other sees them.",
        |camera| camera.reprojection_px,
    ),
    (
        "roundel_camera_capture_clock_deviation_seconds",
        "gauge",
        "What its capture times may be off by together before anything is found; 0: they are right.",
        |camera| camera.capture_clock.map_or(0.0, |clock| clock.deviation_s),
    ),
    (
        "roundel_camera_clock_offset_seconds",
        "gauge",
        "By how much its stamps are late, as found from what it sees; taken off all times.",
        |camera| camera.clock.map_or(0.0, |clock| clock.offset_s),
    ),
    ("roundel_camera_clock_skew_ratio", "gauge", "By how much more each second.", |camera| {
        camera.clock.map_or(0.0, |clock| clock.skew)
    }),
    (
        "roundel_camera_clock_deviation_seconds",
        "gauge",
        "Standard deviation of the offset against the other cameras' clocks; 0 where it is trusted.",
        |camera| camera.clock.map_or(0.0, |clock| clock.deviation_s),
    ),
    (
        "roundel_camera_calibration_version",
        "gauge",
        "Version of the calibration of the arena that it stands by; 0: of the configuration.",
        |camera| camera.calibration_version as f64,
    ),
    (
        "roundel_camera_quarantined",
        "gauge",
        "1 since it was bumped, until it is used again.",
        |camera| f64::from(u8::from(camera.pose.status == PoseStatus::Quarantined)),
    ),
    (
        "roundel_camera_place_error_metres",
        "gauge",
        "By how much it would have to move to agree best with the others, over about a minute.",
        |camera| camera.health.map_or(0.0, |health| health.error_m),
    ),
    (
        "roundel_camera_seen_error_metres",
        "gauge",
        "By how much what it sees is off from what the others see, rms, likewise.",
        |camera| camera.health.map_or(0.0, |health| health.seen_error_m),
    ),
];

pub(super) fn write_cameras(
    page: &mut MetricsText,
    installation: &Installation,
    cameras: &BTreeMap<CameraId, CameraState>,
) {
    let named = |(id, info): (&CameraId, &Arc<CameraInfo>)| {
        cameras.get(id).map(|state| (info.name.clone(), state))
    };
    let named: Vec<(String, &CameraState)> =
        installation.cameras.iter().filter_map(named).collect();
    let each = || named.iter().map(|(name, state)| (name.as_str(), *state));
    for (name, kind, help, number) in CAMERA_FAMILIES {
        page.family(name, kind, help);
        for (camera, state) in each() {
            page.sample(name, &[("camera", camera)], number(state));
        }
    }
    write_stages(page, each());
    write_detections(page, each());
}

fn write_stages<'a>(
    page: &mut MetricsText,
    each: impl Iterator<Item = (&'a str, &'a CameraState)>,
) {
    let name = "roundel_camera_stage_seconds";
    page.family(name, "gauge", "Time of a frame by stage, median of the newest ones.");
    for (camera, state) in each {
        for (stage, stage_ms) in [("find", state.find_ms), ("locate", state.locate_ms)] {
            page.sample(name, &[("camera", camera), ("stage", stage)], stage_ms * 1e-3);
        }
    }
}

fn write_detections<'a>(
    page: &mut MetricsText,
    each: impl Iterator<Item = (&'a str, &'a CameraState)> + Clone,
) {
    let name = "roundel_camera_located_total";
    page.family(
        name,
        "counter",
        "Roundels found, by how they were located: precise, fast (in precise mode: the fit refused \
         them), or none.",
    );
    for (camera, CameraState { counts, .. }) in each.clone() {
        for (by, count) in
            [("precise", counts.precise), ("fast", counts.fast), ("none", counts.unlocated)]
        {
            page.sample(name, &[("camera", camera), ("by", by)], count as f64);
        }
    }
    let name = "roundel_camera_rejects_total";
    page.family(name, "counter", "Candidates that were no roundels, by what refused them.");
    for (camera, state) in each {
        for (&reject, &count) in Reject::ALL.iter().zip(&state.counts.rejects) {
            let reason = reason::reject_name(reject, '_');
            page.sample(name, &[("camera", camera), ("reason", &reason)], count as f64);
        }
    }
}
