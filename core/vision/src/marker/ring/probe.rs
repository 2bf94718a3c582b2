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
    /// The threshold in the frame's own levels.
    #[inline(always)]
    pub fn frame_threshold(&self) -> Threshold {
        let level = match self.polarity {
            Polarity::BlackRing => self.threshold,
            Polarity::WhiteRing => 0u8.wrapping_sub(self.threshold),
        };
        Threshold { level, polarity: self.polarity }
    }
}
