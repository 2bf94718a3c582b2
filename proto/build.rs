//! Compiles the `.proto` files without `protoc`, and derives the JSON form for REST and the WebSocket from the same
//! messages.

use std::path::PathBuf;

use prost::Message;

const FILES: [&str; 2] = ["roundel/v1/roundel.proto", "roundel/v1/stream.proto"];

/// Fields in nanoseconds: strings in JSON, because they exceed the exact range of a JSON number (2^53).
const NANOSECONDS: [&str; 34] = [
    "Snapshot.pose_time_ns",
    "Snapshot.capture_time_ns",
    "Snapshot.fused_time_ns",
    "Snapshot.sent_time_ns",
    "ObjectState.observation_age_ns",
    "Detection.capture_time_ns",
    "FrameObservations.capture_time_ns",
    "FrameObservations.received_time_ns",
    "Event.time_ns",
    "Object.first_seen_time_ns",
    "Object.last_seen_time_ns",
    "ServerInfo.started_time_ns",
    "Camera.pose_time_ns",
    "CameraPicture.capture_time_ns",
    "GetTimeRequest.sent_time_ns",
    "ServerTime.sent_time_ns",
    "ServerTime.received_time_ns",
    "ServerTime.replied_time_ns",
    "DriveRobotsResponse.effective_time_ns",
    "PushRobotResponse.effective_time_ns",
    "PushedFrame.capture_time_ns",
    "PushProbe.sent_time_ns",
    "PushProbeAnswer.sent_time_ns",
    "PushProbeAnswer.received_time_ns",
    "PushProbeAnswer.replied_time_ns",
    "Recording.started_time_ns",
    "RecordingFile.started_time_ns",
    "Replay.begin_time_ns",
    "Replay.position_time_ns",
    "QueryHistoryRequest.from_time_ns",
    "QueryHistoryRequest.until_time_ns",
    "HistoryPoint.time_ns",
    "QueryHistoryResponse.oldest_time_ns",
    "QueryHistoryResponse.newest_time_ns",
];
/// Oneofs, which need the same derives as messages.
const ALTERNATIVES: [&str; 5] = [
    "PushRequest.message",
    "PushResponse.message",
    "PushedFrame.picture",
    "PushedPicture.picture",
    "StreamMessage.message",
];

/// Enumeration fields and their module in `json`: integers in protobuf, lower-case words in JSON.
const ENUMERATIONS: [(&str, &str); 15] = [
    ("ObjectState.stage", "life_stage"),
    ("Object.stage", "life_stage"),
    ("Camera.status", "camera_status"),
    ("Camera.pose_status", "pose_status"),
    ("Event.kind", "event_kind"),
    ("CameraAgreement.state", "agreement_state"),
    ("PrintSize.state", "print_size_state"),
    ("CaptureClock.base", "time_base"),
    ("Calibration.stage", "calibration_stage"),
    ("StartCalibrationRequest.apply", "calibration_apply"),
    ("PushGreeting.times", "push_times"),
    ("Recording.state", "recording_state"),
    ("Replay.from", "replay_from"),
    ("FusedCamera.place", "fused_place"),
    ("FusedCamera.clock", "fused_clock"),
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=roundel");
    let descriptors = protox::compile(FILES, ["."])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;

    let mut builder = tonic_prost_build::configure()
        .message_attribute(
            ".",
            "#[derive(serde::Serialize, serde::Deserialize)]\n#[serde(default, deny_unknown_fields)]",
        )
        .message_attribute(
            ".",
            "#[cfg_attr(feature = \"openapi\", derive(utoipa::ToSchema))]",
        );
    for alternatives in ALTERNATIVES {
        builder = builder.type_attribute(
            format!("roundel.v1.{alternatives}"),
            "#[derive(serde::Serialize, serde::Deserialize)]\n\
             #[cfg_attr(feature = \"openapi\", derive(utoipa::ToSchema))]",
        );
    }
    for field in NANOSECONDS {
        builder = builder.field_attribute(
            format!("roundel.v1.{field}"),
            "#[serde(with = \"crate::json::nanoseconds\")]\n\
             #[cfg_attr(feature = \"openapi\", schema(value_type = String, example = \"1700000000000000000\"))]",
        );
    }
    for (field, module) in ENUMERATIONS {
        builder = builder.field_attribute(
            format!("roundel.v1.{field}"),
            format!(
                "#[serde(with = \"crate::json::{module}\")]\n\
                 #[cfg_attr(feature = \"openapi\", schema(value_type = String))]"
            ),
        );
    }
    builder.compile_fds(descriptors)?;
    Ok(())
}
