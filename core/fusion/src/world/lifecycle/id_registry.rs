//! Persistent ids: an object that was lost and returns gets the same id.
//!
//! The first confirmed track with a settled code binds its object id to the code for good, the first of a body to the
//! body. A later track with that code or body takes the id over, unless another track with the id is observed at
//! present. Then the code exists twice (two prints, or a track that drifted onto another robot), which is only counted.
//! A track that only less trusted cameras observe gives up the id in any case.

use std::collections::BTreeMap;

use super::{track::Track, trust::Trust};
use crate::world::identity::Mark;
use roundel_vision::{
    id::{KindId, ObjectId},
    time::Timestamp,
};

/// Ids of all codes ever settled and of all bodies ever observed.
#[derive(Clone, Debug, Default)]
pub(crate) struct IdRegistry {
    by_mark: BTreeMap<(Option<KindId>, Mark), ObjectId>,
}

/// Result of a track's claim to the id of its mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Claim {
    /// The track has the id already.
    Own,
    /// No track has the id.
    Reappeared(ObjectId),
    /// The track with this index has the id and is not observed at present.
    Moved(usize, ObjectId),
    /// Another track has the id and is observed as well.
    Ambiguous,
}

impl IdRegistry {
    /// Id bound to a mark.
    pub(crate) fn id_of(&self, kind: Option<KindId>, mark: Mark) -> Option<ObjectId> {
        self.by_mark.get(&(kind, mark)).copied()
    }

    /// Binds the id of one mark to another one as well, unless that has an id.
    pub(crate) fn alias(&mut self, from: (Option<KindId>, Mark), to: (Option<KindId>, Mark)) {
        if let Some(id) = self.id_of(from.0, from.1) {
            self.by_mark.entry(to).or_insert(id);
        }
    }

    /// Removes the binding of a mark.
    pub(crate) fn remove(&mut self, kind: Option<KindId>, mark: Mark) {
        self.by_mark.remove(&(kind, mark));
    }

    /// Decides whether the track at `index` gets the id of its mark. A track counts as observed if it was so
    /// since `fresh_since`, except one of the same body that was not observed since this one began.
    pub(crate) fn claim(
        &mut self,
        tracks: &[Track],
        index: usize,
        mark: Mark,
        trust: &Trust,
        fresh_since: Timestamp,
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
                if is_other_track_old || is_outranked || newest < fresh_since {
                    Claim::Moved(other, id)
                } else {
                    Claim::Ambiguous
                }
            }
        }
    }
}
