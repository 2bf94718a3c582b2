//! Kinds of roundel, told apart by the ratio of their diameters (paper, section 3.4).

use crate::{
    ellipse::Ellipse,
    id::KindId,
    marker::{
        classify::{
            compensation::{compensated, rim_shift_px},
            elliptical::AXIS_RATIO_LIMIT,
        },
        code::CodeLayout,
    },
};

/// Ratios of inner to outer diameter that a roundel may have: outside of them either the disc or the
/// ring is too thin to be measured.
pub const RATIO_LIMITS: (f64, f64) = (0.2, 0.8);

/// Of ratios: diameters that are said to be at a limit are there, whatever rounding does to them (no printer comes near).
const RATIO_ROUNDING: f64 = 1e-6;

/// Whether a disc may have this share of the outer diameter ([`RATIO_LIMITS`], both included).
pub fn is_measurable(ratio: f64) -> bool {
    let (least, most) = RATIO_LIMITS;
    (least - RATIO_ROUNDING..=most + RATIO_ROUNDING).contains(&ratio)
}

/// Whether an elliptical disc's shorter diameter may be this share of its longer one ([`AXIS_RATIO_LIMIT`] included).
pub fn tells_heading(axis_ratio: f64) -> bool {
    axis_ratio <= AXIS_RATIO_LIMIT + RATIO_ROUNDING
}

/// Rims may be off by this share of the outer radius …
pub(crate) const SHIFT_SHARE: f64 = 0.02;
/// … and by this many pixels before a ring is no longer taken for the kind: saturated white blooms
/// by half a pixel and more at each rim.
pub(crate) const SHIFT_PX: f64 = 0.7;

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
        let (least, most) = self.ratios();
        (least * most).sqrt()
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

/// How far the rims of a kind may be off, pixels.
#[inline(always)]
pub(crate) fn shift_limit_px(outer: &Ellipse) -> f64 {
    SHIFT_PX + SHIFT_SHARE * outer.mean_radius_px()
}

/// The plain kind of a polarity that two rims belong to, and the rims with their compensation (paper, section 3.5) for
/// that kind; `None` if no kind is near enough.
///
/// Compensation can bring any pair of rims to any ratio, so the kind cannot be chosen after it: it is
/// the one that needs the smallest rim shift |t|, and the shift must be one that a camera can cause.
/// No two kinds have the same ratio ([`crate::marker::DetectorError::Alike`]). Coded kinds are none of them: their
/// white is no disc ([`crate::marker::coded::measure`]).
#[inline(always)]
pub(crate) fn nearest_kind(
    kinds: &[Kind],
    polarity: Polarity,
    outer: &Ellipse,
    inner: &Ellipse,
) -> Option<(KindId, Ellipse, Ellipse)> {
    let limit_px = shift_limit_px(outer);
    let mut best: Option<(usize, f64)> = None;
    let plain = |kind: &Kind| matches!(kind.pattern, Pattern::Plain) && kind.polarity == polarity;
    for (index, kind) in kinds.iter().enumerate().filter(|(_, kind)| plain(kind)) {
        let Some(shift_px) = rim_shift_px(outer, inner, kind.ratio()) else { continue };
        let nearer = best.is_none_or(|(_, known)| shift_px.abs() < known.abs());
        if shift_px.abs() <= limit_px && nearer {
            best = Some((index, shift_px));
        }
    }
    let (index, shift_px) = best?;
    let (outer, inner) = compensated(outer, inner, shift_px)?;
    Some((KindId(index as u16), outer, inner))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PixelPoint;

    fn circle(radius: f64) -> Ellipse {
        Ellipse {
            center: PixelPoint { u: 50.0, v: 50.0 },
            semi_major_px: radius,
            semi_minor_px: radius,
            angle_rad: 0.0,
        }
    }

    #[test]
    fn the_nearest_ratio_wins_and_a_far_one_is_refused() {
        let kind = |inner_diameter_m| Kind::plain("", 1.0, inner_diameter_m);
        let kinds = [kind(0.4), kind(0.5), kind(0.6)];
        let find = |inner| {
            nearest_kind(&kinds, Polarity::BlackRing, &circle(20.0), &circle(inner)).map(|k| k.0)
        };
        assert_eq!(find(8.3), Some(KindId(0)));
        assert_eq!(find(9.7), Some(KindId(1)));
        assert_eq!(find(12.6), Some(KindId(2)));
        assert_eq!(find(15.0), None);
    }
}
