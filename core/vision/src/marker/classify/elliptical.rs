//! Kinds with elliptical discs, by the disc's two axes (paper, sections 7.2 and 7.4).
//!
//! The outer rim is a circle on the print; the matrix of its image, **O** = L Lᵀ, is the local affine map of the print's
//! plane. Mapped back, the disc's rim **I** becomes L⁻¹ **I** L⁻ᵀ, whose eigenvalues are the squared ratios p² ≥ q² of
//! the disc's axes to the outer diameter:
//!
//!   p² q² = det **I** / det **O**,   p² + q² = tr(**O**⁻¹ **I**)
//!
//! up to the square of perspective, for any tilt. A common shift t of both rims changes the product (as in
//! [`crate::marker::classify::compensation`], with r = p q of the kind), so t follows from it. The quotient p/q of the
//! shifted rims measures how elliptical the disc is; it is 1 for a plain kind. The kind with the closest t and quotient,
//! both in pixels of the disc's rim, is chosen if it is close enough.
//!
//! With the kind's quotient k, the disc's longer axis deviates by the share e = ½ ln(p/q / k) and the shorter one by as
//! much in the other direction. Noise and blur act on the shorter axis, so kinds are compared by e in pixels of it. The
//! limit is in pixels of the longer axis: a wrong disc deviates more the larger it is, a blurred one only where it is
//! small. A ring of a plain kind must also pass the similarity test, as with plain kinds alone.
//!
//! Limits: small images separate kinds only if their rims differ by more than some tenths of a pixel.
//! `tests/elliptical.rs` of the tests crate measures recall and confusion.

use crate::{
    ellipse::Ellipse,
    id::KindId,
    marker::{
        classify::{
            compensation::{compensated, rim_shift_px},
            plain::{Classified, shift_limit_px},
        },
        kind::{Kind, Pattern, Polarity},
    },
};

/// Limit of the deviation of the disc's quotient of axes from the kind's: pixels of the longer
/// semiaxis, and a share of it for perspective …
const QUOTIENT_LIMIT: (f64, f64) = (0.6, 0.04);
/// … which applies in full from this longer semiaxis of the outer rim on, pixels, and as the square
/// below.
const PERSPECTIVE_PX: f64 = 40.0;
/// As [`crate::marker::classify::plain::nearest_kind`], among kinds with elliptical discs and, if
/// the rims are similar, plain ones.
pub(crate) fn nearest_kind(
    kinds: &[Kind],
    polarity: Polarity,
    similar: bool,
    outer: &Ellipse,
    inner: &Ellipse,
) -> Option<Classified> {
    let limit_px = shift_limit_px(outer);
    let mut best: Option<(f64, Classified)> = None;
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
            let kind = KindId(index as u16);
            best = Some((distance_px, Classified { kind, outer, inner, shift_px }));
        }
    }
    best.map(|(_, found)| found)
}

/// The share e by which the disc's longer axis deviates from the kind's, by the quotient of axes.
pub(crate) fn off_share(kind: &Kind, outer: &Ellipse, inner: &Ellipse) -> f64 {
    let (min, max) = kind.ratios();
    0.5 * (quotient(outer, inner) * min / max).ln()
}

/// p/q, the ratio of the disc's longer to its shorter axis on the print.
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

    /// A disc with the ratios p, q, its longer axis at `turn_rad` on the print, which is tilted
    /// about an axis at `about_rad`; both rims shifted by `shift_px`.
    pub(crate) fn rims(
        radius_px: f64,
        (p, q): (f64, f64),
        turn_rad: f64,
        (cos_tilt, about_rad): (f64, f64),
        shift_px: f64,
    ) -> (Ellipse, Ellipse) {
        let imaged = |major: f64, minor: f64, by_px: f64| {
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
        (imaged(1.0, 1.0, -shift_px), imaged(p, q, shift_px))
    }

    proptest! {
        #[test]
        fn axes_distinguish_kinds_at_any_tilt_and_yaw(
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
            // With a larger shift, a disc of 3 px fits another of these kinds with a smaller one.
            let shift_px = shift * (radius_px / 75.0).min(0.3);
            let tilt = (cos_tilt, about_rad);
            let (outer, inner) = rims(radius_px, (max, min), turn_rad, tilt, shift_px);
            let found = nearest_kind(&kinds, Polarity::BlackRing, true, &outer, &inner);
            let Classified { kind, inner, .. } = found.unwrap();
            prop_assert_eq!(kind, KindId(drawn as u16));
            let (_, exact) = rims(radius_px, (max, min), turn_rad, tilt, 0.0);
            // A shift of both semiaxes is not an exact shift of an ellipse: a small error remains.
            prop_assert!((inner.semi_major_px - exact.semi_major_px).abs() < 0.05);
            let alone = [kinds[drawn].clone()];
            let white = nearest_kind(&alone, Polarity::WhiteRing, true, &outer, &inner);
            prop_assert!(white.is_none());
        }
    }

    #[test]
    fn a_disc_of_no_kind_is_rejected() {
        let kinds = [Kind::plain("", 1.0, 0.5)];
        let (outer, inner) = rims(30.0, (0.65, 0.385), 0.4, (0.8, 0.3), 0.0);
        assert!(nearest_kind(&kinds, Polarity::BlackRing, true, &outer, &inner).is_none());
    }

    #[test]
    fn a_plain_kind_needs_similar_rims() {
        let kinds = [Kind::plain("", 1.0, 0.5)];
        let (outer, inner) = rims(8.0, (0.5, 0.5), 0.4, (0.8, 0.3), 0.0);
        let found =
            |similar| nearest_kind(&kinds, Polarity::BlackRing, similar, &outer, &inner).is_some();
        assert!(found(true) && !found(false));
    }
}
