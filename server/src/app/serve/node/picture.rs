//! Pictures of a node's cameras, which the server requests for its clients.

use std::{sync::Arc, time::Duration};

use jpeg_encoder::{ColorType, Encoder};
use roundel_client::Pusher;
use roundel_core::id::CameraId;
use roundel_proto::v1;
use tokio::time::timeout;

use crate::model::{
    convert,
    hub::{Hub, Picture},
};

/// Time limit for a frame; the server's client waits for a second in all.
const FRAME_TIMEOUT: Duration = Duration::from_millis(700);
const QUALITY: u8 = 80;

pub(super) async fn answer_requests(hub: Arc<Hub>, pushers: Arc<Vec<Pusher>>, index: usize) {
    let (pusher, camera) = (&pushers[index], CameraId(index as u32));
    let mut requests = pusher.picture_requests();
    while requests.changed().await.is_ok() {
        requests.mark_unchanged();
        let picture = newest(&hub, camera).await;
        let without = |error| v1::PushedPicture { error, ..Default::default() };
        pusher.picture(picture.unwrap_or_else(without));
    }
}

/// The camera's next frame, or else the newest one; or the reason why there is none.
async fn newest(hub: &Hub, camera: CameraId) -> Result<v1::PushedPicture, String> {
    let mut pictures = hub.request_picture(camera).ok_or("the node has no such camera")?;
    // After a timeout the newest one is used.
    let _ = timeout(FRAME_TIMEOUT, pictures.changed()).await;
    let Some(picture) = pictures.borrow().clone() else {
        let error = hub.camera(camera).unwrap_or_default().error;
        return Err(if error.is_empty() { "no frame has arrived yet".to_owned() } else { error });
    };
    let observations = convert::observations(&hub.installation(), &picture.observations);
    let jpeg = tokio::task::spawn_blocking(move || encode(&picture)).await;
    Ok(v1::PushedPicture {
        picture: Some(v1::pushed_picture::Picture::Jpeg(jpeg.map_err(|e| e.to_string())??)),
        observations: Some(observations),
        error: String::new(),
    })
}

/// A grey JPEG; the server draws the detections.
fn encode(picture: &Picture) -> Result<Vec<u8>, String> {
    let sides = u16::try_from(picture.width).ok().zip(u16::try_from(picture.height).ok());
    let Some((width, height)) = sides else {
        return Err(format!(
            "a picture of {} x {} pixels is too large for JPEG",
            picture.width, picture.height
        ));
    };
    let mut file = Vec::with_capacity(picture.pixels.len() / 4);
    let encoder = Encoder::new(&mut file, QUALITY);
    let encoded = encoder.encode(&picture.pixels, width, height, ColorType::Luma);
    encoded.map_err(|error| format!("could not encode the picture: {error}"))?;
    Ok(file)
}
