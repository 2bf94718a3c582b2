//! Frames become image files: JPEG, small and for people, or PNG, with every grey value as it was searched.

use std::sync::mpsc::{Receiver, SyncSender};

use jpeg_encoder::{ColorType, Encoder};

use crate::model::{
    config::FrameFormat,
    tap::{CompressedFrame, RawFrame, RecordedItem},
};

const QUALITY: u8 = 90;

/// Compresses what comes until nothing comes any more.
pub(super) fn run(
    frames: &Receiver<RawFrame>,
    back: &SyncSender<RecordedItem>,
    format: FrameFormat,
) {
    while let Ok(frame) = frames.recv() {
        match compressed(frame, format) {
            Ok(picture) => {
                if back.send(RecordedItem::CompressedFrame(picture)).is_err() {
                    // The recording has ended.
                    return;
                }
            }
            Err(error) => {
                tracing::warn!(%error, "a frame could not be compressed for the recording")
            }
        }
    }
}

fn compressed(frame: RawFrame, format: FrameFormat) -> Result<CompressedFrame, String> {
    let RawFrame { camera, number, capture_time, received_time, size, pixels } = frame;
    let mut data = Vec::with_capacity(pixels.len() / 4);
    let word = match format {
        FrameFormat::Jpeg => {
            let side = |side: usize| u16::try_from(side).map_err(|error| error.to_string());
            Encoder::new(&mut data, QUALITY)
                .encode(&pixels, side(size.0)?, side(size.1)?, ColorType::Luma)
                .map_err(|error| error.to_string())?;
            "jpeg"
        }
        FrameFormat::Png => {
            let side = |side: usize| u32::try_from(side).map_err(|error| error.to_string());
            let mut encoder = png::Encoder::new(&mut data, side(size.0)?, side(size.1)?);
            encoder.set_color(png::ColorType::Grayscale);
            encoder.set_depth(png::BitDepth::Eight);
            encoder.set_compression(png::Compression::Fastest);
            let mut writer = encoder.write_header().map_err(|error| error.to_string())?;
            writer.write_image_data(&pixels).map_err(|error| error.to_string())?;
            writer.finish().map_err(|error| error.to_string())?;
            "png"
        }
    };
    Ok(CompressedFrame { camera, number, capture_time, received_time, format: word, data })
}
