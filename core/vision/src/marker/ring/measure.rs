//! One ring, measured where it is thought to be: all tests, both rims to a fraction of a pixel, its
//! kind, and the rims compensated for it.
//!
//! 1. The window is copied and thresholded into words of bits ([`crate::marker::ring::pixels::patch`]).
//! 2. The disc is followed from the probe's centre, and the black from the disc; counts refuse what is
//!    too small, too large or of the wrong ratio ([`crate::marker::ring::pixels::segments`]).
//! 3. Bits grown and shrunk give the belts in which the rims' blur lies, and the pixels that tell the
//!    levels B and W ([`crate::marker::ring::pixels::edge_band`], [`crate::marker::ring::subpixel::levels`]).
//!    Of a ring that is followed, the rims of the frame before say where the belts are, and steps 2 and
//!    3 are left out, unless a pixel between the belts contradicts that ([`crate::marker::ring::pixels::predicted`]).
//! 4. Inside the inner belt a pixel is disc, in it (I - B)/(W - B) of it is, and of the roundel in the
//!    outer belt (W - I)/(W - B). Blur moves weight across a rim but loses none, so the area and the
//!    difference of the covariance's eigenvalues ([`crate::ellipse::Shape::ellipse`]) are those of the
//!    sharp rim, and noise comes from the belts alone ([`crate::marker::ring::subpixel::moments`]).
//! 5. What blur does to the levels and past the belts is undone ([`crate::marker::ring::subpixel::blur`]).
//!
//! All of it is linear in the grey levels, whose noise therefore makes no bias.
//!
//! Accuracy against drawn rings (`benches/precision.rs`; inner/outer 0.4, margin 1.4, contrast 160, blur
//! 0.7 px, noise 2, kind known), mean radius, rms: to 30° of tilt 0.007 % at 81 px of diameter, 0.04 %
//! at 30 px, 0.15 % at 20 px, 0.2 to 0.3 % at 12 px; at 60°, 0.12 % at 30 px.
//!
//! Where the margin is narrower than four pixels its level is taken to be the disc's, and the outer belt
//! is one pixel wide; where it is narrower than two, the belt ends at the threshold's edge, and what lies
//! beyond follows from the blur: 0.15 to 0.5 % at 16 and 20 px with a margin of 1.2 and 1.5 px.
//!
//! Limits: where the disc's shorter semiaxis is below three times the blur, rims come out short (1 to
//! 2 % at 12 px and a blur of 1.1); black thinner than three pixels is never seen as it is, and rims of
//! such rings are off by up to 0.2 px.

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;

use crate::{
    frame::Frame,
    marker::{
        Ring,
        classify::{elliptical, plain::nearest_kind},
        kind::{Kind, RATIO_LIMITS},
        reject::Reject,
        ring::{
            checks::check_counts,
            pixels::{
                edge_band::{self, BELT_PX, BeltScratch, Belts},
                ellipse_mask::Area,
                patch::{Patch, WORD_PX},
                predicted::{Expected, Followed, belts_about, motion},
                segment_fill::Extent,
                segments::{Segments, Spans},
            },
            probe::{Probe, Rules},
            subpixel::{Outline, Places, blur::Unblurred, thin_ring::Depths, weigh},
        },
    },
    scratch::make_room,
};

/// A ring is measured anew at its own threshold, eq. (3), if that is further from the first one than
/// this share of the contrast; than the second, if the threshold has cut its rim.
pub(crate) const RETHRESHOLD_SHARE: (f64, f64) = (0.15, 0.02);

/// Turns in which the belts about expected rims are drawn.
const FOLLOWING_TURNS: usize = 2;
/// Memory of measuring one ring.
#[derive(Debug)]
pub(crate) struct MeasureScratch {
    /// What the processor can do at once.
    pub level: Level,
    patch: Patch,
    spans: Spans,
    belts: BeltScratch,
    depths: Depths,
}

impl Default for MeasureScratch {
    fn default() -> Self {
        Self {
            level: Level::new(),
            patch: Patch::default(),
            spans: Spans::default(),
            belts: BeltScratch::new(),
            depths: Depths::default(),
        }
    }
}

impl MeasureScratch {
    /// Room for rings as large as frames of this size.
    pub fn make_room(&mut self, (width, height): (usize, usize)) {
        let words = width.div_ceil(WORD_PX);
        self.patch.make_room(words, height);
        self.spans.make_room(height);
        make_room(&mut self.belts, edge_band::most_words(words, height));
        self.depths.make_room(width, height);
    }
}

/// The ring at a probe. Without kinds any ring passes whose ratio of diameters can be measured.
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
            threshold = own_threshold(found.0.black, found.0.white);
            found
        }
        None => {
            let mut found = rims(simd, frame, probe, rules, scratch)?;
            let own = own_threshold(found.0.black, found.0.white);
            let off = f64::from(own.abs_diff(threshold));
            let limit = if found.1.cut { RETHRESHOLD_SHARE.1 } else { RETHRESHOLD_SHARE.0 };
            if off > limit * (found.0.white - found.0.black) {
                // If something bridges the rims at the middle, what works is kept.
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
    let (Unblurred { outer, inner, black, white }, Outline { unevenness, similar, .. }) = found;
    let (kind, outer, inner) = if kinds.is_empty() {
        let ratio = inner.mean_radius_px() / outer.mean_radius_px();
        if ratio < RATIO_LIMITS.0 || ratio > RATIO_LIMITS.1 {
            return Err(Reject::AreaRatio);
        }
        (None, outer, inner)
    } else {
        let nearest = if rules.similar {
            nearest_kind(kinds, probe.polarity, &outer, &inner)
        } else {
            elliptical::nearest_kind(kinds, probe.polarity, similar, (&outer, &inner))
        };
        let (kind, outer, inner) = nearest.ok_or(Reject::Kind)?;
        (Some(kind), outer, inner)
    };
    let ring = Ring { kind, threshold, black, white, unevenness, ..Ring::of_rims(outer, inner) };
    Ok(ring.seen_as(probe.polarity))
}

/// The level halfway between black and white.
#[inline(always)]
pub(crate) fn own_threshold(black: f64, white: f64) -> u8 {
    (0.5 * (black + white)).round().clamp(1.0, 255.0) as u8
}

/// The probe's window of the frame.
#[inline(always)]
fn load<S: Simd>(simd: S, patch: &mut Patch, frame: &Frame, probe: &Probe) {
    Patch::load(simd, patch, frame, probe.bounds, (probe.frame_threshold(), probe.polarity));
}

/// The ring at the probe, by its segments.
#[simd]
fn rims<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    scratch: &mut MeasureScratch,
) -> Result<(Unblurred, Outline), Reject> {
    let MeasureScratch { patch, spans, belts, depths, .. } = scratch;
    let segments = Segments::find(simd, frame, patch, probe.center, spans)?;
    let Segments { disc, ring, of_disc, of_ring } = &segments;
    check_counts(of_ring, of_disc, rules)?;
    let belts = Belts::round(simd, patch, (disc, &spans.discs), (ring, &spans.rings), belts);
    let middle = |first: usize, end: usize| (first + end) / 2;
    let columns = &ring.columns;
    let places = Places {
        middle: (
            middle(columns.first as usize, columns.end as usize) & !1,
            middle(ring.top, ring.bottom) - belts.top,
        ),
        outer: area_round(ring, &belts, patch),
        inner: area_round(disc, &belts, patch),
        belts,
        counted: Some((of_ring, of_disc)),
    };
    weigh(simd, frame, probe, rules, (patch, &places), depths)
}

/// The ring at its expected rims, if it is just there.
#[simd]
fn followed<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    scratch: &mut MeasureScratch,
) -> Option<(Unblurred, Outline)> {
    let MeasureScratch { patch, belts, depths, .. } = scratch;
    let expected = probe.expected.as_ref()?;
    let (du, dv) = motion(simd, patch, expected)?;
    let mut expected = expected.moved(du, dv);
    for _ in 0..FOLLOWING_TURNS {
        let Followed { belts, outer, inner, middle } = belts_about(simd, patch, &expected, belts)?;
        let places = Places { belts, middle, outer, inner, counted: None };
        let found = weigh(simd, frame, probe, rules, (patch, &places), depths).ok()?;
        let (outer, inner) = (found.0.outer, found.0.inner);
        if expected.is_met(&outer, &inner) {
            let off = own_threshold(found.0.black, found.0.white).abs_diff(probe.threshold);
            let limit = RETHRESHOLD_SHARE.0 * (found.0.white - found.0.black);
            return (f64::from(off) <= limit).then_some(found);
        }
        expected = Expected::new(&outer, &inner);
    }
    None
}

/// Rows of the belts, and columns, that a segment and the belt round it lie in.
fn area_round(extent: &Extent, belts: &Belts, patch: &Patch) -> Area {
    let (first, end) = (extent.columns.first as usize, extent.columns.end as usize);
    Area {
        rows: (
            (extent.top - belts.top).saturating_sub(BELT_PX),
            (extent.bottom - belts.top + BELT_PX).min(belts.disc_core.len() / patch.words),
        ),
        columns: (first.saturating_sub(BELT_PX), (end + BELT_PX).min(patch.words * WORD_PX)),
    }
}
