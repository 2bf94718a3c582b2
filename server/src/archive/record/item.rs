//! Recorded items as messages of a file.

use std::io;

use prost::Message as _;
use roundel_core::time::Timestamp;

use super::{
    file_writer::{FileWriter, MessageStamp},
    schema::{CompressedImage, Topic},
};
use crate::model::{convert, hub::Installation, tap::RecordedItem};

/// Writes an item; `now` is the log time of items without one.
pub fn write_item(
    file: &mut FileWriter,
    installation: &Installation,
    item: &RecordedItem,
    now: Timestamp,
) -> io::Result<()> {
    match item {
        RecordedItem::Snapshot(fused) => {
            let message = convert::snapshot(installation, fused, &fused.snapshot, true);
            let stamp = MessageStamp {
                log_time: fused.fused_time,
                publish_time: fused.snapshot.pose_time,
                sequence: fused.sequence,
            };
            file.write(Topic::Snapshots, stamp, &message)
        }
        RecordedItem::Detections(observations, time) => {
            let message = convert::observations(installation, observations);
            let stamp = MessageStamp {
                log_time: *time,
                publish_time: observations.capture_time,
                sequence: observations.frame,
            };
            file.write(Topic::Observations, stamp, &message)
        }
        RecordedItem::Event(event) => {
            let publish_time = Timestamp::from_ns(event.time_ns);
            let stamp = MessageStamp { log_time: now, publish_time, sequence: event.sequence };
            file.write(Topic::Events, stamp, &**event)
        }
        RecordedItem::CameraUpdate(update) => {
            let message = convert::fused_camera(installation, update);
            file.write(Topic::Calibration, MessageStamp::at(now, 0), &message)
        }
        RecordedItem::Settings(applied) => {
            let message = convert::fused_configuration(installation, applied);
            file.write(Topic::Configuration, MessageStamp::at(now, 0), &message)
        }
        RecordedItem::CompressedFrame(frame) => {
            let ns = frame.capture_time.as_ns();
            let camera = installation.camera_name(frame.camera);
            let image = CompressedImage {
                timestamp: Some(prost_types::Timestamp {
                    seconds: ns.div_euclid(1_000_000_000),
                    nanos: ns.rem_euclid(1_000_000_000) as i32,
                }),
                data: frame.data.clone(),
                format: frame.format.to_owned(),
                frame_id: camera.to_owned(),
            };
            let stamp = MessageStamp {
                log_time: frame.received_time,
                publish_time: frame.capture_time,
                sequence: frame.number,
            };
            file.write_frame(camera, stamp, &image.encode_to_vec())
        }
    }
}
