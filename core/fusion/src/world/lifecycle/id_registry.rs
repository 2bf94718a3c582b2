//! Whose code is whose: an object that was lost and comes back is the same object.
//!
//! The first track that is trusted and whose code is settled gives the code its object id, for good; the
//! first of a body gives it to the body. A later track with that code or body takes the id over, unless another track carries it that is seen right now:
//! then one code is there twice (two prints of it, or a track that drifted onto another robot), which no
//! rule can mend, and which is counted. A track that only less trusted cameras see gives the id up all the same.

use std::collections::BTreeMap;

use super::{track::Track, trust::Trust};
use crate::world::identity::Mark;
use roundel_vision::{
    id::{KindId, ObjectId},
    time::Timestamp,
};

/// The ids of all codes that were ever settled, and of all bodies that were ever seen.
#[derive(Clone, Debug, Default)]
pub(in crate::world) struct IdRegistry {
    by_mark: BTreeMap<(Option<KindId>, Mark), ObjectId>,
}

/// What a track's mark says of its id.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::world) enum Claim {
    /// It is its own.
    Own,
    /// It is that of an object that no track carries.
    Reappeared(ObjectId),
    /// It is that of the track with this index, which is not seen now.
    Moved(usize, ObjectId),
    /// It is that of another track that is seen as well.
    Ambiguous,
}

impl IdRegistry {
    /// The object that goes by a mark.
    pub(in crate::world) fn id_of(&self, kind: Option<KindId>, mark: Mark) -> Option<ObjectId> {
        self.by_mark.get(&(kind, mark)).copied()
    }

    /// Has an object go by another mark, unless that is another object's.
    pub(in crate::world) fn alias(
        &mut self,
        from: (Option<KindId>, Mark),
        to: (Option<KindId>, Mark),
    ) {
        if let Some(id) = self.id_of(from.0, from.1) {
            self.by_mark.entry(to).or_insert(id);
        }
    }

    /// Nothing goes by a mark any more.
    pub(in crate::world) fn remove(&mut self, kind: Option<KindId>, mark: Mark) {
        self.by_mark.remove(&(kind, mark));
    }

    /// Settles whose id the track with this index has, of all tracks; `fresh_ns` ago a track is seen now,
    /// unless it is one of the same body that was not seen since this one began.
    pub(in crate::world) fn claim(
        &mut self,
        tracks: &[Track],
        index: usize,
        mark: Mark,
        trust: &Trust,
        (now, fresh_ns): (Timestamp, i64),
    ) -> Claim {
        let track = &tracks[index];
        let id = *self.by_mark.entry((track.subject.kind, mark)).or_insert(track.id);
        if id == track.id {
            return Claim::Own;
        }
        match tracks.iter().position(|other| other.id == id) {
            None => Claim::Reappeared(id),
            Some(other) => {
                let newest = tracks[other].newest;
                let is_other_track_old = track.subject.body.is_some() && newest < track.first;
                let is_outranked = trust.of_track(&tracks[other]) < trust.of_track(track);
                if is_other_track_old || is_outranked || now.ns_since(newest) > fresh_ns {
                    Claim::Moved(other, id)
                } else {
                    Claim::Ambiguous
                }
            }
        }
    }
}
