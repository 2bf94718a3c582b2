//! Parameters of the camera supervision.

/// Parameters of the camera supervision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchParams {
    /// Maximum delay of frames after their exposure, by corrected stamps, seconds.
    pub delay_s: f64,
    /// Standard deviation of clock offsets, seconds.
    pub clock_deviation_s: f64,
    /// Share of a detection's variance that persists from frame to frame, 0 to 1.
    pub systematic_share: f64,
    /// Duration of that persistence, seconds.
    pub systematic_time_s: f64,
    /// Persistent error that covariances do not state, for each coordinate, metres.
    pub min_deviation_m: f64,
    /// Minimum rms displacement of a camera's observations for an event, metres.
    pub min_bump_m: f64,
    /// The same for a camera that fusion holds back.
    pub min_held_bump_m: f64,
    /// The same for a camera that is not held back and has not agreed with others for a minute. Smaller
    /// displacements, such as those of a wrong lens, are corrected as drift.
    pub min_first_bump_m: f64,
    /// Minimum rms displacement for a drift correction, metres.
    pub min_drift_m: f64,
    /// Time constant of the drift sums, seconds.
    pub drift_window_s: f64,
    /// A camera returns when its position is known to this, metres …
    pub return_deviation_m: f64,
    /// … and its rotation to this, radians …
    pub return_deviation_rad: f64,
    /// … or after this many seconds at rest if both are known to four times that.
    pub return_after_s: f64,
}

impl Default for WatchParams {
    fn default() -> Self {
        Self {
            delay_s: 0.15,
            clock_deviation_s: 1e-4,
            systematic_share: 0.5,
            systematic_time_s: 1.0,
            min_deviation_m: 1e-4,
            min_bump_m: 0.004,
            min_held_bump_m: 0.001,
            min_first_bump_m: 0.008,
            min_drift_m: 4e-4,
            drift_window_s: 60.0,
            return_deviation_m: 3e-4,
            return_deviation_rad: 0.003 * std::f64::consts::PI / 180.0,
            return_after_s: 22.0,
        }
    }
}
