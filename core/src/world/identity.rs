//! Whose code is whose: an object that was lost and comes back is the same object.
//!
//! The first track that is trusted and whose code is settled gives the code its object id, for good. A
//! later track with that code takes the id over, unless another track carries it that is seen right now:
//! then one code is there twice (two prints of it, or a track that drifted onto another robot), which no
//! rule can mend, and which is counted.

use std::collections::BTreeMap;

use super::life::Track;
use crate::{
    id::{KindId, ObjectId},
    marker::Code,
    time::Timestamp,
};

/// The ids of all codes that were ever settled.
#[derive(Clone, Debug, Default)]
pub(super) struct Identities {
    by_code: BTreeMap<(Option<KindId>, Code), ObjectId>,
}

/// What a track's settled code says of its id.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Claim {
    /// It is its own.
    Own,
    /// It is that of an object that no track carries.
    Returned(ObjectId),
    /// It is that of the track with this index, which is not seen now.
    Elsewhere(usize, ObjectId),
    /// It is that of another track that is seen as well.
    Twice,
}

impl Identities {
    /// Settles whose id the track with this index has, of all tracks; `fresh_ns` ago a track is seen now.
    pub(super) fn claim(
        &mut self,
        tracks: &[Track],
        index: usize,
        code: Code,
        (now, fresh_ns): (Timestamp, i64),
    ) -> Claim {
        let track = &tracks[index];
        let id = *self.by_code.entry((track.kind, code)).or_insert(track.id);
        if id == track.id {
            return Claim::Own;
        }
        match tracks.iter().position(|other| other.id == id) {
            None => Claim::Returned(id),
            Some(other) if now.ns_since(tracks[other].newest) > fresh_ns => {
                Claim::Elsewhere(other, id)
            }
            Some(_) => Claim::Twice,
        }
    }
}
