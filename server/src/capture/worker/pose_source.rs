//! Where a worker's camera stands, as far as the worker knows.

use roundel_core::{
    id::KindId,
    world::{CameraPlacement, reference::Reference},
};

use super::pose_search::PoseSearch;
use crate::model::hub::{CameraPoseState, PoseStatus};

/// Where a worker's camera stands.
#[derive(Clone, Debug)]
pub enum PoseSource {
    /// Known from the start, and how.
    Fixed(PoseStatus, Box<CameraPlacement>),
    /// To be found from roundels of these kinds at these places.
    Unknown { references: Vec<Reference>, kinds: Vec<KindId> },
    /// On an object: fusion says where.
    Mounted,
    /// Where it did before: nothing is said of it anew.
    Unchanged,
}

impl PoseSource {
    /// What the hub shows of it before a frame has come; `None`: what it shows already, or what fusion says.
    pub fn initial_state(&self) -> Option<CameraPoseState> {
        match self {
            Self::Fixed(status, placement) => Some(CameraPoseState::fixed(*status, **placement)),
            Self::Unknown { .. } => Some(CameraPoseState::searching(
                "it looks for the reference roundels, of which it must see three",
            )),
            Self::Mounted | Self::Unchanged => None,
        }
    }

    /// What finds it, where it is to be found.
    pub(super) fn start_search(&self) -> Option<PoseSearch> {
        match self {
            Self::Unknown { references, kinds } => {
                Some(PoseSearch::new(references.clone(), kinds.clone()))
            }
            Self::Fixed(..) | Self::Mounted | Self::Unchanged => None,
        }
    }
}
