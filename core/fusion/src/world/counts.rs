//! What became of everything that fusion was given: nothing vanishes uncounted.

/// What became of all that was observed, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FusionCounts {
    /// Frames handed over.
    pub frames: u64,
    /// Frames that were there already.
    pub duplicate_frames: u64,
    /// Frames older than the late window.
    pub late_frames: u64,
    /// Frames that never came: numbers that their camera left out, or times at which its regular interval has one.
    pub missing_frames: u64,
    /// Frames from an implausible future, or a past that their camera has left.
    pub jumped_frames: u64,
    /// Times that a camera's clock was found to be of another epoch or to have been set, so that its
    /// stamps were moved.
    pub clock_steps: u64,
    /// Times that the timeline was begun anew, ending all tracks.
    pub restarts: u64,
    /// Detections in all frames.
    pub detections: u64,
    /// Detections that went into a track, the ones that began one included.
    pub used: u64,
    /// Of these, detections that came after newer ones of the same object.
    pub out_of_order: u64,
    /// Detections that began a track.
    pub begun: u64,
    /// Detections dropped as older than the late window, those of late frames included.
    pub late: u64,
    /// Detections of duplicate frames, or with a track number twice in one frame.
    pub duplicate: u64,
    /// Detections of frames whose time jumped.
    pub jumped: u64,
    /// Detections of cameras whose place is not known.
    pub no_camera_pose: u64,
    /// Of these, of cameras whose carrier is not followed.
    pub carrier_unseen: u64,
    /// Of these, of cameras of which nobody knows how their carrier is turned.
    pub carrier_unturned: u64,
    /// Detections of carriers by cameras that ride: not used.
    pub of_carriers: u64,
    /// Detections of landmarks by cameras that localize.
    pub of_landmarks: u64,
    /// Frames in which such a camera found its place.
    pub localized: u64,
    /// Frames held back: their camera disagreed with all others as if it had moved.
    pub held_frames: u64,
    /// Detections in these.
    pub held: u64,
    /// Detections taken out of tracks again, since their camera had moved.
    pub taken_back: u64,
    /// Detections without a pose.
    pub no_pose: u64,
    /// Detections with numbers that are not finite or no covariance.
    pub invalid: u64,
    /// Detections outside the gate of the object that their camera took them for.
    pub gated: u64,
    /// Of these, detections dropped since other cameras see that object elsewhere.
    pub contradicted: u64,
    /// Detections left out since a camera of higher rank sees the object.
    pub outranked: u64,
    /// Detections that would have begun a track beyond the greatest number of objects.
    pub over_max_objects: u64,
    /// Detections taken together with another one of the same object in their frame; the two count once
    /// in what is above.
    pub joined: u64,
    /// Detections left out since they contradict the others of their object in their frame.
    pub left_out: u64,
    /// Tracks joined with another of the same object.
    pub merged: u64,
    /// Objects that were lost, or not seen, and known again by their code.
    pub returned: u64,
    /// Tracks with the code of another object that is seen as well.
    pub ambiguous_codes: u64,
}
