//! State of a track's precise fits, and the work that they may take.

use super::photometry::FitHistory;
use crate::ellipse::Ellipse;

/// Work per frame that a track may spend on average, relative to the ring's pixels: for each pixel of the outer mean
/// diameter, and limits. The fit of an undisturbed ring takes 1.2, of one that faces the camera 5 to 8, a resumed robust
/// fit 12, and one that starts from nothing 50 to 200.
const ALLOWANCE_PER_PX: f64 = 0.12;
const ALLOWANCES: (f64, f64) = (5.0, 9.0);
/// Credit of a new track, for its first fits, relative to the ring's pixels.
const FIRST_CREDIT: f64 = 200.0;
/// Limit of what is saved up, in allowances.
const MAX_SAVED: f64 = 3.0;
/// Distance from the outer rim up to which pixels count.
const REACH_PX: f64 = 3.0;

/// State of the precise fits of a track.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TrackedFit {
    pub history: Option<FitHistory>,
    /// Work that may be spent; negative after costly fits, `None` before the first frame.
    pub credit: Option<f64>,
    /// Frames since the last fit.
    pub waited: u32,
}

impl TrackedFit {
    /// Whether no fit has found motion within the exposure.
    pub fn shows_no_motion(&self) -> bool {
        self.history.as_ref().is_none_or(FitHistory::shows_no_motion)
    }

    /// Adds a frame's allowance; returns whether the ring is fitted in it.
    pub fn is_due(&mut self, outer: &Ellipse) -> bool {
        let radius_px = outer.mean_radius_px();
        let area_px2 = std::f64::consts::PI * (radius_px + REACH_PX).powi(2);
        let per_px2 = (2.0 * radius_px * ALLOWANCE_PER_PX).clamp(ALLOWANCES.0, ALLOWANCES.1);
        let allowance = per_px2 * area_px2;
        let credit = self.credit.unwrap_or(FIRST_CREDIT * area_px2);
        self.credit = Some((credit + allowance).min(credit.max(MAX_SAVED * allowance)));
        credit >= 0.0
    }
}
