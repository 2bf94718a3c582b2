//! A camera's frame with what was found in it drawn in, as JPEG.
//!
//! What the colours mean stands in [`crate::drawing`]. Drawing and encoding take some milliseconds a frame, so they run off the async threads,
//! and once for all who look at the same frame.

use std::sync::Arc;

use axum::body::Bytes;
use jpeg_encoder::{ColorType, Encoder};
use roundel_core::camera::PixelPoint;

use super::error::ApiError;
use crate::{drawing::Canvas, hub::Picture};

const QUALITY: u8 = 80;

/// The picture as JPEG, with the edges of its camera's masked regions.
pub async fn jpeg(picture: &Arc<Picture>, mask: &[Vec<PixelPoint>]) -> Result<Bytes, ApiError> {
    // Whoever comes second waits here for the first one's work, and takes it.
    let jpeg = picture.jpeg.get_or_try_init(|| async {
        let (drawn, mask) = (picture.clone(), mask.to_vec());
        tokio::task::spawn_blocking(move || encode(&drawn, &mask)).await.map_err(|error| {
            ApiError::Internal(format!("drawing the picture ended early: {error}"))
        })?
    });
    jpeg.await.cloned()
}

/// Draws the mask and the detections into the picture and encodes it.
pub fn encode(picture: &Picture, mask: &[Vec<PixelPoint>]) -> Result<Bytes, ApiError> {
    let sides = u16::try_from(picture.width).ok().zip(u16::try_from(picture.height).ok());
    let Some((width, height)) = sides.filter(|&(width, height)| width > 0 && height > 0) else {
        return Err(ApiError::Internal(format!(
            "expected a picture of 1 to 65535 pixels a side, found {} x {}",
            picture.width, picture.height
        )));
    };
    let expected = picture.width * picture.height;
    if picture.pixels.len() != expected {
        return Err(ApiError::Internal(format!(
            "expected {expected} pixels for {width} x {height}, found {}",
            picture.pixels.len()
        )));
    }
    let mut canvas = Canvas::of(picture.width, picture.height, &picture.pixels);
    for corners in mask {
        canvas.draw_polygon(corners);
    }
    for detection in &picture.observations.detections {
        canvas.draw_ring(&detection.ring, Some(detection.track));
    }
    let mut jpeg = Vec::with_capacity(expected / 4);
    Encoder::new(&mut jpeg, QUALITY)
        .encode(canvas.rgb(), width, height, ColorType::Rgb)
        .map_err(|error| ApiError::Internal(format!("could not encode the picture: {error}")))?;
    Ok(jpeg.into())
}
