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
/// … plus pixels: ink and bright white move each rim by half a pixel and more.
const SHIFT_PX: f64 = 0.7;
/// White from this level on may be cut off, so that half of the observed contrast is less than half of the real one. With
/// white of 2.2 times what the sensor holds and a blur of σ, the rims move by 0.9 σ …
const CLIPPED: f64 = 250.0;
/// … for which this is added to their largest shift, pixels.
const CLIPPED_PX: f64 = 0.0;

/// Whether white of this level may be cut off.
#[inline(always)]
pub(crate) fn is_clipped(white: f64) -> bool {
    white >= CLIPPED
}

/// Largest shift of both rims of a kind, pixels, by the level of white.
#[inline(always)]
pub(crate) fn shift_limit_px(outer: &Ellipse, white: f64) -> f64 {
    let clipped_px = if is_clipped(white) { CLIPPED_PX } else { 0.0 };
    SHIFT_PX + SHIFT_SHARE * outer.mean_radius_px() + clipped_px
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
    limit_px: f64,
) -> Option<Classified> {
    let semiaxes = |rim: &Ellipse| [rim.semi_major_px, rim.semi_minor_px];
    let is_white = polarity == Polarity::WhiteRing;
    let nearest = NearestKind::new(semiaxes(outer), semiaxes(inner), is_white, limit_px, kinds);
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

/// [`shift_limit_px`] of white that is not cut off, one ring per lane.
#[inline(always)]
pub(crate) fn shift_limits_px<T: Lane>(outer: [T; 2]) -> T {
    (outer[0] * outer[1]).root() * SHIFT_SHARE + SHIFT_PX
}

impl<T: Lane> NearestKind<T> {
    /// From the semiaxes of outer and inner rim, the lanes with white rings, and the largest shift.
    #[inline(always)]
    pub fn new(
        outer: [T; 2],
        inner: [T; 2],
        is_white: T::Mask,
        limit_px: T,
        kinds: &[Kind],
    ) -> Self {
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
            let outer = circle(20.0);
            let limit_px = shift_limit_px(&outer, 200.0);
            nearest_kind(&kinds, Polarity::BlackRing, &outer, &circle(inner), limit_px)
                .map(|found| found.kind)
        };
        assert_eq!(find(8.3), Some(KindId(0)));
        assert_eq!(find(9.7), Some(KindId(1)));
        assert_eq!(find(12.6), Some(KindId(2)));
        assert_eq!(find(15.0), None);
        // Clipped white allows for more bloom.
        let rims = (circle(9.0), circle(5.2));
        let find = |white| {
            let limit_px = shift_limit_px(&rims.0, white);
            nearest_kind(&kinds[..1], Polarity::BlackRing, &rims.0, &rims.1, limit_px).is_some()
        };
        assert!(find(255.0) && !find(240.0));
    }
}
