//! Metrics of each camera.

use std::{collections::BTreeMap, sync::Arc};

use roundel_core::{id::CameraId, marker::Reject};

use super::MetricsText;
use crate::model::{
    hub::{CameraInfo, CameraState, CameraStatus, Installation, PoseStatus},
    reason,
};

/// Name, help and value.
type CameraFamily = (&'static str, &'static str, fn(&CameraState) -> f64);

const CAMERA_FAMILIES: [CameraFamily; 27] = [
    ("roundel_camera_up", "1 while frames arrive.", |camera| {
        f64::from(u8::from(camera.status == CameraStatus::Running))
    }),
    ("roundel_camera_placed", "1 while its pose is known.", |camera| {
        f64::from(u8::from(camera.pose.placement.is_some()))
    }),
    ("roundel_camera_frames_total", "Frames processed.", |camera| camera.frames as f64),
    (
        "roundel_camera_frames_dropped_total",
        "Frames replaced by newer ones because the worker was busy.",
        |camera| camera.dropped as f64,
    ),
    ("roundel_camera_frames_broken_total", "Damaged frames, which were skipped.", |camera| {
        camera.broken as f64
    }),
    (
        "roundel_camera_restarts_total",
        "Times that the source was reopened after a failure.",
        |camera| camera.restarts as f64,
    ),
    ("roundel_camera_rate_hertz", "Frames per second, mean over the last seconds.", |c| c.rate_hz),
    (
        "roundel_camera_promised_rate_hertz",
        "Frame rate promised by its driver or configuration; 0: unknown.",
        |camera| camera.promised_hz,
    ),
    ("roundel_camera_fed", "1 while a remote program feeds it.", |camera| {
        f64::from(u8::from(camera.link.as_ref().is_some_and(|link| link.connected)))
    }),
    (
        "roundel_camera_frames_missing_total",
        "Frames of a remote program that never arrived, part of those dropped.",
        |camera| camera.link.as_ref().map_or(0.0, |link| link.missing as f64),
    ),
    (
        "roundel_camera_frames_repeated_total",
        "Frames of a remote program that arrived twice, and count once.",
        |camera| camera.link.as_ref().map_or(0.0, |link| link.repeated as f64),
    ),
    ("roundel_camera_detections", "Roundels in the newest frame.", |camera| {
        camera.detections as f64
    }),
    (
        "roundel_camera_detect_seconds",
        "Detection time of a frame, median of the newest ones.",
        |camera| camera.detect_ms * 1e-3,
    ),
    (
        "roundel_camera_budget_ratio",
        "Share of the time budget of a frame that finding and locating its roundels takes, median of the newest ones.",
        |camera| camera.budget_used,
    ),
    (
        "roundel_camera_decode_seconds",
        "Decoding time of a frame, median of the newest ones.",
        |camera| camera.decode_ms * 1e-3,
    ),
    (
        "roundel_camera_latency_seconds",
        "From capture to fusion, median of the newest frames.",
        |camera| camera.latency_ms * 1e-3,
    ),
    (
        "roundel_camera_blur_pixels",
        "Standard deviation of the blur, median of the newest frames; 0 where none was fitted.",
        |camera| camera.blur_px,
    ),
    (
        "roundel_camera_noise_levels",
        "Standard deviation of the noise, grey levels of 255, likewise.",
        |camera| camera.noise,
    ),
    (
        "roundel_camera_reprojection_pixels",
        "Rms reprojection error against the other cameras over the last seconds; 0: no other sees its objects.",
        |camera| camera.reprojection_px,
    ),
    (
        "roundel_camera_capture_clock_deviation_seconds",
        "Standard deviation of the common error of its capture times before estimation; 0: exact.",
        |camera| camera.capture_clock.map_or(0.0, |clock| clock.deviation_s),
    ),
    (
        "roundel_camera_clock_offset_seconds",
        "Estimated delay of its time stamps; subtracted from all of them.",
        |camera| camera.clock.map_or(0.0, |clock| clock.offset_s),
    ),
    ("roundel_camera_clock_skew_ratio", "Growth of the delay per second.", |camera| {
        camera.clock.map_or(0.0, |clock| clock.skew)
    }),
    (
        "roundel_camera_clock_deviation_seconds",
        "Standard deviation of the delay against the other cameras' clocks; 0: trusted.",
        |camera| camera.clock.map_or(0.0, |clock| clock.deviation_s),
    ),
    (
        "roundel_camera_calibration_version",
        "Version of the arena calibration of its pose; 0: the configuration's.",
        |camera| camera.calibration_version as f64,
    ),
    ("roundel_camera_quarantined", "1 from a bump until it is used again.", |camera| {
        f64::from(u8::from(camera.pose.status == PoseStatus::Quarantined))
    }),
    (
        "roundel_camera_place_error_metres",
        "Displacement that best explains its disagreement with the others, over about a minute.",
        |camera| camera.health.map_or(0.0, |health| health.error_m),
    ),
    (
        "roundel_camera_seen_error_metres",
        "Rms distance of its detections from those of the others, likewise.",
        |camera| camera.health.map_or(0.0, |health| health.seen_error_m),
    ),
];

pub(super) fn write_cameras(
    page: &mut MetricsText,
    installation: &Installation,
    cameras: &BTreeMap<CameraId, CameraState>,
) {
    let named =
        |(id, info): (&CameraId, &Arc<CameraInfo>)| Some((info.name.clone(), cameras.get(id)?));
    let cameras: Vec<(String, &CameraState)> =
        installation.cameras.iter().filter_map(named).collect();
    for (name, help, value) in CAMERA_FAMILIES {
        page.family(name, help);
        for (camera, state) in &cameras {
            page.sample(name, &[("camera", camera)], value(state));
        }
    }
    let name = "roundel_camera_stage_seconds";
    page.family(name, "Time per frame by stage, median of the newest ones.");
    for (camera, state) in &cameras {
        for (stage, stage_ms) in [("find", state.find_ms), ("locate", state.locate_ms)] {
            page.sample(name, &[("camera", camera), ("stage", stage)], stage_ms * 1e-3);
        }
    }
    let name = "roundel_camera_located_total";
    page.family(
        name,
        "Roundels found, by fit: precise, fast (in precise mode: the precise fit failed), deferred (not fitted, to bound the cost), or none.",
    );
    for (camera, CameraState { counts, .. }) in &cameras {
        for (by, count) in [
            ("precise", counts.precise),
            ("fast", counts.fast),
            ("deferred", counts.deferred),
            ("none", counts.unlocated),
        ] {
            page.sample(name, &[("camera", camera), ("by", by)], count as f64);
        }
    }
    let name = "roundel_camera_rejects_total";
    page.family(name, "Rejected candidates, by reason.");
    for (camera, state) in &cameras {
        for (&reject, &count) in Reject::ALL.iter().zip(&state.counts.rejects) {
            let reason = reason::reject_name(reject, '_');
            page.sample(name, &[("camera", camera), ("reason", &reason)], count as f64);
        }
    }
}
