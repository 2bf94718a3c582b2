//! Where a worker gets its camera's pose from.

use roundel_core::{
    id::KindId,
    world::{CameraPlacement, reference::Reference},
};

use super::pose_search::PoseSearch;
use crate::model::hub::{CameraPoseState, PoseStatus};

#[derive(Clone, Debug)]
pub enum PoseSource {
    Fixed(PoseStatus, Box<CameraPlacement>),
    /// To be found from roundels of these kinds at these positions.
    Unknown {
        references: Vec<Reference>,
        kinds: Vec<KindId>,
    },
    /// Mounted on an object: fusion determines the pose.
    Mounted,
    /// Keeps the current pose.
    Unchanged,
}

impl PoseSource {
    /// The pose state to show before the first frame; `None` if the hub has it, or gets it from fusion.
    pub fn initial_state(&self) -> Option<CameraPoseState> {
        match self {
            Self::Fixed(status, placement) => Some(CameraPoseState::fixed(*status, **placement)),
            Self::Unknown { .. } => Some(CameraPoseState::searching(
                "searching for the reference roundels, of which it must see three",
            )),
            Self::Mounted | Self::Unchanged => None,
        }
    }

    pub(super) fn start_search(&self) -> Option<PoseSearch> {
        let Self::Unknown { references, kinds } = self else { return None };
        Some(PoseSearch::new(references.clone(), kinds.clone()))
    }
}
