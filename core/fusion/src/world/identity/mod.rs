//! What identifies an object apart from its position: kind and body, and the code that most readings agree on.

mod code_vote;

pub(super) use code_vote::CodeVote;

use roundel_vision::{
    id::{BodyId, KindId, TrackNumber},
    marker::Code,
};

/// Track number of a carrier as measured by its own camera; a camera's tracker counts up from 1.
pub(super) const CARRIER_NUMBER: TrackNumber = TrackNumber(u64::MAX);

/// What a track or sighting shows; different subjects are never the same object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Subject {
    /// Kind of its roundel; of the first roundel for a body.
    pub(super) kind: Option<KindId>,
    /// The body, if its roundels belong to one.
    pub(super) body: Option<BodyId>,
}

/// Proof of which object a track is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Mark {
    Code(Code),
    Body(BodyId),
}

/// Track number under which every camera measures a body. These count down from below [`CARRIER_NUMBER`].
pub(super) fn body_number(body: BodyId) -> TrackNumber {
    TrackNumber(CARRIER_NUMBER.0 - 1 - u64::from(body.0))
}
