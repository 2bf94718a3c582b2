//! One ring, measured where it is thought to be: all tests, both rims to a fraction of a pixel, its
//! kind, and the rims compensated for it.

use crate::{
    frame::Frame,
    marker::{
        Ring,
        examine::{Probe, Rules, examine},
        kind::{Kind, RATIO_LIMITS, nearest_kind},
        outline::unevenness,
        refine::refine,
        reject::Reject,
        zone::RowScratch,
    },
    segment::FillScratch,
};

/// A ring is refilled at its own threshold, eq. (3), if that is further from the first one than this
/// share of the contrast.
const RETHRESHOLD_SHARE: f64 = 0.03;

/// Memory of measuring one ring.
#[derive(Debug, Default)]
pub(crate) struct MeasureScratch {
    fill: FillScratch,
    row: RowScratch,
}

/// The ring at a probe. Without kinds any ring passes whose ratio of diameters can be measured.
pub(crate) fn measure(
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    kinds: &[Kind],
    scratch: &mut MeasureScratch,
) -> Result<Ring, Reject> {
    let mut coarse = examine(frame, probe, rules, &mut scratch.fill)?;
    let mut threshold = coarse.threshold();
    let off = f64::from(threshold.abs_diff(probe.threshold));
    if off > RETHRESHOLD_SHARE * (coarse.white - coarse.black) {
        match examine(frame, &Probe { threshold, ..*probe }, rules, &mut scratch.fill) {
            Ok(better) => coarse = better,
            // Something bridges the rims at the middle; what works is kept.
            Err(_) => threshold = probe.threshold,
        }
    }
    let fine = refine(frame, &coarse, &mut scratch.row)?;
    let (kind, outer, inner) = if kinds.is_empty() {
        let ratio = fine.inner.mean_radius_px() / fine.outer.mean_radius_px();
        if ratio < RATIO_LIMITS.0 || ratio > RATIO_LIMITS.1 {
            return Err(Reject::AreaRatio);
        }
        (None, fine.outer, fine.inner)
    } else {
        let (kind, outer, inner) =
            nearest_kind(kinds, &fine.outer, &fine.inner).ok_or(Reject::Kind)?;
        (Some(kind), outer, inner)
    };
    let (black, white) = (fine.black, fine.white);
    let unevenness = unevenness(frame, &outer, white - black)?;
    let ring = Ring { kind, threshold, black, white, unevenness, ..Ring::of_rims(outer, inner) };
    Ok(ring)
}
