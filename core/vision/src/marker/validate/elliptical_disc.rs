//! Elliptical discs.

use crate::marker::{
    Ring,
    classify::elliptical::off_share,
    kind::Kind,
    reject::Reject,
    validate::letter::{SMALL_PX, check_shape_and_unevenness},
};

/// The same of a small disc that is newly found, in what it is measured together with unevenness; the
/// first where the disc is rounder than its kind.
const SCALES_PX: (f64, f64) = (0.2, 0.4);

/// That a newly found ring of a kind with an elliptical disc is no print.
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
    fn small_discs_that_are_off_or_uneven_are_refused() {
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
