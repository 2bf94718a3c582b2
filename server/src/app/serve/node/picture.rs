//! What a node's camera sees, for whoever looks at it through the server.

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

/// Whoever has asked the server waits for a second in all.
const FRAME_TIMEOUT: Duration = Duration::from_millis(700);
const QUALITY: u8 = 80;

/// Answers each time that the server asks for a picture of the camera.
pub(super) async fn answer_requests(hub: Arc<Hub>, pushers: Arc<Vec<Pusher>>, index: usize) {
    let (pusher, camera) = (&pushers[index], CameraId(index as u32));
    let mut requests = pusher.picture_requests();
    while requests.changed().await.is_ok() {
        requests.mark_unchanged();
        pusher.picture(newest(&hub, camera).await);
    }
}

/// The camera's next frame, or the newest one that somebody has asked for; or why there is none.
async fn newest(hub: &Hub, camera: CameraId) -> v1::PushedPicture {
    let without = |error: &str| v1::PushedPicture { error: error.into(), ..Default::default() };
    let Some(mut pictures) = hub.request_picture(camera) else {
        return without("the node has no such camera");
    };
    // Whether it came or not: the newest is taken.
    let _ = timeout(FRAME_TIMEOUT, pictures.changed()).await;
    let Some(picture) = pictures.borrow().clone() else {
        let state = hub.camera(camera).unwrap_or_default();
        let why = if state.error.is_empty() { "no frame came yet" } else { &state.error };
        return without(why);
    };
    let observations = convert::observations(&hub.installation(), &picture.observations);
    match tokio::task::spawn_blocking(move || encode(&picture)).await {
        Ok(Ok(file)) => v1::PushedPicture {
            picture: Some(v1::pushed_picture::Picture::Jpeg(file)),
            observations: Some(observations),
            error: String::new(),
        },
        Ok(Err(why)) => without(&why),
        Err(error) => without(&error.to_string()),
    }
}

/// Grey, with nothing drawn in: the server does that.
fn encode(picture: &Picture) -> Result<Vec<u8>, String> {
    let sides = u16::try_from(picture.width).ok().zip(u16::try_from(picture.height).ok());
    let Some((width, height)) = sides else {
        return Err(format!("a picture of {} x {} is no JPEG", picture.width, picture.height));
    };
    let mut file = Vec::with_capacity(picture.pixels.len() / 4);
    let encoder = Encoder::new(&mut file, QUALITY);
    let encoded = encoder.encode(&picture.pixels, width, height, ColorType::Luma);
    encoded.map_err(|error| format!("could not encode the picture: {error}"))?;
    Ok(file)
}
