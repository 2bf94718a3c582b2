//! Kinds of roundel: diameters, pattern, polarity.

use crate::marker::code::CodeLayout;

/// Ratios of inner to outer diameter that can be measured: outside, either the disc or the ring is
/// too thin.
pub const RATIO_LIMITS: (f64, f64) = (0.2, 0.8);

/// Largest ratio of an elliptical disc's diameters; a rounder disc cannot be distinguished from a
/// circle.
pub const AXIS_RATIO_LIMIT: f64 = 0.9;

/// Tolerance of ratios at a limit, for rounding.
const RATIO_ROUNDING: f64 = 1e-6;

/// Whether a disc may have this share of the outer diameter ([`RATIO_LIMITS`], inclusive).
pub fn is_measurable(ratio: f64) -> bool {
    let (min, max) = RATIO_LIMITS;
    (min - RATIO_ROUNDING..=max + RATIO_ROUNDING).contains(&ratio)
}

/// Whether an elliptical disc with this ratio of diameters shows a heading (up to
/// [`AXIS_RATIO_LIMIT`], inclusive).
pub fn shows_heading(axis_ratio: f64) -> bool {
    axis_ratio <= AXIS_RATIO_LIMIT + RATIO_ROUNDING
}

/// A printed design. Plain kinds are distinguished by the ratio of their diameters (paper, section
/// 3.4).
#[derive(Clone, Debug, PartialEq)]
pub struct Kind {
    /// Name in the configuration.
    pub name: String,
    /// Ring's outer diameter, metres.
    pub outer_diameter_m: f64,
    /// Disc's diameter, metres, below the outer one: between the teeth of a coded roundel, the
    /// longer one of an elliptical disc.
    pub inner_diameter_m: f64,
    /// What the ring encloses.
    pub pattern: Pattern,
    /// Which of ring and disc is black.
    pub polarity: Polarity,
}

/// What a ring encloses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Pattern {
    /// A round disc: no identity beyond the kind, no yaw.
    #[default]
    Plain,
    /// A disc with teeth, as printed by WhyCode: identity and yaw.
    Coded(CodeLayout),
    /// An elliptical disc (paper, sections 7.2 and 7.4), its longer axis along the print's x: a
    /// heading, up to a half turn.
    Elliptical {
        /// The disc's shorter diameter, metres.
        minor_diameter_m: f64,
    },
}

/// Which of ring and disc is black.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Polarity {
    /// A black ring round a white disc, on white.
    #[default]
    BlackRing,
    /// A white ring round a black disc, on black.
    WhiteRing,
}

impl Polarity {
    /// Mask that inverts grey levels so that the ring is black.
    pub(crate) fn flip(self) -> u8 {
        match self {
            Self::BlackRing => 0,
            Self::WhiteRing => 255,
        }
    }

    /// A threshold of the frame's own levels as one of levels inverted by [`Polarity::flip`], and back.
    pub(crate) fn threshold(self, level: u8) -> u8 {
        match self {
            Self::BlackRing => level,
            Self::WhiteRing => 0u8.wrapping_sub(level),
        }
    }
}

impl Kind {
    /// A black ring of these diameters, in metres, round a plain white disc.
    pub fn plain(name: impl Into<String>, outer_diameter_m: f64, inner_diameter_m: f64) -> Self {
        Self {
            name: name.into(),
            outer_diameter_m,
            inner_diameter_m,
            pattern: Pattern::Plain,
            polarity: Polarity::BlackRing,
        }
    }

    /// Ratio of inner to outer diameter.
    pub fn ratio(&self) -> f64 {
        self.inner_diameter_m / self.outer_diameter_m
    }

    /// Ratio of the disc's diameter to the outer one; for an elliptical disc, that of the circle of
    /// equal area.
    pub(crate) fn mean_ratio(&self) -> f64 {
        let (min, max) = self.ratios();
        (min * max).sqrt()
    }

    /// Smallest and largest ratio of the disc's diameter to the outer one; they differ only for an
    /// elliptical disc.
    pub fn ratios(&self) -> (f64, f64) {
        match self.pattern {
            Pattern::Elliptical { minor_diameter_m } => {
                (minor_diameter_m / self.outer_diameter_m, self.ratio())
            }
            Pattern::Plain | Pattern::Coded(_) => (self.ratio(), self.ratio()),
        }
    }
}
