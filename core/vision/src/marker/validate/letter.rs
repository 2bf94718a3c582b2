//! Rejects new small rings that are letters: o, O, 0, strokes of even width.
//!
//! The rims of a roundel are similar; a stroke takes as much off the hole's shorter axis as off its
//! longer one, which makes the hole flatter. The outline of a letter is not an ellipse either. In small
//! print both effects are faint, and noise can imitate either, but seldom both. So they are
//! judged together: with s the difference of shapes in pixels of the inner shorter semiaxis, and u the
//! outer rim's unevenness as a share of the contrast,
//!
//!   (s / 0.3 px)² + (u / 0.06)² ≤ 1.45²
//!
//! Outlines flatter than a circle at 60° are more often the digit 0 than roundels: for them 0.3 px decreases with the
//! quotient of axes.
//!
//! Among 6,000 rendered rings, one exceeded 1.15 (1.6, a ring with little more than a pixel of black), of 900
//! photographed ones none 1.33; the letters that passed all other tests begin at 1.63
//! (`cargo test -p roundel-tests --test main real::`).

use crate::{
    ellipse::Ellipse,
    marker::{Ring, reject::Reject},
};

/// Discs with a longer shorter semiaxis, pixels, are not tested: they are not small print, and
/// perspective changes their shapes.
pub(crate) const SMALL_PX: f64 = 8.0;
/// Scale of the difference of shapes, pixels.
const SHAPE_SCALE_PX: f64 = 0.3;
/// Scale of the unevenness.
const UNEVENNESS_SCALE: f64 = 0.06;
/// Quotient of axes of a circle tilted by 60°.
const AXES_AT_60_DEG: f64 = 2.0;
const LIMIT: f64 = 1.45;

/// Rejects a ring that looks like a letter.
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

/// Rejects if the scaled difference of shapes and the unevenness together are too large.
pub(crate) fn check_shape_and_unevenness(apart: f64, unevenness: f64) -> Result<(), Reject> {
    if apart.hypot(unevenness / UNEVENNESS_SCALE) > LIMIT {
        Err(Reject::Similarity)
    } else {
        Ok(())
    }
}

/// The two free entries of an ellipse's matrix scaled to determinant 1: half the difference of the
/// diagonal, and the off-diagonal.
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
    fn letters_are_rejected_and_roundels_are_not() {
        // Measured on photographs of print: O, o and 0; and a rendered 0.
        for (outer, inner, unevenness) in [
            ((7.89, 7.02), (6.39, 5.05), 0.055),
            ((6.54, 5.55), (4.12, 3.10), 0.073),
            ((6.11, 4.64), (4.73, 3.22), 0.076),
            ((15.95, 4.19), (11.80, 2.48), 0.041),
        ] {
            assert_eq!(verdict(outer, inner, unevenness), Err(Reject::Similarity), "{outer:?}");
        }
        // Noise in one or the other, and a tilted ring without noise.
        assert_eq!(verdict((6.0, 5.0), (3.0, 2.5), 0.08), Ok(()));
        assert_eq!(verdict((6.0, 5.0), (3.2, 2.4), 0.03), Ok(()));
        assert_eq!(verdict((12.0, 6.0), (6.0, 3.0), 0.03), Ok(()));
        // A large ring's rims differ by perspective.
        assert_eq!(verdict((90.0, 60.0), (44.0, 28.0), 0.05), Ok(()));
    }
}
