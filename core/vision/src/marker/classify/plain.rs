//! Plain kinds, by the ratio of their diameters (paper, section 3.4).

use crate::{
    ellipse::Ellipse,
    id::KindId,
    marker::{
        classify::compensation::{compensated, shift_px},
        kind::{Kind, Pattern, Polarity},
    },
    simd::Lane,
};

/// Largest shift of a rim as a share of the outer radius …
const SHIFT_SHARE: f64 = 0.02;
/// … plus pixels: saturated white blooms by half a pixel and more at each rim.
const SHIFT_PX: f64 = 0.7;

/// Largest shift of both rims of a kind, pixels.
#[inline(always)]
pub(crate) fn shift_limit_px(outer: &Ellipse) -> f64 {
    SHIFT_PX + SHIFT_SHARE * outer.mean_radius_px()
}

/// The kind of a ring, and its rims compensated for it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Classified {
    pub kind: KindId,
    pub outer: Ellipse,
    pub inner: Ellipse,
    /// Their shift.
    pub shift_px: f64,
}

/// The plain kind of this polarity with the closest ratio, and the rims compensated for it (paper,
/// section 3.5); `None` if no kind is close enough.
///
/// Compensation can give any pair of rims any ratio, so the kind must be chosen before it: the one
/// with the smallest shift |t|, which must be one that a camera can cause. No two kinds have the
/// same ratio ([`crate::marker::DetectorError::Indistinguishable`]). Coded kinds are excluded,
/// because their white is not a disc ([`crate::marker::coded::measure`]).
pub(crate) fn nearest_kind(
    kinds: &[Kind],
    polarity: Polarity,
    outer: &Ellipse,
    inner: &Ellipse,
) -> Option<Classified> {
    let semiaxes = |rim: &Ellipse| [rim.semi_major_px, rim.semi_minor_px];
    let is_white = polarity == Polarity::WhiteRing;
    let nearest = NearestKind::new(semiaxes(outer), semiaxes(inner), is_white, kinds);
    if !nearest.valid {
        return None;
    }
    let shift_px = nearest.shift_px;
    let (outer, inner) = compensated(outer, inner, shift_px)?;
    Some(Classified { kind: KindId(nearest.kind as u16), outer, inner, shift_px })
}

/// The plain kinds closest to rims, one ring per lane.
pub(crate) struct NearestKind<T: Lane> {
    pub kind: T,
    pub shift_px: T,
    pub valid: T::Mask,
}

impl<T: Lane> NearestKind<T> {
    /// From the semiaxes of outer and inner rim, and the lanes with white rings.
    #[inline(always)]
    pub fn new(outer: [T; 2], inner: [T; 2], is_white: T::Mask, kinds: &[Kind]) -> Self {
        let limit_px = (outer[0] * outer[1]).root() * SHIFT_SHARE + SHIFT_PX;
        let far = limit_px.splat(f64::INFINITY);
        let mut nearest = Self { kind: far, shift_px: far, valid: far.below(far) };
        for (index, kind) in kinds.iter().enumerate() {
            if !matches!(kind.pattern, Pattern::Plain) {
                continue;
            }
            let (shift_px, is_one) = shift_px(outer, inner, kind.ratio());
            let is_same = if kind.polarity == Polarity::WhiteRing { is_white } else { !is_white };
            let is_nearer = shift_px.size().below(nearest.shift_px.size())
                & shift_px.size().at_most(limit_px)
                & is_one
                & is_same;
            nearest.kind = T::choose(is_nearer, far.splat(index as f64), nearest.kind);
            nearest.shift_px = T::choose(is_nearer, shift_px, nearest.shift_px);
            nearest.valid = nearest.valid | is_nearer;
        }
        nearest
    }
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
            nearest_kind(&kinds, Polarity::BlackRing, &circle(20.0), &circle(inner))
                .map(|found| found.kind)
        };
        assert_eq!(find(8.3), Some(KindId(0)));
        assert_eq!(find(9.7), Some(KindId(1)));
        assert_eq!(find(12.6), Some(KindId(2)));
        assert_eq!(find(15.0), None);
    }
}
