//! Identity and times of a frame, as a camera and the server state them.

use roundel_vision::{id::CameraId, time::Timestamp};

use crate::world::FrameObservations;

/// Identity and times of a frame.
#[derive(Clone, Copy, Debug)]
pub(in crate::world) struct FrameStamp {
    pub(in crate::world) camera: CameraId,
    pub(in crate::world) number: u64,
    /// Capture time by the camera's clock.
    pub(in crate::world) stamp: Timestamp,
    pub(in crate::world) received: Timestamp,
}

impl From<&FrameObservations> for FrameStamp {
    fn from(frame: &FrameObservations) -> Self {
        Self {
            camera: frame.camera,
            number: frame.frame,
            stamp: frame.capture_time,
            received: frame.received_time,
        }
    }
}
