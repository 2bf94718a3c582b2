//! Compensation of misplaced rims (paper, section 3.5).
//!
//! A wrong threshold, saturation or bloom moves both rims towards the black by the same distance t:
//! the disc looks larger, the ring smaller. The print's ratio of diameters is known, so t follows
//! from the ratio of the areas, r = d_i²/d_o², eq. (7):
//!
//!   (e₀ᵢ - t)(e₁ᵢ - t) = r (e₀ₒ + t)(e₁ₒ + t)
//!
//! Expanded, and collected by powers of t:
//!
//!   (1 - r) t² - [(e₀ᵢ + e₁ᵢ) + r (e₀ₒ + e₁ₒ)] t + (e₀ᵢ e₁ᵢ - r e₀ₒ e₁ₒ) = 0
//!
//! which is eq. (8) with the sums where the print has products ([`crate::errata`]).

use crate::{ellipse::Ellipse, simd::Lane};

/// t of eq. (8), pixels, for measured rims and the print's ratio of inner to outer diameter;
/// positive if white looks too large. `None` if no t gives the ratio.
#[inline(always)]
pub fn rim_shift_px(outer: &Ellipse, inner: &Ellipse, ratio: f64) -> Option<f64> {
    let axes = |rim: &Ellipse| [rim.semi_major_px, rim.semi_minor_px];
    let (shift_px, is_one) = shift_px(axes(outer), axes(inner), ratio);
    is_one.then_some(shift_px)
}

/// [`rim_shift_px`] from semiaxes, and the lanes that have a solution.
#[inline(always)]
pub(crate) fn shift_px<T: Lane>(outer: [T; 2], inner: [T; 2], ratio: f64) -> (T, T::Mask) {
    let r = ratio * ratio;
    let a = 1.0 - r;
    let b = inner[0] + inner[1] + (outer[0] + outer[1]) * r;
    let c = inner[0] * inner[1] - outer[0] * r * outer[1];
    let discriminant = b * b - c * (4.0 * a);
    // False for NaN.
    let is_one = b.splat(0.0).at_most(discriminant);
    // The smaller root, in the form that loses no digits when c is near 0. The larger one exceeds
    // the inner semiaxes, which must stay positive.
    (c * 2.0 / (b + discriminant.root()), is_one)
}

/// Both rims (outer, inner) with a shift of `shift_px` undone; `None` if a rim would vanish or the
/// disc would exceed the ring.
#[inline(always)]
pub fn compensated(outer: &Ellipse, inner: &Ellipse, shift_px: f64) -> Option<(Ellipse, Ellipse)> {
    let moved = |rim: &Ellipse, by: f64| Ellipse {
        semi_major_px: rim.semi_major_px + by,
        semi_minor_px: rim.semi_minor_px + by,
        ..*rim
    };
    let (outer, inner) = (moved(outer, shift_px), moved(inner, -shift_px));
    let fits = outer.is_valid()
        && inner.is_valid()
        && inner.semi_major_px < outer.semi_major_px
        && inner.semi_minor_px < outer.semi_minor_px;
    fits.then_some((outer, inner))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PixelPoint;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equation_8_recovers_the_shift(
            radius in 5.0..100.0f64,
            tilt in 0.4..1.0f64,
            ratio in 0.25..0.75f64,
            shift in -0.6..0.6f64,
        ) {
            let center = PixelPoint { u: 0.0, v: 0.0 };
            let rim = |scale: f64, by: f64| Ellipse {
                center,
                semi_major_px: radius * scale + by,
                semi_minor_px: radius * tilt * scale + by,
                angle_rad: 0.2,
            };
            prop_assume!(radius * tilt * ratio > 1.0);
            let (outer, inner) = (rim(1.0, -shift), rim(ratio, shift));
            let found = rim_shift_px(&outer, &inner, ratio).unwrap();
            prop_assert!((found - shift).abs() < 1e-9);
            let (outer, inner) = compensated(&outer, &inner, found).unwrap();
            prop_assert!((outer.semi_major_px - radius).abs() < 1e-9);
            prop_assert!((inner.semi_minor_px - radius * tilt * ratio).abs() < 1e-9);
        }
    }

    #[test]
    fn a_rim_that_would_vanish_is_rejected() {
        let rim = |r| Ellipse {
            center: PixelPoint::default(),
            semi_major_px: r,
            semi_minor_px: r,
            angle_rad: 0.0,
        };
        assert_eq!(compensated(&rim(5.0), &rim(2.0), 2.5), None);
        assert_eq!(compensated(&rim(5.0), &rim(4.0), -1.0), None);
        assert_eq!(rim_shift_px(&rim(f64::NAN), &rim(2.0), 0.4), None);
    }
}
