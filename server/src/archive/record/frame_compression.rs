//! Compresses frames to image files: JPEG, which is small, or PNG, which is lossless.

use std::sync::mpsc::{Receiver, SyncSender};

use jpeg_encoder::{ColorType, Encoder};

use crate::model::{
    config::FrameFormat,
    tap::{CompressedFrame, RawFrame, RecordedItem},
};

const QUALITY: u8 = 90;

/// Compresses frames until the recording ends.
pub(super) fn run(
    frames: &Receiver<RawFrame>,
    compressed: &SyncSender<RecordedItem>,
    format: FrameFormat,
) {
    for frame in frames {
        match compress(frame, format) {
            Ok(frame) => {
                if compressed.send(RecordedItem::CompressedFrame(frame)).is_err() {
                    return;
                }
            }
            Err(error) => {
                tracing::warn!(%error, "a frame could not be compressed for the recording")
            }
        }
    }
}

fn compress(frame: RawFrame, format: FrameFormat) -> anyhow::Result<CompressedFrame> {
    let RawFrame { camera, number, capture_time, received_time, size, pixels } = frame;
    let mut data = Vec::with_capacity(pixels.len() / 4);
    let format = match format {
        FrameFormat::Jpeg => {
            let (width, height) = (size.0.try_into()?, size.1.try_into()?);
            Encoder::new(&mut data, QUALITY).encode(&pixels, width, height, ColorType::Luma)?;
            "jpeg"
        }
        FrameFormat::Png => {
            let mut encoder = png::Encoder::new(&mut data, size.0.try_into()?, size.1.try_into()?);
            encoder.set_color(png::ColorType::Grayscale);
            encoder.set_depth(png::BitDepth::Eight);
            encoder.set_compression(png::Compression::Fastest);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&pixels)?;
            writer.finish()?;
            "png"
        }
    };
    Ok(CompressedFrame { camera, number, capture_time, received_time, format, data })
}
