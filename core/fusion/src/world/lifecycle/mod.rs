//! Tracks from the first detection to loss.

pub(super) mod coarse;
pub(super) mod id_registry;
pub(super) mod merge;
pub(super) mod track;
pub(super) mod trust;
