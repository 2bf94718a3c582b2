//! Names of an installation's cameras, kinds and objects. Ids are never reused.

use std::{collections::BTreeMap, sync::Arc};

use roundel_core::{
    id::{BodyId, CameraId, KindId},
    time::Timestamp,
};

use super::CameraInfo;

#[derive(Clone, Debug)]
pub struct Installation {
    pub name: String,
    /// Identifies this run of this server.
    pub source_id: String,
    pub started: Timestamp,
    /// Snapshots a second.
    pub snapshot_rate_hz: f64,
    /// In the order of the configuration.
    pub cameras: BTreeMap<CameraId, Arc<CameraInfo>>,
    /// Names of the kinds of roundel, by [`KindId`].
    pub kinds: Vec<String>,
    /// Names of the objects that are identified by their kind.
    pub object_names: BTreeMap<KindId, String>,
    /// Names of all other objects, by [`BodyId`]; empty if removed.
    pub body_names: Vec<String>,
}

/// What identifies a configured object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectKey {
    Kind(KindId),
    Body(BodyId),
}

impl Installation {
    /// Cameras numbered in their order.
    pub fn number_cameras(
        cameras: impl IntoIterator<Item = CameraInfo>,
    ) -> BTreeMap<CameraId, Arc<CameraInfo>> {
        (0..).map(CameraId).zip(cameras.into_iter().map(Arc::new)).collect()
    }

    /// The camera's name; empty if it was removed.
    pub fn camera_name(&self, id: CameraId) -> &str {
        self.cameras.get(&id).map_or("", |camera| &camera.name)
    }

    pub fn camera_id(&self, name: &str) -> Option<CameraId> {
        self.cameras.iter().find(|(_, camera)| camera.name == name).map(|(id, _)| *id)
    }

    pub fn object_key(&self, name: &str) -> Option<ObjectKey> {
        if let Some((kind, _)) = self.object_names.iter().find(|(_, known)| *known == name) {
            return Some(ObjectKey::Kind(*kind));
        }
        let index = self.body_names.iter().position(|known| known == name)?;
        Some(ObjectKey::Body(BodyId(index as u32)))
    }

    /// The kind's name; empty for no kind.
    pub fn kind_name(&self, kind: Option<KindId>) -> &str {
        kind.and_then(|kind| self.kinds.get(usize::from(kind.0))).map_or("", String::as_str)
    }

    /// The configured name of an object, or empty.
    pub fn object_name(&self, kind: Option<KindId>, body: Option<BodyId>) -> &str {
        let name = match body {
            Some(body) => self.body_names.get(body.0 as usize),
            None => kind.and_then(|kind| self.object_names.get(&kind)),
        };
        name.map_or("", String::as_str)
    }
}
