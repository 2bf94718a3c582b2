//! Events and states of the camera supervision.

use roundel_fusion::world::CameraPlacement;
use roundel_vision::id::CameraId;

/// A change in the knowledge of camera poses. Lists of cameras are ascending.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "the comments of the variants cover their fields")]
pub enum WatchEvent {
    /// A camera was moved by about this and must not be used.
    Bumped { camera: CameraId, moved_m: f64, turned_rad: f64 },
    /// A moved camera rests and may be used again with its new pose.
    Returned { camera: CameraId, placement: CameraPlacement },
    /// A camera drifted and its pose was corrected; it stayed in use. `moved_m` is the rms displacement of its
    /// observations.
    Drifted { camera: CameraId, placement: CameraPlacement, moved_m: f64 },
    /// One of these cameras moved; it is ambiguous which.
    Contradiction { cameras: Vec<CameraId> },
    /// These manually placed cameras have never agreed with others: at least one stated pose is wrong. Reported
    /// once.
    Misplaced { cameras: Vec<CameraId> },
    /// The cameras of a contradiction agree again, or the moved one was found.
    Agreed { cameras: Vec<CameraId> },
}

/// Agreement of a camera with the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WatchState {
    /// Other cameras see the same roundels.
    Watched,
    /// It disagrees with others; the cause is unknown.
    Suspected,
    /// It was moved and is not in use.
    Quarantined,
    /// No other camera has recently seen the same roundels.
    Alone,
}

/// Quality of a camera's pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraHealth {
    /// Agreement with the others.
    pub state: WatchState,
    /// Displacement that would agree best with the others, metres.
    pub error_m: f64,
    /// Rotation that would agree best with the others, radians.
    pub error_rad: f64,
    /// Standard deviation of the displacement, metres.
    pub deviation_m: f64,
    /// Standard deviation of the rotation, radians.
    pub deviation_rad: f64,
    /// Rms displacement of its observations, metres.
    pub seen_error_m: f64,
}
