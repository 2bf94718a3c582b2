//! Where to measure a ring, and the limits for it.

use crate::{
    frame::Window,
    marker::{
        kind::Polarity,
        ring::pixels::{patch::Threshold, predicted::PredictedRims},
    },
};

/// Limits for a ring.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rules {
    /// Smallest and largest ratio of inner to outer diameter.
    pub ratios: (f64, f64),
    /// Whether disc and ring must have the same shape. Not if a kind's disc is elliptical; then
    /// plain kinds require it.
    pub similar: bool,
    /// Smallest shorter semiaxis of the outer rim, pixels.
    pub min_semi_minor_px: f64,
    /// Smallest ratio of the semiaxes.
    pub min_axis_ratio: f64,
    /// Smallest difference of white and black.
    pub min_contrast: f64,
    /// Largest variance that blur and pixel width add to a shape, px².
    pub max_spread_px2: f64,
    /// Tolerance of steps of pixels along a rim, as a share of the contrast.
    pub steps_share: f64,
    /// Whether the paper's edge is fitted where margins are narrow; not in a picture whose light was evened out.
    pub fits_paper_edge: bool,
}

/// Where to measure, and at which threshold.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Probe {
    pub center: (usize, usize),
    pub threshold: u8,
    pub bounds: Window,
    /// For a white ring, all levels are inverted, the threshold too.
    pub polarity: Polarity,
    /// Predicted rims of a tracked ring.
    pub predicted: Option<PredictedRims>,
}

impl Probe {
    /// The same with a threshold in the frame's own levels.
    pub fn with_frame_threshold(self, level: u8) -> Self {
        Self { threshold: self.polarity.threshold(level), ..self }
    }

    /// The same in a frame that holds only the window `bounds`.
    pub fn within_bounds(self) -> Self {
        let Window { left, top, right, bottom } = self.bounds;
        let moved = |rims: PredictedRims| rims.moved(-(left as f64), -(top as f64));
        Self {
            center: (self.center.0 - left, self.center.1 - top),
            bounds: Window { left: 0, top: 0, right: right - left, bottom: bottom - top },
            predicted: self.predicted.map(moved),
            ..self
        }
    }

    /// The threshold in the frame's own levels.
    #[inline(always)]
    pub fn frame_threshold(&self) -> Threshold {
        Threshold { level: self.polarity.threshold(self.threshold), polarity: self.polarity }
    }
}
