//! What the hub holds of each camera: what is fixed, how it is doing, and where it is.

use roundel_core::{
    calib::watch::CameraHealth,
    camera::{Camera, PixelPoint},
    marker::Reject,
    plan::precision::LensDoubt,
    rigid::Rigid,
    time::Timestamp,
    world::{CameraPlacement, ClockEstimate, Unplaced},
};

use crate::model::capture_clock::CaptureClock;

/// What is fixed about a camera.
#[derive(Clone, Debug, Default)]
pub struct CameraInfo {
    pub name: String,
    /// The source's URL, safe to show.
    pub source: String,
    /// Corners of the polygons in which nothing is looked for, raw pixels.
    pub mask: Vec<Vec<PixelPoint>>,
    /// What it rides on; `None`: it stands.
    pub ride: Option<MountInfo>,
    /// How well its lens is known, as far as its camera file says.
    pub lens_uncertainty: Option<LensDoubt>,
}

/// What is fixed about a camera that rides on an object.
#[derive(Clone, Debug, PartialEq)]
pub struct MountInfo {
    /// The object's configured name.
    pub carrier: String,
    pub object_from_camera: Rigid,
    /// Whether the reference roundels that it sees say where the object is.
    pub localizes: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraStatus {
    /// Being opened, no frame yet.
    #[default]
    Starting,
    Running,
    /// Failed; tried again after a pause.
    Failed,
    /// No more frames will come.
    Finished,
}

/// How a camera's pose is known, or why it is not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PoseStatus {
    Configured,
    Found,
    /// From an arena's calibration.
    Calibrated,
    /// By the object that it rides on.
    Riding,
    /// Not since it was bumped.
    Quarantined,
    /// Not yet seen the reference roundels as it must.
    #[default]
    Searching,
    /// Not by the object that it rides on.
    Without(Unplaced),
}

/// Where a camera is. By default that is not known, since nobody has looked.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPoseState {
    /// How that is known, or why not.
    pub status: PoseStatus,
    /// With its uncertainty, while it is known.
    pub placement: Option<CameraPlacement>,
    /// Of one that rides: when.
    pub time: Option<Timestamp>,
    /// Why it is not known and what to do; empty while it is.
    pub reason: String,
}

impl CameraPoseState {
    pub fn fixed(status: PoseStatus, placement: CameraPlacement) -> Self {
        Self { status, placement: Some(placement), time: None, reason: String::new() }
    }

    /// Of one that has not found its place.
    pub fn searching(reason: impl Into<String>) -> Self {
        let status = PoseStatus::Searching;
        Self { status, placement: None, time: None, reason: reason.into() }
    }
}

impl Default for CameraPoseState {
    fn default() -> Self {
        Self::searching("none of its frames has been looked at yet")
    }
}

/// The changing state of a camera.
#[derive(Clone, Debug, Default)]
pub struct CameraState {
    pub status: CameraStatus,
    /// Why it failed and what to do; empty while it runs.
    pub error: String,
    /// Image size, pixels; 0 before the first frame.
    pub width: usize,
    /// Image size, pixels; 0 before the first frame.
    pub height: usize,
    pub pose: CameraPoseState,
    /// Lens and intrinsics, once known.
    pub camera: Option<Camera>,
    /// Version of the calibration in use; 0: as configured.
    pub calibration_version: u64,
    pub frames: u64,
    /// Frames that gave way to newer ones.
    pub dropped: u64,
    pub broken: u64,
    /// Times that the source was opened again.
    pub restarts: u64,
    /// Mean over the last seconds.
    pub rate_hz: f64,
    /// Roundels in the newest frame.
    pub detections: usize,
    /// Median of the newest frames' detection times, milliseconds.
    pub detect_ms: f64,
    /// Time that decoding a frame takes, before that, median, milliseconds.
    pub decode_ms: f64,
    /// The part of it that finding takes, median, milliseconds.
    pub find_ms: f64,
    /// The part of it that locating takes, median, milliseconds.
    pub locate_ms: f64,
    /// Deviation of the blur, median over fitted roundels of the newest frames, pixels; 0 before any.
    pub blur_px: f64,
    /// Deviation of the noise, likewise, grey levels.
    pub noise: f64,
    /// How far from where the others have objects it sees them, root mean square over the last seconds, pixels; 0 where no other
    /// camera saw the same.
    pub reprojection_px: f64,
    /// What became of rings and candidates since the start.
    pub counts: DetectionCounts,
    /// Median from capture to fused, milliseconds.
    pub latency_ms: f64,
    /// Which clock the newest frame's capture time comes from.
    pub capture_clock: Option<CaptureClock>,
    /// What fusion knows of its clock.
    pub clock: Option<ClockEstimate>,
    /// How its place agrees with what others see.
    pub health: Option<CameraHealth>,
    /// Frames a second that were promised; 0: none.
    pub promised_hz: f64,
    /// What it gives instead, and what to do; empty while it keeps to it.
    pub rate_reason: String,
    /// Who feeds it, if it is fed.
    pub link: Option<SenderLink>,
}

/// What became of a camera's rings and candidates since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DetectionCounts {
    /// Rings located by the fit to the grey levels.
    pub precise: u64,
    /// Rings located in closed form: all in fast mode, in precise mode those that the fit refused.
    pub fast: u64,
    /// Rings without a pose.
    pub unlocated: u64,
    /// Candidates that were no roundels, in the order of [`Reject::ALL`].
    pub rejects: [u64; Reject::ALL.len()],
}

/// Who feeds a camera, and how that goes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SenderLink {
    /// What the sender calls itself; empty before the first one.
    pub sender: String,
    pub address: String,
    pub connected: bool,
    /// Frames or detections taken, of all senders.
    pub received: u64,
    /// That were numbered and never came.
    pub missing: u64,
    pub repeated: u64,
    /// The shortest way there and back, milliseconds; 0: unknown.
    pub round_trip_ms: f64,
    /// Deviation of the difference of the clocks, milliseconds; 0: unknown.
    pub clock_deviation_ms: f64,
    /// Why it gives no picture; empty if it does, or was not asked.
    pub no_picture: String,
}
