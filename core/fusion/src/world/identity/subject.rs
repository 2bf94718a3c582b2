//! What tracks and sightings are compared by before their positions: kind, body, code.

use roundel_vision::{
    id::{BodyId, KindId, TrackNumber},
    marker::Code,
};

/// Track number of a carrier as measured by its own camera. A camera's tracker counts up from 1.
pub(in crate::world) const CARRIER_NUMBER: TrackNumber = TrackNumber(u64::MAX);

/// What a track or a sighting is of; what differs in it is never the same object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::world) struct Subject {
    /// Its kind of roundel; of a body that of its first one.
    pub(in crate::world) kind: Option<KindId>,
    /// Which body its roundels are of, if they are of one.
    pub(in crate::world) body: Option<BodyId>,
}

/// What says which object a track is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::world) enum Mark {
    /// A settled code.
    Code(Code),
    /// The body.
    Body(BodyId),
}

/// Track number under which every camera measures a body. These count down from below [`CARRIER_NUMBER`].
pub(in crate::world) fn body_number(body: BodyId) -> TrackNumber {
    TrackNumber(CARRIER_NUMBER.0 - 1 - u64::from(body.0))
}
