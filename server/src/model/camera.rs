//! Description, state and pose of a camera as the hub shows them.

use roundel_core::{
    calib::watch::CameraHealth,
    camera::{Camera, PixelPoint},
    marker::Reject,
    plan::precision::LensUncertainty,
    rigid::Rigid,
    time::Timestamp,
    world::{CameraPlacement, ClockEstimate},
};

use crate::model::capture_clock::CaptureClock;
pub use roundel_proto::v1::PoseStatus;

/// Description of a camera from the configuration.
#[derive(Clone, Debug, Default)]
pub struct CameraInfo {
    pub name: String,
    /// The source's URL, safe to show.
    pub source: String,
    /// Polygons that are not searched, raw pixels.
    pub mask: Vec<Vec<PixelPoint>>,
    /// `None` for a fixed camera.
    pub ride: Option<MountInfo>,
    /// Uncertainty of the lens according to the camera file.
    pub lens_uncertainty: Option<LensUncertainty>,
}

/// Mount of a camera on an object.
#[derive(Clone, Debug, PartialEq)]
pub struct MountInfo {
    /// Name of the object.
    pub carrier: String,
    pub object_from_camera: Rigid,
    /// Whether it localizes the object with the reference roundels.
    pub localizes: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraStatus {
    /// Being opened, no frame yet.
    #[default]
    Starting,
    Running,
    /// Failed; it is retried with backoff.
    Failed,
    /// The source has ended.
    Finished,
}

#[derive(Clone, Debug, PartialEq)]
pub struct CameraPoseState {
    pub status: PoseStatus,
    /// `None` while it is unknown.
    pub placement: Option<CameraPlacement>,
    /// Time of the pose of a mounted camera.
    pub time: Option<Timestamp>,
    /// Why it is unknown, and what to do; empty while it is known.
    pub reason: String,
}

impl CameraPoseState {
    pub fn fixed(status: PoseStatus, placement: CameraPlacement) -> Self {
        Self { status, placement: Some(placement), time: None, reason: String::new() }
    }

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

#[derive(Clone, Debug, Default)]
pub struct CameraState {
    pub status: CameraStatus,
    /// Why it failed and what to do; empty while it runs.
    pub error: String,
    /// 0 before the first frame.
    pub width: usize,
    /// 0 before the first frame.
    pub height: usize,
    pub pose: CameraPoseState,
    /// Lens and intrinsics, once known.
    pub camera: Option<Camera>,
    /// 0: as configured.
    pub calibration_version: u64,
    pub frames: u64,
    /// Frames dropped in favour of newer ones.
    pub dropped: u64,
    pub broken: u64,
    /// Number of times the source was reopened.
    pub restarts: u64,
    /// Mean of the last seconds.
    pub rate_hz: f64,
    /// Roundels in the newest frame.
    pub detections: usize,
    /// Median detection time of the newest frames, milliseconds.
    pub detect_ms: f64,
    /// Median decoding time, milliseconds.
    pub decode_ms: f64,
    /// Median time to find the roundels, part of `detect_ms`.
    pub find_ms: f64,
    /// Median time to locate the roundels, part of `detect_ms`.
    pub locate_ms: f64,
    /// Share of the time budget that finding and locating the roundels takes, median; 0: unknown.
    pub budget_used: f64,
    /// Standard deviation of the blur, median of the newest roundels, pixels; 0: unknown.
    pub blur_px: f64,
    /// Standard deviation of the noise, likewise, grey levels.
    pub noise: f64,
    /// Rms reprojection error against the other cameras, pixels; 0 without common objects.
    pub reprojection_px: f64,
    pub counts: DetectionCounts,
    /// Median time from capture to fusion, milliseconds.
    pub latency_ms: f64,
    /// Clock of the newest frame's capture time.
    pub capture_clock: Option<CaptureClock>,
    /// Fusion's estimate of its clock.
    pub clock: Option<ClockEstimate>,
    /// Agreement of its pose with the other cameras.
    pub health: Option<CameraHealth>,
    /// Configured rate; 0: none.
    pub promised_hz: f64,
    /// Difference to that rate, and what to do; empty while they agree.
    pub rate_reason: String,
    /// Sender of a `push:` source.
    pub link: Option<SenderLink>,
}

/// Results of rings and candidates since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DetectionCounts {
    /// Rings located by the fit to the grey levels.
    pub precise: u64,
    /// Rings located in closed form: all in fast mode, rejects of the fit in precise mode.
    pub fast: u64,
    /// Rings located in closed form in precise mode, since a fit would have exceeded the bound of cost or time.
    pub deferred: u64,
    /// Rings without a pose.
    pub unlocated: u64,
    /// Rejected candidates in the order of [`Reject::ALL`].
    pub rejects: [u64; Reject::ALL.len()],
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct SenderLink {
    /// Name of the sender; empty before the first one.
    pub sender: String,
    pub address: String,
    pub connected: bool,
    /// Frames or detections received from all senders.
    pub received: u64,
    /// Missing according to their numbers.
    pub missing: u64,
    pub repeated: u64,
    /// Shortest round trip, milliseconds; 0: unknown.
    pub round_trip_ms: f64,
    /// Standard deviation of the clock difference, milliseconds; 0: unknown.
    pub clock_deviation_ms: f64,
    /// Why it sends no pictures; empty if it does, or was not asked.
    pub no_picture: String,
}
