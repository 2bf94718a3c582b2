//! What has happened once, and of what it is told.

use roundel_core::{
    id::{CameraId, ObjectId},
    time::Timestamp,
    world,
};

use super::camera::CameraStatus;

/// What became of an object of the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConfigChange {
    Added,
    Changed,
    /// It is there no more.
    Removed,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventKind {
    /// A change in an object's life.
    ObjectStageChanged(ObjectId, world::EventKind),
    /// An object is configured otherwise than before; as which it is followed, if it is.
    ObjectConfigured(ConfigChange, Option<ObjectId>),
    /// A camera was added while the server runs.
    CameraAdded(CameraId),
    /// A camera is configured otherwise than before.
    CameraChanged(CameraId),
    /// A camera was removed while the server runs.
    CameraRemoved(CameraId),
    /// A camera's new status.
    CameraStatusChanged(CameraId, CameraStatus),
    /// A camera gives another number of frames a second than was promised.
    CameraRateOff(CameraId),
    /// It gives what was promised again.
    CameraRateAgrees(CameraId),
    /// A camera's clock was set, or is of another epoch.
    CameraClockSet(CameraId),
    /// Where a camera is became known.
    CameraPlaced(CameraId),
    /// Where a camera is has not been known for a while.
    CameraUnplaced(CameraId),
    /// A camera moved, and is left out.
    CameraBumped(CameraId),
    /// Where it stands now is known.
    CameraReturned(CameraId),
    /// A camera's place was corrected a little.
    CameraDrifted(CameraId),
    /// Cameras contradict one another, and which of them moved cannot be known.
    CamerasContradict,
    /// Cameras never agreed: their configured poses are not exact enough.
    CamerasMisplaced,
    CamerasAgree,
    /// What drives is not as high as was configured.
    HeightContradicted,
    /// A calibration of the arena records.
    CalibrationBegun,
    CalibrationDone,
    /// There is none, and why.
    CalibrationFailed,
    /// Cameras take a result over, or a kept one is left out.
    CalibrationApplied,
    /// What happens is recorded from now on.
    RecordingBegun,
    RecordingEnded,
    RecordingFailed,
    RecordingLossy,
}

impl EventKind {
    /// The camera that it is about, if it is about one.
    pub fn camera(&self) -> Option<CameraId> {
        match *self {
            Self::CameraAdded(id)
            | Self::CameraChanged(id)
            | Self::CameraRemoved(id)
            | Self::CameraStatusChanged(id, _)
            | Self::CameraRateOff(id)
            | Self::CameraRateAgrees(id)
            | Self::CameraClockSet(id)
            | Self::CameraPlaced(id)
            | Self::CameraUnplaced(id)
            | Self::CameraBumped(id)
            | Self::CameraReturned(id)
            | Self::CameraDrifted(id) => Some(id),
            Self::ObjectStageChanged(..)
            | Self::ObjectConfigured(..)
            | Self::CamerasContradict
            | Self::CamerasMisplaced
            | Self::CamerasAgree
            | Self::HeightContradicted
            | Self::CalibrationBegun
            | Self::CalibrationDone
            | Self::CalibrationFailed
            | Self::CalibrationApplied
            | Self::RecordingBegun
            | Self::RecordingEnded
            | Self::RecordingFailed
            | Self::RecordingLossy => None,
        }
    }
}

/// Something that happened once.
#[derive(Clone, Debug)]
pub struct Event {
    /// Grows by one with each event.
    pub sequence: u64,
    pub time: Timestamp,
    pub kind: EventKind,
    /// Name of the camera that it is about, as of then; the camera may have been renamed or removed since.
    pub camera: String,
    pub message: String,
}
