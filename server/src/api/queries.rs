//! Reads the hub's state as messages, for REST, gRPC and WebSockets.

use std::sync::Arc;

use roundel_core::id::CameraId;
use roundel_proto::v1;
use tokio::sync::broadcast::{self, error::RecvError};

use crate::{
    api::{ApiState, convert, error::ApiError, selection::Selection},
    model::hub,
};

/// The newest snapshot, filtered as for a subscriber of `selection`.
pub(super) fn newest_snapshot(
    api: &ApiState,
    selection: &Selection,
) -> Result<v1::Snapshot, ApiError> {
    let fused = api.hub.snapshots().borrow().clone();
    if fused.sequence == 0 {
        return Err(ApiError::Unavailable(
            "no snapshot yet: fusion has not published its first one; try again in a moment".into(),
        ));
    }
    let mut message = selection.filter.message(&api.hub.installation(), &fused);
    message.sent_time_ns = api.clock.now().as_ns();
    Ok(message)
}

/// The newest frame of each named camera; of all cameras if `names` is empty.
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

pub(super) fn camera(api: &ApiState, name: &str) -> Result<v1::Camera, ApiError> {
    let id = camera_id(api, name)?;
    let state = api.hub.camera(id).ok_or_else(|| no_camera(api, name))?;
    Ok(convert::camera(&api.hub.installation(), id, &state))
}

pub(super) fn camera_id(api: &ApiState, name: &str) -> Result<CameraId, ApiError> {
    api.hub.installation().camera_id(name).ok_or_else(|| no_camera(api, name))
}

/// An error that lists the existing cameras.
pub(super) fn no_camera(api: &ApiState, name: &str) -> ApiError {
    let installation = api.hub.installation();
    let names: Vec<&str> = installation.cameras.values().map(|it| it.name.as_str()).collect();
    let known = if names.is_empty() {
        "this installation has none".to_owned()
    } else {
        format!("there are: {}", names.join(", "))
    };
    ApiError::NotFound { what: "camera", name: name.to_owned(), known }
}

/// Checks a number of remembered events against the length of the hub's log.
pub(super) fn checked_backlog(backlog: u32) -> Result<usize, ApiError> {
    let backlog = backlog as usize;
    if backlog > hub::EVENT_LOG_LEN {
        let expected = format!("at most {} events", hub::EVENT_LOG_LEN);
        return Err(ApiError::invalid("backlog", expected, backlog));
    }
    Ok(backlog)
}

/// The next event; a gap in the sequence numbers shows missed ones.
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
