//! Rings with elliptical discs, told apart by the disc's two axes (paper, sections 7.2 and 7.4).
//!
//! The outer rim is a circle on the print; its image, an ellipse with the matrix **O** = L Lᵀ, says how
//! the print's plane is stretched. Taken back by it, the disc's rim **I** becomes L⁻¹ **I** L⁻ᵀ, whose
//! eigenvalues are the squared ratios p² ≥ q² of the disc's axes to the outer diameter. So
//!
//!   p² q² = det **I** / det **O**,   p² + q² = tr(**O**⁻¹ **I**)
//!
//! up to the square of perspective, whatever the tilt. The product is what one shift t of both rims
//! changes (as in [`crate::marker::classify::compensation`], with r = p q of the kind), so t follows from it; the quotient
//! p/q, with the rims moved back, tells how elliptical the disc is. A plain kind has p/q = 1. A kind is
//! that whose t and quotient are nearest, both in pixels of the disc's rim, and near enough.
//!
//! With the kind's quotient k, the disc's longer axis is off by the share e = ½ ln(p/q / k) one way and
//! the shorter one by as much the other way. Noise and blur are of the shorter axis, so kinds are
//! compared by e in pixels of it. But whether it is any of them is seen better in pixels of the longer
//! axis: a wrong disc is off the more the larger it is, a blurred one only where it is small. Blur
//! narrows a thin disc, so one that is rounder than its kind is given half as much. Where rims are off
//! in part, an uneven outline (u, a share of the contrast) tells print from roundels, as in
//! [`crate::marker::validate::letter`]:
//!
//!   (e a / 0.4 px)² + (u / 0.06)² ≤ 1.45²,   0.2 px for e < 0,
//!
//! asked of discs that are newly found and whose shorter semiaxis is up to 8 px. A ring of a plain kind
//! must pass the test of similarity as where there are plain kinds alone.
//!
//! Seen small, kinds are told apart only as far as their rims differ by more than some tenths of a
//! pixel. `tests/elliptical.rs` of the tests crate judges recall and kinds.

use crate::{
    ellipse::Ellipse,
    id::KindId,
    marker::{
        classify::{
            compensation::{compensated, rim_shift_px},
            plain::shift_limit_px,
        },
        kind::{Kind, Pattern, Polarity},
    },
};

/// How far the disc's rim may be off the kind's by its quotient of axes: pixels of the longer semiaxis,
/// and a share of it, which perspective takes …
const QUOTIENT_LIMIT: (f64, f64) = (0.6, 0.04);
/// … in full where the outer rim's longer semiaxis is of so many pixels, less as the square below.
const PERSPECTIVE_PX: f64 = 40.0;
/// As [`crate::marker::classify::plain::nearest_kind`], among plain kinds, if the rims are similar, and those with
/// elliptical discs.
pub(crate) fn nearest_kind(
    kinds: &[Kind],
    polarity: Polarity,
    similar: bool,
    (outer, inner): (&Ellipse, &Ellipse),
) -> Option<(KindId, Ellipse, Ellipse)> {
    let limit_px = shift_limit_px(outer);
    let mut best: Option<(f64, (KindId, Ellipse, Ellipse))> = None;
    let may_be = |kind: &Kind| match kind.pattern {
        Pattern::Plain => similar,
        Pattern::Elliptical { .. } => true,
        Pattern::Coded(_) => false,
    };
    for (index, kind) in kinds.iter().enumerate() {
        if kind.polarity != polarity || !may_be(kind) {
            continue;
        }
        let Some(shift_px) = rim_shift_px(outer, inner, kind.mean_ratio()) else { continue };
        let Some((outer, inner)) = compensated(outer, inner, shift_px) else { continue };
        let off = off_share(kind, &outer, &inner);
        let perspective = (outer.semi_major_px / PERSPECTIVE_PX).min(1.0).powi(2);
        let max_px = QUOTIENT_LIMIT.0 + QUOTIENT_LIMIT.1 * perspective * inner.semi_major_px;
        if shift_px.abs() > limit_px || off.abs() * inner.semi_major_px > max_px {
            continue;
        }
        let distance_px = shift_px.hypot(off * inner.semi_minor_px);
        if best.is_none_or(|(known_px, _)| distance_px < known_px) {
            best = Some((distance_px, (KindId(index as u16), outer, inner)));
        }
    }
    best.map(|(_, found)| found)
}

/// The share e by which the disc's longer axis is off the kind's, by the quotient of axes.
pub(crate) fn off_share(kind: &Kind, outer: &Ellipse, inner: &Ellipse) -> f64 {
    let (min, max) = kind.ratios();
    0.5 * (quotient(outer, inner) * min / max).ln()
}

/// p/q, the disc's longer axis over the shorter one on the print.
fn quotient(outer: &Ellipse, inner: &Ellipse) -> f64 {
    let (o, i) = (outer.matrix(), inner.matrix());
    let determinant = i.determinant() / o.determinant();
    let mean = 0.5 * (o.vv * i.uu - 2.0 * o.uv * i.uv + o.uu * i.vv) / o.determinant();
    let apart = (mean * mean - determinant).max(0.0).sqrt();
    ((mean + apart) / (mean - apart)).sqrt()
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{camera::PixelPoint, ellipse::Symmetric2};

    /// A disc with the ratios p, q, its longer axis at `turn_rad` on the print, which is tilted about an
    /// axis at `about_rad`; both rims moved by `shift_px`.
    pub(crate) fn rims(
        radius_px: f64,
        (p, q): (f64, f64),
        turn_rad: f64,
        (cos_tilt, about_rad): (f64, f64),
        shift_px: f64,
    ) -> (Ellipse, Ellipse) {
        let seen = |major: f64, minor: f64, by_px: f64| {
            let (sin, cos) = turn_rad.sin_cos();
            let (a, b) = (major * major, minor * minor);
            let flat = Symmetric2 {
                uu: a * cos * cos + b * sin * sin,
                uv: (a - b) * sin * cos * cos_tilt,
                vv: (a * sin * sin + b * cos * cos) * cos_tilt * cos_tilt,
            };
            let (l0, l1, angle_rad) = flat.eigen();
            Ellipse {
                center: PixelPoint { u: 50.0, v: 50.0 },
                semi_major_px: radius_px * l0.sqrt() + by_px,
                semi_minor_px: radius_px * l1.sqrt() + by_px,
                angle_rad: angle_rad + about_rad,
            }
        };
        (seen(1.0, 1.0, -shift_px), seen(p, q, shift_px))
    }

    proptest! {
        #[test]
        fn axes_tell_kinds_apart_at_any_tilt_and_turn(
            radius_px in 15.0..80.0f64,
            turn_rad in -1.5..1.5f64,
            about_rad in -1.5..1.5f64,
            cos_tilt in 0.5..1.0f64,
            shift in -1.0..1.0f64,
            drawn in 0..4usize,
        ) {
            let kind = |major: f64, minor_diameter_m: f64| Kind {
                pattern: Pattern::Elliptical { minor_diameter_m },
                ..Kind::plain("", 1.0, major)
            };
            let kinds = [kind(0.6, 0.4), Kind::plain("", 1.0, 0.5), kind(0.7, 0.45), kind(0.6, 0.5)];
            let (min, max) = kinds[drawn].ratios();
            // A disc of 3 px whose rims are moved by more is as much another of these kinds with less.
            let shift_px = shift * (radius_px / 75.0).min(0.3);
            let tilt = (cos_tilt, about_rad);
            let (outer, inner) = rims(radius_px, (max, min), turn_rad, tilt, shift_px);
            let found = nearest_kind(&kinds, Polarity::BlackRing, true, (&outer, &inner));
            let (found, _, inner) = found.unwrap();
            prop_assert_eq!(found, KindId(drawn as u16));
            let (_, exact) = rims(radius_px, (max, min), turn_rad, tilt, 0.0);
            // A shift of both axes is no shift of an ellipse that is no circle's: little is left.
            prop_assert!((inner.semi_major_px - exact.semi_major_px).abs() < 0.05);
            let alone = [kinds[drawn].clone()];
            let white = nearest_kind(&alone, Polarity::WhiteRing, true, (&outer, &inner));
            prop_assert!(white.is_none());
        }
    }

    #[test]
    fn a_disc_that_is_no_kinds_is_refused() {
        let kinds = [Kind::plain("", 1.0, 0.5)];
        let (outer, inner) = rims(30.0, (0.65, 0.385), 0.4, (0.8, 0.3), 0.0);
        assert!(nearest_kind(&kinds, Polarity::BlackRing, true, (&outer, &inner)).is_none());
    }

    #[test]
    fn a_plain_kind_needs_similar_rims() {
        let kinds = [Kind::plain("", 1.0, 0.5)];
        let (outer, inner) = rims(8.0, (0.5, 0.5), 0.4, (0.8, 0.3), 0.0);
        let found = |similar| {
            nearest_kind(&kinds, Polarity::BlackRing, similar, (&outer, &inner)).is_some()
        };
        assert!(found(true) && !found(false));
    }
}
