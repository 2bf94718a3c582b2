//! Kinds of roundel, told apart by the ratio of their diameters (paper, section 3.4).

use crate::marker::code::CodeLayout;

/// Ratios of inner to outer diameter that a roundel may have: outside of them either the disc or the
/// ring is too thin to be measured.
pub const RATIO_LIMITS: (f64, f64) = (0.2, 0.8);

/// A disc whose shorter diameter is more than this of its longer one is no ellipse to a camera.
pub const AXIS_RATIO_LIMIT: f64 = 0.9;

/// Of ratios: diameters that are said to be at a limit are there, whatever rounding does to them (no printer comes near).
const RATIO_ROUNDING: f64 = 1e-6;

/// Whether a disc may have this share of the outer diameter ([`RATIO_LIMITS`], both included).
pub fn is_measurable(ratio: f64) -> bool {
    let (min, max) = RATIO_LIMITS;
    (min - RATIO_ROUNDING..=max + RATIO_ROUNDING).contains(&ratio)
}

/// Whether an elliptical disc's shorter diameter may be this share of its longer one ([`AXIS_RATIO_LIMIT`] included).
pub fn shows_heading(axis_ratio: f64) -> bool {
    axis_ratio <= AXIS_RATIO_LIMIT + RATIO_ROUNDING
}

/// The print. Plain kinds are told apart by the ratio of their diameters (paper, section 3.4).
#[derive(Clone, Debug, PartialEq)]
pub struct Kind {
    /// Name in the configuration.
    pub name: String,
    /// Ring's outer diameter, metres.
    pub outer_diameter_m: f64,
    /// Disc's diameter, metres, below the outer one; of a coded roundel that of the disc between the
    /// teeth, of an elliptical disc the longer one.
    pub inner_diameter_m: f64,
    /// What is inside the ring.
    pub pattern: Pattern,
    /// Which of ring and disc is black.
    pub polarity: Polarity,
}

/// What a roundel's ring holds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Pattern {
    /// A round disc: no identity beyond the kind's, and no yaw.
    #[default]
    Plain,
    /// Teeth round the disc, as WhyCode prints them: identity and yaw.
    Coded(CodeLayout),
    /// An elliptical disc (paper, sections 7.2 and 7.4), its longer axis along the print's x: a
    /// heading, of which the opposite looks the same.
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
    /// Bits of a grey level that are turned over to make the ring black.
    pub(crate) fn flip(self) -> u8 {
        match self {
            Self::BlackRing => 0,
            Self::WhiteRing => 255,
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

    /// Inner over outer diameter.
    pub fn ratio(&self) -> f64 {
        self.inner_diameter_m / self.outer_diameter_m
    }

    /// Ratio of the disc's diameter to the outer one, of an elliptical disc that of the circle of the
    /// same area.
    pub(crate) fn mean_ratio(&self) -> f64 {
        let (min, max) = self.ratios();
        (min * max).sqrt()
    }

    /// The least and the largest ratio of the disc's diameter to the outer one: the same unless the disc
    /// is elliptical.
    pub fn ratios(&self) -> (f64, f64) {
        match self.pattern {
            Pattern::Elliptical { minor_diameter_m } => {
                (minor_diameter_m / self.outer_diameter_m, self.ratio())
            }
            Pattern::Plain | Pattern::Coded(_) => (self.ratio(), self.ratio()),
        }
    }
}
