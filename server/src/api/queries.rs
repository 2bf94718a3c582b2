//! What the hub has, in the words of the wire; REST and the WebSocket give the same.

use std::sync::Arc;

use roundel_core::id::CameraId;
use roundel_proto::v1;
use tokio::sync::broadcast::{self, error::RecvError};

use crate::{
    api::{ApiState, convert, error::ApiError, selection::Selection},
    model::hub,
};

/// The newest snapshot as a subscriber of `selection` would get it.
pub(super) fn newest_snapshot(
    api: &ApiState,
    selection: &Selection,
) -> Result<v1::Snapshot, ApiError> {
    let fused = api.hub.snapshots().borrow().clone();
    if fused.sequence == 0 {
        return Err(ApiError::Unavailable(
            "no snapshot yet: fusion has not made its first one; try again in a moment".into(),
        ));
    }
    let mut message = selection.filter.message(&api.hub.installation(), &fused);
    message.sent_time_ns = api.clock.now().as_ns();
    Ok(message)
}

/// The newest frame of each of these cameras, or of all.
pub(super) fn newest_observations(
    api: &ApiState,
    names: &[String],
) -> Result<v1::GetObservationsResponse, ApiError> {
    let wanted: Vec<CameraId> =
        names.iter().map(|name| camera_id(api, name)).collect::<Result<_, _>>()?;
    let installation = api.hub.installation();
    let newest = api.hub.newest_observations().into_iter();
    let chosen = newest.filter(|frame| wanted.is_empty() || wanted.contains(&frame.camera));
    let frames = chosen.map(|frame| convert::observations(&installation, &frame)).collect();
    Ok(v1::GetObservationsResponse { frames })
}

/// Every camera, in the order of the configuration.
pub(super) fn cameras(api: &ApiState) -> Vec<v1::Camera> {
    let (installation, states) = (api.hub.installation(), api.hub.cameras());
    let each = states.iter().filter(|(id, _)| installation.cameras.contains_key(id));
    each.map(|(id, state)| convert::camera(&installation, *id, state)).collect()
}

pub(super) fn camera(api: &ApiState, id: CameraId) -> Result<v1::Camera, ApiError> {
    match api.hub.camera(id) {
        Some(state) => Ok(convert::camera(&api.hub.installation(), id, &state)),
        None => Err(removed_camera_error(api, id)),
    }
}

/// The error of a camera that was there when the request came.
pub(super) fn removed_camera_error(api: &ApiState, id: CameraId) -> ApiError {
    let installation = api.hub.installation();
    let names: Vec<&str> = installation.cameras.values().map(|c| c.name.as_str()).collect();
    let known = format!("it was removed; there are: {}", names.join(", "));
    ApiError::NotFound { what: "camera", name: format!("{}", id.0), known }
}

/// Every object that is remembered, by id.
pub(super) fn objects(api: &ApiState) -> Vec<v1::Object> {
    let records = api.hub.objects();
    records.iter().map(|record| convert::object(&api.hub.installation(), record)).collect()
}

/// The id of the camera of that name, or an error that names those there are.
pub(super) fn camera_id(api: &ApiState, name: &str) -> Result<CameraId, ApiError> {
    let installation = api.hub.installation();
    installation.camera_id(name).ok_or_else(|| {
        let names: Vec<&str> = installation.cameras.values().map(|c| c.name.as_str()).collect();
        let known = if names.is_empty() {
            "this installation has none".to_owned()
        } else {
            format!("there are: {}", names.join(", "))
        };
        ApiError::NotFound { what: "camera", name: name.to_owned(), known }
    })
}

/// A wish for remembered events that the hub can fulfil.
pub(super) fn checked_backlog(backlog: u32, field: &str) -> Result<usize, ApiError> {
    let backlog = backlog as usize;
    if backlog > hub::EVENT_LOG_LEN {
        let expected = format!("at most {} events", hub::EVENT_LOG_LEN);
        return Err(ApiError::invalid(field, expected, backlog));
    }
    Ok(backlog)
}

/// The next event; those that a slow reader missed show as a gap in the sequence.
pub(super) async fn next_event(
    receiver: &mut broadcast::Receiver<Arc<hub::Event>>,
) -> Option<Arc<hub::Event>> {
    loop {
        match receiver.recv().await {
            Ok(event) => return Some(event),
            Err(RecvError::Lagged(_)) => {}
            Err(RecvError::Closed) => return None,
        }
    }
}

pub(super) fn server_info(api: &ApiState) -> v1::ServerInfo {
    v1::ServerInfo {
        records: api.recorder.is_some(),
        replays: api.replay.is_some(),
        keeps_history: api.history.is_some(),
        allows_setup: api.camera_manager.is_some(),
        ..convert::server_info(&api.hub.installation())
    }
}
