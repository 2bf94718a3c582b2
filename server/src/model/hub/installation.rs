//! What an installation consists of, by name. Cameras come and go; an id is never given twice.

use std::{collections::BTreeMap, sync::Arc};

use roundel_core::{
    id::{BodyId, CameraId, KindId},
    time::Timestamp,
};

use super::CameraInfo;

/// What is known of a server beside how it is doing. Cameras and objects come and go while a server runs.
#[derive(Clone, Debug)]
pub struct Installation {
    pub name: String,
    /// Tells this run of this server from every other.
    pub source_id: String,
    pub started: Timestamp,
    /// Snapshots a second.
    pub snapshot_rate_hz: f64,
    /// In the order of the configuration, since those that are added go to its end.
    pub cameras: BTreeMap<CameraId, Arc<CameraInfo>>,
    /// Names of the kinds of roundel, by [`KindId`].
    pub kinds: Vec<String>,
    /// Configured names of objects that are known by a whole kind, by that.
    pub object_names: BTreeMap<KindId, String>,
    /// Configured names of all others, by [`BodyId`]; empty of one that was removed.
    pub body_names: Vec<String>,
}

/// What an object of the configuration is known by.
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
        let kind = self.object_names.iter().find(|(_, known)| *known == name);
        let body = || (0..).zip(&self.body_names).find(|(_, known)| *known == name);
        kind.map(|(kind, _)| ObjectKey::Kind(*kind))
            .or_else(|| body().map(|(index, _)| ObjectKey::Body(BodyId(index))))
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
