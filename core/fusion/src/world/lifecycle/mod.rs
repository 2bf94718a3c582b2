//! Life cycle of tracks: start, confirmation, ids, merging, loss, and the trust in the cameras that observe them.

mod coarse;
mod id_registry;
mod merge;
mod track;
mod trust;

pub(super) use coarse::Coarse;
pub(super) use id_registry::{Claim, IdRegistry};
pub(super) use merge::find_duplicates;
pub(super) use track::{CameraView, Track};
pub(super) use trust::{DEFAULT_TRUST, Trust};
