//! The entrances of all cameras that are fed.

use std::{
    collections::BTreeMap,
    sync::{Arc, PoisonError, RwLock},
};

use roundel_core::id::CameraId;

use super::PushEndpoint;

/// Which camera has which port; cameras come and go.
#[derive(Default)]
pub struct PushEndpoints(RwLock<BTreeMap<CameraId, Arc<PushEndpoint>>>);

impl PushEndpoints {
    /// Where that camera is fed; `None` of one that is not.
    pub fn get(&self, camera: CameraId) -> Option<Arc<PushEndpoint>> {
        self.0.read().unwrap_or_else(PoisonError::into_inner).get(&camera).cloned()
    }

    /// Has a camera be fed; one that is goes on with the port that it has.
    pub fn open(&self, camera: CameraId) -> Arc<PushEndpoint> {
        let mut ports = self.0.write().unwrap_or_else(PoisonError::into_inner);
        ports.entry(camera).or_default().clone()
    }

    /// Has a camera be fed no more; who feeds it is sent away.
    pub fn close(&self, camera: CameraId) {
        let port = self.0.write().unwrap_or_else(PoisonError::into_inner).remove(&camera);
        if let Some(port) = port {
            port.close();
        }
    }
}
