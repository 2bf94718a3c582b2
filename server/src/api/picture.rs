//! A camera's frame with what was found in it drawn in, as JPEG.
//!
//! What the colours mean stands in [`crate::lab::drawing`]. Drawing and encoding take some milliseconds a frame, so they run off the async threads,
//! and once for all who look at the same frame.

use std::{sync::Arc, time::Duration};

use axum::body::Bytes;
use roundel_core::{camera::PixelPoint, time::Timestamp};
use tokio::time::timeout;

use super::{ApiState, error::ApiError, queries};
use crate::{lab::drawing::Overlay, model::hub::Picture};

/// How long a picture may take to come: a camera of 1 Hz still makes one.
const FRAME_TIMEOUT: Duration = Duration::from_secs(1);

/// The newest picture of the camera of that name as JPEG, and when it was taken: a new one if one comes soon, else the
/// last there was.
pub(super) async fn newest(api: &ApiState, name: &str) -> Result<(Bytes, Timestamp), ApiError> {
    let id = queries::camera_id(api, name)?;
    let Some(mut pictures) = api.hub.request_picture(id) else {
        return Err(queries::removed_camera_error(api, id));
    };
    let fresh = timeout(FRAME_TIMEOUT, pictures.changed());
    tokio::select! {
        // Whether it came or not: the newest is taken below.
        _ = fresh => {}
        () = api.cancel.cancelled() => {}
    }
    let newest = pictures.borrow().clone();
    let Some(picture) = newest else {
        let shown = queries::camera(api, id)?;
        let status = roundel_proto::json::camera_status::word(shown.status);
        let link = api.hub.camera(id).and_then(|state| state.link);
        let why = match &link {
            _ if !shown.error.is_empty() => &shown.error,
            Some(link) if !link.no_picture.is_empty() => &link.no_picture,
            Some(link) if link.received > 0 => {
                "its frames are searched where they are taken, and who sends what is seen gave none when asked"
            }
            _ => "no frame came yet",
        };
        return Err(ApiError::Unavailable(format!(
            "no picture from camera {name:?} within a second: it is {status} ({why})"
        )));
    };
    let info = api.hub.installation().cameras.get(&id).cloned();
    let jpeg = jpeg(&picture, info.as_ref().map_or(&[], |info| &info.mask)).await?;
    Ok((jpeg, picture.observations.capture_time))
}

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
    if !sides.is_some_and(|(width, height)| width > 0 && height > 0) {
        return Err(ApiError::Internal(format!(
            "expected a picture of 1 to 65535 pixels a side, found {} x {}",
            picture.width, picture.height
        )));
    }
    let expected = picture.width * picture.height;
    if picture.pixels.len() != expected {
        return Err(ApiError::Internal(format!(
            "expected {expected} pixels for {} x {}, found {}",
            picture.width,
            picture.height,
            picture.pixels.len()
        )));
    }
    let mut overlay = Overlay::new(picture.width, picture.height, &picture.pixels);
    for corners in mask {
        overlay.draw_polygon(corners);
    }
    for detection in &picture.observations.detections {
        overlay.draw_ring(&detection.ring, Some(detection.track));
    }
    let jpeg = overlay.jpeg();
    jpeg.map(Bytes::from)
        .map_err(|error| ApiError::Internal(format!("could not encode the picture: {error}")))
}
