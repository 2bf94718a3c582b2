//! Counters of frames and detections by outcome; each one ends in a counter.

/// Totals since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FusionCounts {
    /// Frames received.
    pub frames: u64,
    /// Frames received before.
    pub duplicate_frames: u64,
    /// Frames older than the late window.
    pub late_frames: u64,
    /// Frames that never arrived: numbers that a camera skipped, or gaps in its regular interval.
    pub missing_frames: u64,
    /// Frames from an implausible future, or from before a clock step of their camera.
    pub jumped_frames: u64,
    /// Detected clock steps and foreign epochs, after each of which a camera's stamps were shifted.
    pub clock_steps: u64,
    /// Restarts of the timeline, each of which ended all tracks.
    pub restarts: u64,
    /// Detections in all frames.
    pub detections: u64,
    /// Detections that updated or started a track.
    pub used: u64,
    /// Part of `used`: detections older than others of the same object.
    pub out_of_order: u64,
    /// Detections that started a track.
    pub begun: u64,
    /// Detections older than the late window, including those of late frames.
    pub late: u64,
    /// Detections of duplicate frames, or with a track number that occurs twice in a frame.
    pub duplicate: u64,
    /// Detections of frames whose time jumped.
    pub jumped: u64,
    /// Detections of cameras without a known pose.
    pub no_camera_pose: u64,
    /// Part of `no_camera_pose`: detections of cameras whose carrier is not tracked.
    pub carrier_unseen: u64,
    /// Part of `no_camera_pose`: detections of cameras whose carrier has no certain orientation.
    pub carrier_orientation_unknown: u64,
    /// Detections of carriers by mobile cameras, which are not used.
    pub carrier_detections: u64,
    /// Detections of landmarks by cameras that localize.
    pub landmark_detections: u64,
    /// Frames in which such a camera was localized.
    pub localized: u64,
    /// Frames of cameras that are held back because they disagree with all others.
    pub held_frames: u64,
    /// Detections in these frames.
    pub held: u64,
    /// Detections removed from tracks because their camera had moved.
    pub retracted: u64,
    /// Detections without a pose.
    pub no_pose: u64,
    /// Detections with numbers that are not finite or without a valid covariance.
    pub invalid: u64,
    /// Detections outside the gate of the object that their camera assigns them to.
    pub gated: u64,
    /// Part of `gated`: detections dropped because other cameras observe the object elsewhere.
    pub contradicted: u64,
    /// Detections not used because a camera of higher rank observes the object.
    pub outranked: u64,
    /// Detections that would have exceeded the largest number of tracks.
    pub over_max_objects: u64,
    /// Detections joined with another one of the same object in their frame; the two count once in the totals
    /// above.
    pub joined: u64,
    /// Detections left out because they contradict the others of their object in their frame.
    pub left_out: u64,
    /// Tracks merged into another one of the same object.
    pub merged: u64,
    /// Objects that were lost or not observed, and recognized by their code.
    pub returned: u64,
    /// Tracks with the code of another object that is observed at the same time.
    pub ambiguous_codes: u64,
}
