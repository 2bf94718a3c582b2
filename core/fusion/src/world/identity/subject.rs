//! Kind, body and code: what identifies tracks and sightings apart from their positions.

use roundel_vision::{
    id::{BodyId, KindId, TrackNumber},
    marker::Code,
};

/// Track number of a carrier as measured by its own camera; a camera's tracker counts up from 1.
pub(in crate::world) const CARRIER_NUMBER: TrackNumber = TrackNumber(u64::MAX);

/// What a track or sighting shows; different subjects are never the same object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::world) struct Subject {
    /// Kind of its roundel; of the first roundel for a body.
    pub(in crate::world) kind: Option<KindId>,
    /// The body, if its roundels belong to one.
    pub(in crate::world) body: Option<BodyId>,
}

/// Proof of which object a track is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::world) enum Mark {
    Code(Code),
    Body(BodyId),
}

/// Track number under which every camera measures a body. These count down from below [`CARRIER_NUMBER`].
pub(in crate::world) fn body_number(body: BodyId) -> TrackNumber {
    TrackNumber(CARRIER_NUMBER.0 - 1 - u64::from(body.0))
}
