//! The entrances of all cameras that are fed.

use std::{
    collections::BTreeMap,
    sync::{Arc, PoisonError, RwLock},
};

use roundel_core::id::CameraId;

use super::Port;

/// Which camera has which port; cameras come and go.
#[derive(Default)]
pub struct Ports(RwLock<BTreeMap<CameraId, Arc<Port>>>);

impl Ports {
    /// Where that camera is fed; `None` of one that is not.
    pub fn get(&self, camera: CameraId) -> Option<Arc<Port>> {
        self.0.read().unwrap_or_else(PoisonError::into_inner).get(&camera).cloned()
    }

    /// Has a camera be fed; one that is goes on with the port that it has.
    pub fn open(&self, camera: CameraId) -> Arc<Port> {
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
