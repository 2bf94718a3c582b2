//! What has happened once, and of what it is told.

use roundel_core::{
    id::{CameraId, ObjectId},
    time::Timestamp,
    world,
};

use super::camera::CameraStatus;

/// What became of an object of the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// It is new there.
    Added,
    /// It is written otherwise.
    Changed,
    /// It is there no more.
    Removed,
}

/// What an event is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Happening {
    /// A change in an object's life.
    Object(ObjectId, world::EventKind),
    /// An object is configured otherwise than before; as which it is followed, if it is.
    Configured(Change, Option<ObjectId>),
    /// A camera was added while the server runs.
    Added(CameraId),
    /// A camera is configured otherwise than before.
    Changed(CameraId),
    /// A camera was removed while the server runs.
    Removed(CameraId),
    /// A camera's new status.
    Camera(CameraId, CameraStatus),
    /// A camera gives another number of frames a second than was promised.
    RateOff(CameraId),
    /// It gives what was promised again.
    RateAgrees(CameraId),
    /// A camera's clock was set, or is of another epoch.
    ClockSet(CameraId),
    /// Where a camera is became known.
    Placed(CameraId),
    /// Where a camera is has not been known for a while.
    Unplaced(CameraId),
    /// A camera moved, and is left out.
    Bumped(CameraId),
    /// Where it stands now is known.
    Returned(CameraId),
    /// A camera's place was corrected a little.
    Drifted(CameraId),
    /// Cameras contradict one another, and which of them moved cannot be known.
    Contradicted,
    /// Cameras never agreed: their configured poses are not exact enough.
    Misplaced,
    /// They agree again.
    Agreed,
    /// What drives is not as high as was configured.
    WrongHeight,
    /// A calibration of the arena records.
    CalibrationBegun,
    /// There is a result.
    CalibrationDone,
    /// There is none, and why.
    CalibrationFailed,
    /// Cameras take a result over, or a kept one is left out.
    CalibrationApplied,
    /// What happens is recorded from now on.
    RecordingBegun,
    /// A recording was ended.
    RecordingEnded,
    /// A recording ended by itself.
    RecordingFailed,
    /// A recording has gaps.
    RecordingLossy,
}

impl Happening {
    /// The camera that it is about, if it is about one.
    pub fn camera(&self) -> Option<CameraId> {
        match *self {
            Self::Added(id)
            | Self::Changed(id)
            | Self::Removed(id)
            | Self::Camera(id, _)
            | Self::RateOff(id)
            | Self::RateAgrees(id)
            | Self::ClockSet(id)
            | Self::Placed(id)
            | Self::Unplaced(id)
            | Self::Bumped(id)
            | Self::Returned(id)
            | Self::Drifted(id) => Some(id),
            Self::Object(..)
            | Self::Configured(..)
            | Self::Contradicted
            | Self::Misplaced
            | Self::Agreed
            | Self::WrongHeight
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
    /// When.
    pub time: Timestamp,
    /// What.
    pub happening: Happening,
    /// Name of the camera that it is about, as of then; the camera may have been renamed or removed since.
    pub camera: String,
    /// One sentence for a person.
    pub message: String,
}
