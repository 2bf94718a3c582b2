//! A camera's frame with its detections drawn in, as JPEG.
//!
//! [`crate::lab::drawing`] defines the colours. Drawing and encoding take some milliseconds per frame, so they run off the
//! async threads, and once for all clients that request the same frame.

use std::{sync::Arc, time::Duration};

use axum::body::Bytes;
use roundel_core::{camera::PixelPoint, time::Timestamp};
use tokio::time::timeout;

use super::{ApiState, error::ApiError, heavy::HeavyWork, queries};
use crate::{lab::drawing::Overlay, model::hub::Picture};

/// Memory of a drawing and its JPEG file.
pub(super) const BYTES_PER_PIXEL: usize = 6;
/// Time to wait for a new picture: enough for a camera at 1 Hz.
const FRAME_TIMEOUT: Duration = Duration::from_secs(1);

/// A camera's picture as JPEG, with its capture time: a new one if it arrives in time, else the last one.
pub(super) async fn newest(api: &ApiState, name: &str) -> Result<(Bytes, Timestamp), ApiError> {
    let id = queries::camera_id(api, name)?;
    let pictures = api.hub.request_picture(id);
    let mut pictures = pictures.ok_or_else(|| queries::no_camera(api, name))?;
    tokio::select! {
        _ = timeout(FRAME_TIMEOUT, pictures.changed()) => {}
        () = api.cancel.cancelled() => {}
    }
    let newest = pictures.borrow().clone();
    let Some(picture) = newest else {
        let shown = queries::camera(api, name)?;
        let status = roundel_proto::json::camera_status::word(shown.status);
        let link = api.hub.camera(id).and_then(|state| state.link);
        let why = match &link {
            _ if !shown.error.is_empty() => &shown.error,
            Some(link) if !link.no_picture.is_empty() => &link.no_picture,
            Some(link) if link.received > 0 => {
                "the remote program that searches its frames sent no picture on request"
            }
            _ => "no frame has arrived yet",
        };
        return Err(ApiError::Unavailable(format!(
            "no picture from camera {name:?} within a second: it is {status} ({why})"
        )));
    };
    let info = api.hub.installation().cameras.get(&id).cloned();
    let mask = info.as_ref().map_or(&[][..], |info| &info.mask);
    let jpeg = jpeg(&api.pictures, &picture, mask).await?;
    Ok((jpeg, picture.observations.capture_time))
}

/// The picture as JPEG, with the edges of its camera's masked regions. Concurrent calls share the work.
pub async fn jpeg(
    heavy: &HeavyWork,
    picture: &Arc<Picture>,
    mask: &[Vec<PixelPoint>],
) -> Result<Bytes, ApiError> {
    let draw = async || {
        let bytes = BYTES_PER_PIXEL * picture.pixels.len();
        let (picture, mask) = (picture.clone(), mask.to_vec());
        let jpeg = heavy.run(bytes, move |_| encode(&picture, &mask)).await?;
        // Kept with the picture, of which there is one per camera.
        Ok(jpeg.into_inner())
    };
    picture.jpeg.get_or_try_init(draw).await.cloned()
}

/// Draws the mask and the detections into the picture and encodes it.
pub fn encode(picture: &Picture, mask: &[Vec<PixelPoint>]) -> Result<Bytes, ApiError> {
    let Picture { width, height, pixels, .. } = picture;
    let is_side = |side: &usize| (1..=usize::from(u16::MAX)).contains(side);
    let (expected, found) = (width * height, pixels.len());
    if !is_side(width) || !is_side(height) || found != expected {
        return Err(ApiError::Internal(format!(
            "expected {expected} pixels for {width} x {height}, found {found}; a side has 1 to 65535"
        )));
    }
    let mut overlay = Overlay::new(*width, *height, pixels);
    for corners in mask {
        overlay.draw_polygon(corners);
    }
    for detection in &picture.observations.detections {
        overlay.draw_ring(&detection.ring, Some(detection.track));
    }
    let jpeg = overlay.jpeg().map(Bytes::from);
    jpeg.map_err(|error| ApiError::Internal(format!("could not encode the picture: {error}")))
}
