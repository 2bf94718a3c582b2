//! Ranks of cameras: what a less trusted camera reports does not move an object that a more trusted one observes.
//!
//! A remote program may report anything, with any covariance. Gates and robust weights do not protect against a report
//! that is wrong but consistent, so cameras have ranks. A detection is left out if a camera of higher rank has observed
//! the same object within [`RECENT_NS`]. A less trusted camera is not asked whether a more trusted one has moved, and
//! its track gives up an object's id to a track that a more trusted camera observes.
//!
//! Limits: an object that only less trusted cameras observe is theirs; [`super::super::ObjectState::trust`] shows it.

use std::collections::BTreeMap;

use super::track::Track;
use roundel_vision::{id::CameraId, time::Timestamp};

/// Rank of a camera without a configured one.
pub(crate) const DEFAULT_TRUST: u8 = 1;
/// A camera still counts as observing an object for this long after its last detection.
const RECENT_NS: i64 = 200_000_000;

#[derive(Clone, Debug, Default)]
pub(crate) struct Trust {
    /// Only ranks other than [`DEFAULT_TRUST`].
    ranks: BTreeMap<CameraId, u8>,
}

impl Trust {
    pub(crate) fn set(&mut self, camera: CameraId, rank: u8) {
        if rank == DEFAULT_TRUST {
            self.ranks.remove(&camera);
        } else {
            self.ranks.insert(camera, rank);
        }
    }

    pub(crate) fn rank(&self, camera: CameraId) -> u8 {
        self.ranks.get(&camera).copied().unwrap_or(DEFAULT_TRUST)
    }

    /// Highest rank of the cameras that observe a track, or observed it last.
    pub(crate) fn of_track(&self, track: &Track) -> u8 {
        self.highest_since(track, track.newest.plus_ns(-RECENT_NS))
    }

    /// Whether a camera of higher rank observes the track.
    pub(crate) fn is_outranked(&self, camera: CameraId, track: &Track, time: Timestamp) -> bool {
        // Fast path: usually all cameras have one rank.
        !self.ranks.is_empty()
            && self.highest_since(track, time.plus_ns(-RECENT_NS)) > self.rank(camera)
    }

    fn highest_since(&self, track: &Track, since: Timestamp) -> u8 {
        track.cameras_since(since).map(|camera| self.rank(camera)).max().unwrap_or(0)
    }
}
