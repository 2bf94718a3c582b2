//! Where a ring is looked for, and what it must look like.

use crate::{
    marker::{kind::Polarity, ring::pixels::predicted::PredictedRims},
    segment::Window,
};

/// What a roundel must look like.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rules {
    /// Smallest and largest ratio of inner to outer diameter.
    pub ratios: (f64, f64),
    /// Whether disc and ring must have the same shape; where a kind's disc is elliptical, those of plain
    /// kinds must.
    pub similar: bool,
    /// Smallest shorter semiaxis of the outer rim, pixels.
    pub min_semi_minor_px: f64,
    /// Smallest ratio of the semiaxes.
    pub min_axis_ratio: f64,
    /// Smallest difference of white and black.
    pub min_contrast: f64,
}

/// Where to look, and with which threshold.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Probe {
    pub center: (usize, usize),
    pub threshold: u8,
    pub bounds: Window,
    /// Of a white ring all levels, the threshold too, are counted from white.
    pub polarity: Polarity,
    /// Where the rims of a ring that is followed ought to be.
    pub predicted: Option<PredictedRims>,
}

impl Probe {
    /// The threshold in the frame's own levels.
    #[inline(always)]
    pub fn frame_threshold(&self) -> u8 {
        match self.polarity {
            Polarity::BlackRing => self.threshold,
            Polarity::WhiteRing => 0u8.wrapping_sub(self.threshold),
        }
    }
}
