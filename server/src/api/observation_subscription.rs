//! A subscription to the observations of cameras.

use std::{collections::BTreeMap, sync::Arc};

use roundel_core::{id::CameraId, world::FrameObservations};
use roundel_proto::v1;
use tokio::sync::{
    broadcast::{self, error::RecvError},
    watch,
};

use super::queries::camera_id;
use crate::{
    api::{ApiState, convert, error::ApiError},
    model::hub::Installation,
};

/// Yields the observations of some cameras, by name, or of all, frame by frame.
pub(super) struct ObservationSubscription {
    receiver: broadcast::Receiver<Arc<FrameObservations>>,
    installation: watch::Receiver<Arc<Installation>>,
    /// Empty: all.
    names: Vec<String>,
    /// The cameras that currently have these names.
    cameras: Vec<CameraId>,
    /// The newest frame sent, by camera.
    newest: BTreeMap<CameraId, u64>,
    ended: bool,
}

impl ObservationSubscription {
    pub(super) fn new(api: &ApiState, names: Vec<String>) -> Result<Self, ApiError> {
        let installation = api.hub.installations();
        let cameras = names.iter().map(|name| camera_id(api, name)).collect::<Result<_, _>>()?;
        let (receiver, newest) = (api.hub.observations(), BTreeMap::new());
        Ok(Self { receiver, installation, names, cameras, newest, ended: false })
    }

    /// The next frame, or a final error when none of the cameras is left.
    pub(super) async fn next(&mut self) -> Option<Result<v1::FrameObservations, ApiError>> {
        while !self.ended {
            let frame = tokio::select! {
                received = self.receiver.recv() => match received {
                    Ok(frame) => frame,
                    // Frame numbers show what was missed.
                    Err(RecvError::Lagged(_)) => continue,
                    Err(RecvError::Closed) => return None,
                },
                Ok(()) = self.installation.changed() => match self.update_cameras() {
                    Ok(()) => continue,
                    Err(error) => {
                        self.ended = true;
                        return Some(Err(error));
                    }
                },
            };
            if !self.names.is_empty() && !self.cameras.contains(&frame.camera) {
                continue;
            }
            let before = self.newest.insert(frame.camera, frame.frame);
            let installation = self.installation.borrow().clone();
            let mut message = convert::observations(&installation, &frame);
            // A camera counts its frames without gaps, so a gap is what this subscriber missed.
            message.missed = before.map_or(0, |before| frame.frame.saturating_sub(before + 1));
            return Some(Ok(message));
        }
        None
    }

    /// Follows added, removed and renamed cameras.
    fn update_cameras(&mut self) -> Result<(), ApiError> {
        let installation = self.installation.borrow_and_update().clone();
        self.cameras = self.names.iter().filter_map(|name| installation.camera_id(name)).collect();
        self.newest.retain(|id, _| installation.cameras.contains_key(id));
        if self.names.is_empty() || !self.cameras.is_empty() {
            return Ok(());
        }
        let name = self.names.join(", ");
        let known = "it was removed or renamed".to_owned();
        Err(ApiError::NotFound { what: "camera", name, known })
    }
}
