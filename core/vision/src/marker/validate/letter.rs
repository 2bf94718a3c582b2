//! Whether a newly found small ring is a letter: o, O, 0, a stroke of even width drawn round.
//!
//! The rims of a roundel are similar; a stroke takes as much off the hole's shorter axis as off its
//! longer one, which makes it the flatter of the two. A letter's outline is no ellipse either. In small
//! print both are faint, and noise makes as much of either, but seldom of both at once. So they are
//! judged together: with the difference of shapes in pixels of the inner shorter semiaxis, s, and the
//! outer rim's unevenness u as a share of the contrast,
//!
//!   (s / 0.3 px)² + (u / 0.06)² ≤ 1.45²
//!
//! Outlines flatter than a roundel's at 60° are noughts more often than roundels: for them 0.3 px shrinks
//! with the quotient of axes.
//!
//! Of 6,000 rendered rings one exceeded 1.15 (1.6, a ring of little more than a pixel of black), of 900
//! photographed ones none 1.33; the letters that passed all other tests begin at 1.63
//! (`cargo test -p roundel-tests --test main real::`).
//!
//! Only the search asks this, since no letter is followed.

use crate::{
    ellipse::Ellipse,
    marker::{Ring, reject::Reject},
};

/// Discs with a longer shorter semiaxis are no small print, and perspective changes their shapes, pixels.
pub(crate) const SMALL_PX: f64 = 8.0;
/// What the difference of shapes is measured in, pixels.
const SHAPE_SCALE_PX: f64 = 0.3;
/// What the unevenness is measured in.
const UNEVENNESS_SCALE: f64 = 0.06;
/// Quotient of axes of a circle seen at 60°.
const AXES_AT_60_DEG: f64 = 2.0;
const LIMIT: f64 = 1.45;

/// That a ring is no letter.
pub(crate) fn check_letter(ring: &Ring) -> Result<(), Reject> {
    let (outer, inner) = (&ring.outer, &ring.inner);
    if inner.semi_minor_px > SMALL_PX {
        return Ok(());
    }
    let ((o, o_askew), (i, i_askew)) = (normalized(outer), normalized(inner));
    let flat = outer.semi_major_px / outer.semi_minor_px;
    let apart_px = (o - i).hypot(o_askew - i_askew) * inner.semi_minor_px / flat;
    let scale_px = SHAPE_SCALE_PX * (AXES_AT_60_DEG / flat).min(1.0);
    check_shape_and_unevenness(apart_px / scale_px, ring.unevenness)
}

/// That the difference of shapes, in its own scale, and the unevenness are not both too large.
pub(crate) fn check_shape_and_unevenness(apart: f64, unevenness: f64) -> Result<(), Reject> {
    if apart.hypot(unevenness / UNEVENNESS_SCALE) > LIMIT {
        Err(Reject::Similarity)
    } else {
        Ok(())
    }
}

/// The two free entries of an ellipse's matrix scaled to the determinant 1: half the difference of the
/// diagonal, and the rest.
fn normalized(rim: &Ellipse) -> (f64, f64) {
    let flat = rim.semi_major_px / rim.semi_minor_px;
    let (sin, cos) = (2.0 * rim.angle_rad).sin_cos();
    let half = 0.5 * (flat - 1.0 / flat);
    (half * cos, half * sin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PixelPoint;

    fn verdict(outer: (f64, f64), inner: (f64, f64), unevenness: f64) -> Result<(), Reject> {
        let rim = |(semi_major_px, semi_minor_px)| Ellipse {
            center: PixelPoint { u: 30.0, v: 20.0 },
            semi_major_px,
            semi_minor_px,
            angle_rad: 0.4,
        };
        check_letter(&Ring { unevenness, ..Ring::of_rims(rim(outer), rim(inner)) })
    }

    #[test]
    fn letters_are_refused_and_roundels_are_not() {
        // As measured on photographs of print: O, o and 0; and a rendered nought.
        for (outer, inner, unevenness) in [
            ((7.89, 7.02), (6.39, 5.05), 0.055),
            ((6.54, 5.55), (4.12, 3.10), 0.073),
            ((6.11, 4.64), (4.73, 3.22), 0.076),
            ((15.95, 4.19), (11.80, 2.48), 0.041),
        ] {
            assert_eq!(verdict(outer, inner, unevenness), Err(Reject::Similarity), "{outer:?}");
        }
        // Noise in one or the other, and a tilted ring without.
        assert_eq!(verdict((6.0, 5.0), (3.0, 2.5), 0.08), Ok(()));
        assert_eq!(verdict((6.0, 5.0), (3.2, 2.4), 0.03), Ok(()));
        assert_eq!(verdict((12.0, 6.0), (6.0, 3.0), 0.03), Ok(()));
        // A large ring's rims differ by perspective.
        assert_eq!(verdict((90.0, 60.0), (44.0, 28.0), 0.05), Ok(()));
    }
}
