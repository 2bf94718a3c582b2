//! Rejects new small rings whose disc fits an elliptical kind too poorly.
//!
//! With e a the deviation of the disc's longer semiaxis from the kind's ([`off_share`]) and u the unevenness of the outer
//! rim, as in [`crate::marker::validate::letter`],
//!
//!   (e a / 0.4 px)² + (u / 0.06)² ≤ 1.45²,   0.2 px for e < 0,
//!
//! for discs with a shorter semiaxis of up to 8 px. Blur narrows a thin disc, so a disc that is rounder than its kind is
//! allowed half as much.

use crate::marker::{
    Ring,
    classify::elliptical::off_share,
    kind::Kind,
    reject::Reject,
    validate::letter::{SMALL_PX, check_shape_and_unevenness},
};

/// Scale of the deviation, pixels: for discs rounder than the kind, and for the others.
const SCALES_PX: (f64, f64) = (0.2, 0.4);

/// Rejects a new ring whose disc deviates from its kind.
pub(crate) fn check_disc(ring: &Ring, kind: &Kind) -> Result<(), Reject> {
    let Ring { outer, inner, unevenness, .. } = ring;
    if inner.semi_minor_px > SMALL_PX {
        return Ok(());
    }
    let off_px = off_share(kind, outer, inner) * inner.semi_major_px;
    let scale_px = if off_px < 0.0 { SCALES_PX.0 } else { SCALES_PX.1 };
    check_shape_and_unevenness(off_px / scale_px, *unevenness)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::{Pattern, classify::elliptical::tests::rims};

    #[test]
    fn small_discs_with_wrong_axes_or_uneven_rims_are_rejected() {
        let pattern = Pattern::Elliptical { minor_diameter_m: 0.4 };
        let kind = Kind { pattern, ..Kind::plain("", 1.0, 0.6) };
        let verdict = |(p, q), unevenness| {
            let (outer, inner) = rims(7.0, (p, q), 0.4, (0.9, 0.3), 0.0);
            check_disc(&Ring { unevenness, ..Ring::of_rims(outer, inner) }, &kind)
        };
        assert_eq!(verdict((0.6, 0.4), 0.06), Ok(()));
        assert_eq!(verdict((0.64, 0.375), 0.03), Ok(()));
        assert_eq!(verdict((0.64, 0.375), 0.08), Err(Reject::Similarity));
        assert_eq!(verdict((0.56, 0.43), 0.03), Err(Reject::Similarity));
        assert_eq!(verdict((0.7, 0.34), 0.02), Err(Reject::Similarity));
        assert_eq!(verdict((0.6, 0.4), 0.1), Err(Reject::Similarity));
    }
}
