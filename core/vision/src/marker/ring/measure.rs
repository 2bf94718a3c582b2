//! Measurement of one ring: all tests, both rims to a fraction of a pixel, its kind, and the rims compensated for it.
//!
//! 1. The window is copied and thresholded into words of bits ([`crate::marker::ring::pixels::patch`]).
//! 2. The disc is filled from the probe's centre, and the black from the disc; segments that are
//!    too small, too large or of the wrong ratio are rejected ([`crate::marker::ring::pixels::segments`]).
//! 3. Dilated and eroded bits give the edge bands, which contain the rims' blur, and the pixels that determine the
//!    levels B and W ([`crate::marker::ring::pixels::edge_band`], [`crate::marker::ring::subpixel::levels`]).
//!    For a tracked ring, the predicted rims give the bands, and steps 2 and 3 are skipped, unless a pixel between
//!    the bands contradicts the prediction ([`crate::marker::ring::pixels::predicted`]).
//! 4. Inside the inner band a pixel counts fully for the disc, in it by (I - B)/(W - B), and for the roundel in the
//!    outer band by (W - I)/(W - B). Blur moves weight across a rim but preserves it, so the area and the
//!    difference of the covariance's eigenvalues ([`crate::ellipse::Shape::ellipse`]) are those of the
//!    sharp rim, and noise enters from the bands alone ([`crate::marker::ring::subpixel::moments`]).
//! 5. The effect of blur on the levels, and beyond the bands, is removed ([`crate::marker::ring::subpixel::blur`]).
//!
//! All steps are linear in the grey levels, so noise causes no bias.
//!
//! Accuracy against drawn rings (`benches/precision.rs`; inner/outer 0.4, margin 1.4, contrast 160, blur
//! 0.7 px, noise 2, known kind), mean radius, rms: to 30° of tilt 0.007 % at 81 px of diameter, 0.04 %
//! at 30 px, 0.15 % at 20 px, 0.2 to 0.3 % at 12 px; at 60°, 0.12 % at 30 px.
//!
//! Where the margin is narrower than four pixels, its level is assumed to be the disc's, and the outer band
//! is one pixel wide; where it is narrower than two, the band ends at the threshold's edge, and the part
//! beyond follows from the blur: 0.15 to 0.5 % at 16 and 20 px with a margin of 1.2 and 1.5 px.
//!
//! Limits: where the disc's shorter semiaxis is below three times the blur, rims come out short (1 to
//! 2 % at 12 px and a blur of 1.1). Black thinner than three pixels nowhere shows its own level, and the rims of
//! such rings are off by up to 0.2 px.

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;

use crate::{
    ellipse::Ellipse,
    frame::Frame,
    id::KindId,
    marker::{
        Ring,
        classify::{
            elliptical,
            plain::{Classified, nearest_kind},
        },
        kind::{Kind, RATIO_LIMITS},
        paper_edge::{self, RoughRing},
        reject::Reject,
        ring::{
            checks::check_sizes,
            pixels::{
                edge_band::{self, BAND_PX, BandScratch, EdgeBands},
                ellipse_mask::Area,
                patch::{Patch, WORD_PX},
                predicted::{PredictedBands, PredictedRims, bands_about, disc_motion},
                segment_fill::{Extent, FilledSegment},
                segments::{Segments, Spans},
            },
            probe::{Probe, Rules},
            subpixel::{
                BandLayout, RefinedRims, SegmentSizes, refine_rims, thin_ring::RimDistances,
            },
        },
    },
    scratch::reserve_total,
};

/// A ring is measured again at its own threshold, eq. (3), if that differs from the first one by
/// more than this share of the contrast; the second share applies if the threshold has cut its rim.
pub(crate) const RETHRESHOLD_SHARE: (f64, f64) = (0.15, 0.02);

/// The light across a ring with a more uneven rim is searched for the edge of a shadow.
pub(crate) const UNEVEN: f64 = 0.035;
/// With more than this error of the outer rim the paper's edge is fitted, pixels.
const NARROW_MARGIN_PX: f64 = 0.013;
/// Iterations in which the bands of predicted rims are drawn.
const FOLLOWING_TURNS: usize = 2;
/// Memory of measuring one ring.
#[derive(Debug)]
pub(crate) struct MeasureScratch {
    /// Instruction set.
    pub level: Level,
    pub(super) patch: Patch,
    pub(super) spans: Spans,
    pub(super) bands: BandScratch,
    distances: RimDistances,
}

impl Default for MeasureScratch {
    fn default() -> Self {
        Self {
            level: Level::new(),
            patch: Patch::default(),
            spans: Spans::default(),
            bands: BandScratch::new(),
            distances: RimDistances::default(),
        }
    }
}

impl MeasureScratch {
    /// Reserves memory for rings as large as frames of this size.
    pub fn reserve(&mut self, (width, height): (usize, usize)) {
        let words = width.div_ceil(WORD_PX);
        self.patch.reserve(words, height);
        self.spans.reserve(height);
        reserve_total(&mut self.bands, edge_band::max_words(words, height));
        self.distances.reserve(width, height);
    }
}

/// The ring at a probe. Without kinds, any ring with a measurable ratio of diameters passes.
pub(crate) fn measure(
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    kinds: &[Kind],
    scratch: &mut MeasureScratch,
) -> Result<Ring, Reject> {
    dispatch!(scratch.level, simd => measure_with(simd, frame, probe, rules, kinds, scratch))
}

#[simd]
fn measure_with<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    kinds: &[Kind],
    scratch: &mut MeasureScratch,
) -> Result<Ring, Reject> {
    load(simd, &mut scratch.patch, frame, probe);
    let mut threshold = probe.threshold;
    let found = match followed(simd, frame, probe, rules, scratch) {
        Some(found) => {
            threshold = own_threshold(found.black, found.white);
            found
        }
        None => {
            let mut found = rims(simd, frame, probe, rules, scratch)?;
            let own = own_threshold(found.black, found.white);
            let off = f64::from(own.abs_diff(threshold));
            let limit = if found.is_cut { RETHRESHOLD_SHARE.1 } else { RETHRESHOLD_SHARE.0 };
            if off > limit * (found.white - found.black) {
                // If the rims are bridged at that threshold, the first result stands.
                let probe = Probe { threshold: own, ..*probe };
                load(simd, &mut scratch.patch, frame, &probe);
                if let Ok(better) = rims(simd, frame, &probe, rules, scratch) {
                    (found, threshold) = (better, own);
                }
            } else {
                threshold = own;
            }
            found
        }
    };
    let RefinedRims { outer, inner, black, white, unevenness, is_similar, margin_px, .. } = found;
    let classify = |outer: &Ellipse| classified(kinds, probe, rules, is_similar, [outer, &inner]);
    let disc_ratio = inner.mean_radius_px() / outer.mean_radius_px();
    let rough =
        RoughRing { outer, black, white, polarity: probe.polarity, disc_ratio, disc_share: 1.0 };
    // In uneven light the levels are those of no single edge.
    let is_even = probe.predicted.is_some() || unevenness <= UNEVEN;
    let is_narrow = rules.fits_paper_edge && is_even && margin_px > NARROW_MARGIN_PX;
    let edge = if is_narrow { paper_edge::fit(scratch.level, frame, &rough) } else { None };
    let with_edge = edge.and_then(|edge| Some((classify(&edge.outer).ok()?, edge.error_px)));
    let (classified, margin_px) = match with_edge {
        Some(found) => found,
        None => (classify(&outer)?, margin_px),
    };
    let (kind, [outer, inner], shift_px) = classified;
    let ring = Ring {
        kind,
        threshold,
        black,
        white,
        unevenness,
        margin_px,
        shift_px,
        ..Ring::of_rims(outer, inner)
    };
    Ok(ring.with_polarity(probe.polarity))
}

/// The kind with these rims, outer and inner, the rims compensated for it, and their shift.
#[inline(always)]
fn classified(
    kinds: &[Kind],
    probe: &Probe,
    rules: &Rules,
    is_similar: bool,
    [outer, inner]: [&Ellipse; 2],
) -> Result<(Option<KindId>, [Ellipse; 2], f64), Reject> {
    let polarity = probe.polarity;
    if kinds.is_empty() {
        let ratio = inner.mean_radius_px() / outer.mean_radius_px();
        if ratio < RATIO_LIMITS.0 || ratio > RATIO_LIMITS.1 {
            return Err(Reject::AreaRatio);
        }
        return Ok((None, [*outer, *inner], 0.0));
    }
    let nearest = if rules.similar {
        nearest_kind(kinds, polarity, outer, inner)
    } else {
        elliptical::nearest_kind(kinds, polarity, is_similar, outer, inner)
    };
    let Classified { kind, outer, inner, shift_px } = nearest.ok_or(Reject::Kind)?;
    Ok((Some(kind), [outer, inner], shift_px))
}

/// The level halfway between black and white.
#[inline(always)]
pub(crate) fn own_threshold(black: f64, white: f64) -> u8 {
    (0.5 * (black + white)).round().clamp(1.0, 255.0) as u8
}

/// Loads the probe's window of the frame.
#[inline(always)]
fn load<S: Simd>(simd: S, patch: &mut Patch, frame: &Frame, probe: &Probe) {
    Patch::load(simd, patch, frame, probe.bounds, probe.frame_threshold());
}

/// The ring at the probe, by its segments.
#[simd]
fn rims<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    scratch: &mut MeasureScratch,
) -> Result<RefinedRims, Reject> {
    let MeasureScratch { patch, spans, bands, distances, .. } = scratch;
    let segments = Segments::find(simd, frame, patch, probe.center, spans)?;
    let Segments { disc, ring, disc_size, ring_size } = &segments;
    check_sizes(ring_size, disc_size, rules)?;
    let bands = EdgeBands::round(
        simd,
        patch,
        FilledSegment { extent: disc, spans: &spans.discs },
        FilledSegment { extent: ring, spans: &spans.rings },
        bands,
    );
    let middle = |first: usize, end: usize| (first + end) / 2;
    let columns = &ring.columns;
    let layout = BandLayout {
        patch,
        middle: (
            middle(columns.first as usize, columns.end as usize) & !1,
            middle(ring.top, ring.bottom) - bands.top,
        ),
        outer: area_round(ring, &bands, patch),
        inner: area_round(disc, &bands, patch),
        bands,
        sizes: Some(SegmentSizes { ring: ring_size, disc: disc_size }),
    };
    refine_rims(simd, frame, probe, rules, &layout, distances)
}

/// The ring at its predicted rims, if it is there.
#[simd]
fn followed<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    scratch: &mut MeasureScratch,
) -> Option<RefinedRims> {
    let MeasureScratch { patch, bands, distances, .. } = scratch;
    let predicted = probe.predicted.as_ref()?;
    let (du, dv) = disc_motion(simd, patch, predicted)?;
    let mut predicted = predicted.moved(du, dv);
    for _ in 0..FOLLOWING_TURNS {
        let PredictedBands { bands, outer, inner, middle } =
            bands_about(simd, patch, &predicted, bands)?;
        let layout = BandLayout { patch, bands, middle, outer, inner, sizes: None };
        let found = refine_rims(simd, frame, probe, rules, &layout, distances).ok()?;
        if predicted.is_near(&found.outer, &found.inner) {
            let off = own_threshold(found.black, found.white).abs_diff(probe.threshold);
            let limit = RETHRESHOLD_SHARE.0 * (found.white - found.black);
            return (f64::from(off) <= limit).then_some(found);
        }
        predicted = PredictedRims::new(&found.outer, &found.inner);
    }
    None
}

/// The area that contains a segment and its edge band, in the bands' rows.
fn area_round(extent: &Extent, bands: &EdgeBands, patch: &Patch) -> Area {
    let (first, end) = (extent.columns.first as usize, extent.columns.end as usize);
    Area {
        rows: (
            (extent.top - bands.top).saturating_sub(BAND_PX),
            (extent.bottom - bands.top + BAND_PX).min(bands.disc_core.len() / patch.words),
        ),
        columns: (first.saturating_sub(BAND_PX), (end + BAND_PX).min(patch.words * WORD_PX)),
    }
}
