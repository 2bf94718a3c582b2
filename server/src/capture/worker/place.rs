//! Where a worker's camera stands, as far as the worker knows.

use roundel_core::{
    id::KindId,
    world::{CameraPlacement, reference::Reference},
};

use super::placing::Placing;
use crate::model::hub::{CameraPlace, PoseStatus};

/// Where a worker's camera stands.
#[derive(Clone, Debug)]
pub enum Place {
    /// Known from the start, and how.
    Standing(PoseStatus, Box<CameraPlacement>),
    /// To be found from roundels of these kinds at these places.
    Unknown {
        /// The references.
        references: Vec<Reference>,
        /// Their kinds of roundel.
        kinds: Vec<KindId>,
    },
    /// On an object: fusion says where.
    Rides,
    /// Where it did before: nothing is said of it anew.
    Kept,
}

impl Place {
    /// What the hub shows of it before a frame has come; `None`: what it shows already, or what fusion says.
    pub fn shown(&self) -> Option<CameraPlace> {
        match self {
            Self::Standing(status, placement) => Some(CameraPlace::standing(*status, **placement)),
            Self::Unknown { .. } => Some(CameraPlace::searching(
                "it looks for the reference roundels, of which it must see three",
            )),
            Self::Rides | Self::Kept => None,
        }
    }

    /// What finds it, where it is to be found.
    pub(super) fn search(&self) -> Option<Placing> {
        match self {
            Self::Unknown { references, kinds } => {
                Some(Placing::new(references.clone(), kinds.clone()))
            }
            Self::Standing(..) | Self::Rides | Self::Kept => None,
        }
    }
}
