//! What the watch tells.

use roundel_fusion::world::CameraPlacement;
use roundel_vision::id::CameraId;

/// What became known of cameras' places.
#[derive(Clone, Debug, PartialEq)]
pub enum WatchEvent {
    /// It does not stand where it did: it is to be left out.
    Bumped {
        /// Which.
        camera: CameraId,
        /// How far it moved, as far as is known at once, metres.
        moved_m: f64,
        /// And turned, radians.
        turned_rad: f64,
    },
    /// It rests, and this is where: it is to be used again.
    Returned {
        /// Which.
        camera: CameraId,
        /// Where.
        placement: CameraPlacement,
    },
    /// It drifted, and stands here now; it was good enough to be used all the time.
    Drifted {
        /// Which.
        camera: CameraId,
        /// Where.
        placement: CameraPlacement,
        /// By how much what it sees moves with that, rms, metres.
        moved_m: f64,
    },
    /// One of these moved; which of them cannot be known.
    Contradiction {
        /// Ascending.
        cameras: Vec<CameraId>,
    },
    /// These stand where somebody said, have not agreed with others since, and nobody can tell who is wrong: they were
    /// not bumped, but never measured well. Told once.
    Misplaced {
        /// Ascending.
        cameras: Vec<CameraId>,
    },
    /// They agree again, or it is known who moved.
    Agreed {
        /// As they were named before.
        cameras: Vec<CameraId>,
    },
}

/// How a camera stands to the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WatchState {
    /// Others see what it sees.
    Watched,
    /// Others see it elsewhere; who is right is not known yet, or cannot be.
    Suspected,
    /// It was bumped.
    Quarantined,
    /// Of late no other saw what it sees.
    Alone,
}

/// What is known of how right a camera's place is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraHealth {
    /// How it stands to the others.
    pub state: WatchState,
    /// By how much it would have to move to agree best with the others, metres …
    pub error_m: f64,
    /// … and to turn, radians.
    pub error_rad: f64,
    /// Standard deviations of both.
    pub deviation_m: f64,
    /// Radians.
    pub deviation_rad: f64,
    /// What it sees is off by so much, rms, metres.
    pub seen_error_m: f64,
}
