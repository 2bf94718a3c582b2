//! Tracks from the first detection to loss.

mod coarse;
mod id_registry;
mod merge;
mod track;
mod trust;

pub(super) use coarse::Coarse;
pub(super) use id_registry::{Claim, Identities};
pub(super) use merge::find;
pub(super) use track::{Track, View};
pub(super) use trust::{DEFAULT_TRUST, Trust};
