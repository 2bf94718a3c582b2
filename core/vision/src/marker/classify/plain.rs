//! Plain kinds, by the ratio of their diameters (paper, section 3.4).

use crate::{
    ellipse::Ellipse,
    id::KindId,
    marker::{
        classify::compensation::{compensated, rim_shift_px},
        kind::{Kind, Pattern, Polarity},
    },
};

/// Largest shift of a rim as a share of the outer radius …
pub(crate) const SHIFT_SHARE: f64 = 0.02;
/// … plus pixels: saturated white blooms by half a pixel and more at each rim.
pub(crate) const SHIFT_PX: f64 = 0.7;

/// Largest shift of both rims of a kind, pixels.
#[inline(always)]
pub(crate) fn shift_limit_px(outer: &Ellipse) -> f64 {
    SHIFT_PX + SHIFT_SHARE * outer.mean_radius_px()
}

/// The plain kind of this polarity with the closest ratio, and the rims compensated for it (paper,
/// section 3.5); `None` if no kind is close enough.
///
/// Compensation can give any pair of rims any ratio, so the kind must be chosen before it: the one
/// with the smallest shift |t|, which must be one that a camera can cause. No two kinds have the
/// same ratio ([`crate::marker::DetectorError::Indistinguishable`]). Coded kinds are excluded,
/// because their white is not a disc ([`crate::marker::coded::measure`]).
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
    fn the_closest_ratio_wins_and_a_distant_one_is_rejected() {
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
