//! What was taken from the tap, as messages of a file.

use std::io;

use roundel_core::time::Timestamp;

use super::{
    file_writer::{FileWriter, MessageStamp},
    schema::{CompressedImage, Topic},
};
use crate::model::{
    convert,
    hub::Installation,
    tap::{CompressedFrame, RecordedItem},
};

/// Adds what was recorded to a file; `now` is when, where it does not say that itself.
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
            let stamp =
                MessageStamp { log_time: now, publish_time: event.time, sequence: event.sequence };
            file.write(Topic::Events, stamp, &convert::event(event))
        }
        RecordedItem::CameraUpdate(told) => {
            let message = convert::fused_camera(installation, told);
            file.write(Topic::Calibration, MessageStamp::at(now, 0), &message)
        }
        RecordedItem::Settings(written) => {
            let message = convert::fused_configuration(installation, written);
            file.write(Topic::Configuration, MessageStamp::at(now, 0), &message)
        }
        RecordedItem::CompressedFrame(picture) => {
            write_compressed_frame(file, installation, picture)
        }
    }
}

fn write_compressed_frame(
    file: &mut FileWriter,
    installation: &Installation,
    picture: &CompressedFrame,
) -> io::Result<()> {
    let ns = picture.capture_time.as_ns();
    let image = CompressedImage {
        timestamp: Some(prost_types::Timestamp {
            seconds: ns.div_euclid(1_000_000_000),
            nanos: ns.rem_euclid(1_000_000_000) as i32,
        }),
        data: picture.data.clone(),
        format: picture.format.to_owned(),
        frame_id: installation.camera_name(picture.camera).to_owned(),
    };
    let stamp = MessageStamp {
        log_time: picture.received_time,
        publish_time: picture.capture_time,
        sequence: picture.number,
    };
    let camera = image.frame_id.clone();
    file.write_frame(&camera, stamp, &image)
}
