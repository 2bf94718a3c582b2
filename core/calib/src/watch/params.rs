//! What the watch can be told.

/// What the watch can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchParams {
    /// Frames arrive within this after their exposure, by their corrected stamps, seconds.
    pub delay_s: f64,
    /// How well clocks' offsets are known, seconds.
    pub clock_deviation_s: f64,
    /// Part of a detection's variance that stays from frame to frame, 0 to 1 …
    pub systematic_share: f64,
    /// … and for how long, seconds.
    pub systematic_time_s: f64,
    /// What covariances of detections do not say: each coordinate, stays, metres.
    pub least_deviation_m: f64,
    /// A camera whose view is off by more was bumped, metres, rms over what it sees, …
    pub least_bump_m: f64,
    /// … of one that fusion holds back, too, since it moved all of a sudden, …
    pub least_held_bump_m: f64,
    /// … and of one that is not held back and has not agreed with others for a minute yet: what a lens is wrong by is
    /// taken up as drift.
    pub least_first_bump_m: f64,
    /// One whose view is off by more drifts.
    pub least_drift_m: f64,
    /// Time in which the sums over which that is seen fade, seconds.
    pub drift_window_s: f64,
    /// A camera returns once its place is known to this, metres and radians …
    pub return_deviation_m: f64,
    /// … about each.
    pub return_deviation_rad: f64,
    /// Or after so many seconds at rest if it is known to four times that.
    pub return_after_s: f64,
}

impl Default for WatchParams {
    fn default() -> Self {
        Self {
            delay_s: 0.15,
            clock_deviation_s: 1e-4,
            systematic_share: 0.5,
            systematic_time_s: 1.0,
            least_deviation_m: 1e-4,
            least_bump_m: 0.004,
            least_held_bump_m: 0.001,
            least_first_bump_m: 0.008,
            least_drift_m: 4e-4,
            drift_window_s: 60.0,
            return_deviation_m: 3e-4,
            return_deviation_rad: 0.003 * std::f64::consts::PI / 180.0,
            return_after_s: 22.0,
        }
    }
}
