//! One ring, measured where it is thought to be: all tests, both rims to a fraction of a pixel, its
//! kind, and the rims compensated for it.
//!
//! 1. The window is copied and thresholded into words of bits ([`crate::marker::patch`]).
//! 2. The disc is followed from the probe's centre, and the black from the disc
//!    ([`crate::marker::spans`]); counts refuse what is too small, too large or of the wrong ratio
//!    ([`crate::marker::examine`]).
//! 3. Bits grown and shrunk give the belts in which the rims' blur lies, and the pixels that tell the
//!    levels B and W ([`crate::marker::belt`], [`crate::marker::levels`]).
//! 4. Inside the inner belt a pixel is disc, in it (I - B)/(W - B) of it is, and of the roundel in the
//!    outer belt (W - I)/(W - B). Blur moves weight across a rim but loses none, so the area and the
//!    difference of the covariance's eigenvalues ([`crate::ellipse::Shape::ellipse`]) are those of the
//!    sharp rim, and noise comes from the belts alone ([`crate::marker::weigh`]).
//! 5. What blur does to the levels and past the belts is undone ([`crate::marker::blur`]).
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
    camera::PixelPoint,
    ellipse::Symmetric2,
    frame::Frame,
    marker::{
        Ring,
        belt::{BELT_PX, BeltScratch, Belts, THIN_PX, WIDE_PX, pixels_in},
        blur::{Cuts, Taken, Unblurred, Weighed, unblur},
        elliptical,
        examine::{Counted, Probe, Rules, check_boxes, check_counts, check_levels, check_shapes},
        kind::{Kind, Polarity, RATIO_LIMITS, nearest_kind},
        levels::Levels,
        outline::unevenness,
        patch::{Patch, WORD_PX},
        reject::Reject,
        spans::{Bits, Extent, Span, Spill, follow_disc, follow_ring},
        thin::Depths,
        weigh::{Area, Weights, moments},
    },
};

/// A ring is measured anew at its own threshold, eq. (3), if that is further from the first one than
/// this share of the contrast; than the second, if the threshold has cut its rim.
const RETHRESHOLD_SHARE: (f64, f64) = (0.15, 0.02);

/// Turns in which a thin ring's black level and its rims are found.
const THIN_TURNS: usize = 2;
/// Deviation of a blurred edge where none is measured, pixels.
const USUAL_BLUR_PX: f64 = 0.75;
/// Least distance of the outer rim from the frame's edge, pixels.
const EDGE_PX: f64 = 1.0;

/// Memory of measuring one ring.
#[derive(Debug)]
pub(crate) struct MeasureScratch {
    level: Level,
    patch: Patch,
    discs: Vec<Span>,
    rings: Vec<Span>,
    belts: BeltScratch,
    depths: Depths,
}

impl Default for MeasureScratch {
    fn default() -> Self {
        Self {
            level: Level::new(),
            patch: Patch::default(),
            discs: Vec::new(),
            rings: Vec::new(),
            belts: BeltScratch::new(),
            depths: Depths::default(),
        }
    }
}

/// What is known of the outer rim besides its ellipse.
#[derive(Clone, Copy, Debug)]
struct Outline {
    /// As in [`Ring`].
    unevenness: f64,
    /// Only what lies inside of the threshold's edge was weighed.
    cut: bool,
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
    let mut threshold = probe.threshold;
    let mut found = rims(simd, frame, probe, rules, scratch)?;
    let own = (0.5 * (found.0.black + found.0.white)).round().clamp(1.0, 255.0) as u8;
    let off = f64::from(own.abs_diff(threshold));
    let limit = if found.1.cut { RETHRESHOLD_SHARE.1 } else { RETHRESHOLD_SHARE.0 };
    if off > limit * (found.0.white - found.0.black) {
        // If something bridges the rims at the middle, what works is kept.
        if let Ok(better) = rims(simd, frame, &Probe { threshold: own, ..*probe }, rules, scratch) {
            (found, threshold) = (better, own);
        }
    } else {
        threshold = own;
    }
    let (Unblurred { outer, inner, black, white }, Outline { unevenness, .. }) = found;
    let (kind, outer, inner) = if kinds.is_empty() {
        let ratio = inner.mean_radius_px() / outer.mean_radius_px();
        if ratio < RATIO_LIMITS.0 || ratio > RATIO_LIMITS.1 {
            return Err(Reject::AreaRatio);
        }
        (None, outer, inner)
    } else {
        let nearest = if rules.similar { nearest_kind } else { elliptical::nearest_kind };
        let (kind, outer, inner) =
            nearest(kinds, probe.polarity, &outer, &inner).ok_or(Reject::Kind)?;
        (Some(kind), outer, inner)
    };
    let ring = Ring { kind, threshold, black, white, unevenness, ..Ring::of_rims(outer, inner) };
    Ok(match probe.polarity {
        Polarity::BlackRing => ring,
        Polarity::WhiteRing => Ring {
            threshold: 0u8.wrapping_sub(threshold),
            black: 255.0 - white,
            white: 255.0 - black,
            polarity: Polarity::WhiteRing,
            ..ring
        },
    })
}

#[simd]
fn rims<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    scratch: &mut MeasureScratch,
) -> Result<(Unblurred, Outline), Reject> {
    let MeasureScratch { patch, discs, rings, belts, depths, .. } = scratch;
    let threshold = match probe.polarity {
        Polarity::BlackRing => probe.threshold,
        Polarity::WhiteRing => 0u8.wrapping_sub(probe.threshold),
    };
    Patch::load(simd, patch, frame, probe.bounds, (threshold, probe.polarity));
    let (rows, columns) = (patch.rows(), patch.columns());
    if discs.len() < rows {
        discs.resize(rows, Span::default());
        rings.resize(rows, Span::default());
    }
    let window = patch.window;
    let center = (probe.center.0 - window.left, probe.center.1 - window.top);
    let white = Bits::new(&patch.white, patch.words, (rows, columns));
    let black = Bits::new(&patch.black, patch.words, (rows, columns));
    let disc = seeds(patch, center)
        .map(|seed| follow_disc(simd, &white, seed, discs))
        .find(|disc| disc.is_ok())
        .unwrap_or(Err(Spill::Seed));
    let disc = disc.map_err(|spill| match spill {
        Spill::Seed => Reject::NoWhite,
        Spill::Edge(_) => Reject::WhiteTooLarge,
    })?;
    let ring = follow_ring(simd, &black, (&disc, discs), rings).map_err(|spill| match spill {
        Spill::Seed => Reject::NoBlack,
        Spill::Edge(extent) if at_frame_edge(frame, patch, &extent) => Reject::FrameEdge,
        Spill::Edge(_) => Reject::BlackTooLarge,
    })?;
    let (of_disc, of_ring) = counts(patch, (&disc, discs), (&ring, rings));
    check_counts(&of_ring, &of_disc, rules)?;

    let belts = Belts::round(simd, patch, (&disc, discs), (&ring, rings), belts);
    let words = patch.words;
    let first = belts.top * words;
    let blocks = belts.disc_core.len();
    let grey = &patch.grey[first..first + blocks];
    let middle = |first: usize, end: usize| (first + end) / 2;
    let columns = &ring.columns;
    let column = middle(columns.first as usize, columns.end as usize) & !1;
    let row = middle(ring.top, ring.bottom) - belts.top;
    let levels = Levels::new(simd, grey, &belts, words, (column, row));
    let (black, white) = (levels.black.mean(), levels.disc.mean());
    let contrast = white - black;
    if contrast.is_nan() || contrast < rules.min_contrast {
        return Err(Reject::Contrast);
    }
    let margin = levels.margin();
    let cut_px = cut_px(f64::from(probe.threshold) - 0.5, black, white);
    let cut = margin.is_none() && !levels.has_near_margin();
    let (of_outer, cuts) = match margin {
        Some(_) => (
            (belts.ring_core, belts.ring_belt),
            Cuts { inside_px: belts.inside_px, outside_px: WIDE_PX },
        ),
        None if !cut => {
            ((belts.thin_core, belts.thin_belt), Cuts { inside_px: THIN_PX, outside_px: THIN_PX })
        }
        None => {
            ((belts.thin_core, belts.half_belt), Cuts { inside_px: THIN_PX, outside_px: cut_px })
        }
    };
    let around = Cuts { inside_px: belts.core_px, outside_px: belts.inside_px };
    let zones = Zones {
        grey,
        words,
        origin: (window.left + column, window.top + belts.top + row),
        middle: (column, row),
        outer: (of_outer, cuts, area_round(&ring, &belts, patch)),
        inner: ((belts.disc_core, belts.disc_belt), around, area_round(&disc, &belts, patch)),
        white: (margin.map_or(white, |margin| margin.mean()), white),
    };
    let mut outer = zones.outer(simd, black)?;
    let mut inner = zones.inner(simd, black)?;
    let of_white = Taken::new(levels.disc, belts.core_px);
    let of_margin = margin.map(|margin| Taken::new(margin, WIDE_PX));
    let mut of_black = Taken::new(levels.black, belts.black_px);
    let thin = belts.black_px < WIDE_PX;
    let mut undo = |of_black: &Taken, outer: &Weighed, inner: &Weighed| {
        if thin {
            let first = (window.left, window.top + belts.top);
            let ring = belts.whole.iter().zip(belts.white).map(|(whole, white)| whole & !white);
            depths.measure((grey, ring, words), first, (outer, inner));
        }
        let levels = (of_black, &of_white, of_margin.as_ref());
        unblur((outer, inner), levels, thin.then_some(&*depths))
    };
    let mut found = undo(&of_black, &outer, &inner);
    for _ in 0..if thin { THIN_TURNS } else { 0 } {
        of_black.level = found.black;
        (outer, inner) = (zones.outer(simd, of_black.level)?, zones.inner(simd, of_black.level)?);
        found = undo(&of_black, &outer, &inner);
    }

    check_levels(found.black, found.white, rules)?;
    check_boxes((&of_ring, &outer.shape), (&of_disc, &inner.shape), rules)?;
    check_shapes((&outer.shape, &outer.rim), (&inner.shape, &inner.rim), rules)?;
    let matrix = outer.shape.matrix_of(&outer.rim);
    check_edge(frame, outer.shape.center, &matrix)?;
    let unevenness = unevenness(simd, patch, outer.shape.center, &matrix, contrast)?;
    if margin.is_some() {
        let belts = (pixels_in(of_outer.1), pixels_in(belts.disc_belt));
        let (of_outer, of_inner) = levels.movement((&outer, &inner), belts, contrast);
        for (rim, moved) in [(&mut found.outer, of_outer), (&mut found.inner, of_inner)] {
            rim.center.u -= moved.u;
            rim.center.v -= moved.v;
        }
    }
    Ok((found, Outline { unevenness, cut }))
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

/// The pixels by which both rims are weighed.
struct Zones<'a> {
    grey: &'a [[u8; WORD_PX]],
    words: usize,
    /// The pixel that sums are counted from, in the frame and in the rows.
    origin: (usize, usize),
    middle: (usize, usize),
    /// Core and belt of each rim, where the belt ends, and what holds it.
    outer: ((&'a [u64], &'a [u64]), Cuts, Area),
    inner: ((&'a [u64], &'a [u64]), Cuts, Area),
    /// Level outside of the roundel, and of the disc.
    white: (f64, f64),
}

impl Zones<'_> {
    #[inline(always)]
    fn outer<S: Simd>(&self, simd: S, black: f64) -> Result<Weighed, Reject> {
        let weights = Weights::between(self.white.0, black);
        let sums = moments(
            simd,
            self.grey,
            self.outer.0,
            (self.words, &self.outer.2),
            self.middle,
            weights,
        );
        Weighed::new(&sums, self.origin, self.outer.1).ok_or(Reject::TooSmall)
    }

    #[inline(always)]
    fn inner<S: Simd>(&self, simd: S, black: f64) -> Result<Weighed, Reject> {
        let weights = Weights::between(black, self.white.1);
        let sums = moments(
            simd,
            self.grey,
            self.inner.0,
            (self.words, &self.inner.2),
            self.middle,
            weights,
        );
        Weighed::new(&sums, self.origin, self.inner.1).ok_or(Reject::TooSmall)
    }
}

/// How far outside of the rim the threshold cuts its blurred edge, for a usual blur.
fn cut_px(threshold: f64, black: f64, white: f64) -> f64 {
    // σ Φ⁻¹(1/2 + p), by its series.
    let p = ((threshold - black) / (white - black) - 0.5).clamp(-0.4, 0.4);
    let pi = std::f64::consts::PI;
    USUAL_BLUR_PX * (2.0 * pi).sqrt() * (p + p * p * p * pi / 3.0)
}

/// White pixels to begin the disc with: the centre if it is white. A small ring that moved may have its
/// black there; then the nearest white ones along row and column.
fn seeds(patch: &Patch, (u, v): (usize, usize)) -> impl Iterator<Item = (u32, usize)> {
    let white = |u: usize, v: usize| patch.white[v * patch.words + u / 64] >> (u % 64) & 1 == 1;
    let seeds = if white(u, v) {
        [Some((u, v)), None, None, None]
    } else {
        let left = (0..u).rev().find(|&u| white(u, v)).map(|u| (u, v));
        let right = (u + 1..patch.columns()).find(|&u| white(u, v)).map(|u| (u, v));
        let up = (0..v).rev().find(|&v| white(u, v)).map(|v| (u, v));
        let down = (v + 1..patch.rows()).find(|&v| white(u, v)).map(|v| (u, v));
        [left, right, up, down]
    };
    seeds.into_iter().flatten().map(|(u, v)| (u as u32, v))
}

/// Whether the rim lies far enough from the frame's edge to be measured.
fn check_edge(frame: &Frame, center: PixelPoint, matrix: &Symmetric2) -> Result<(), Reject> {
    let (half_u, half_v) = (matrix.uu.sqrt() + EDGE_PX, matrix.vv.sqrt() + EDGE_PX);
    let inside = center.u >= half_u
        && center.v >= half_v
        && center.u + half_u <= (frame.width() - 1) as f64
        && center.v + half_v <= (frame.height() - 1) as f64;
    if inside { Ok(()) } else { Err(Reject::FrameEdge) }
}

/// Whether a segment has reached an edge of the patch that is one of the frame's.
fn at_frame_edge(frame: &Frame, patch: &Patch, extent: &Extent) -> bool {
    let window = &patch.window;
    (extent.columns.first == 0 && window.left == 0)
        || (extent.columns.end as usize == patch.columns() && window.right == frame.width())
        || (extent.top == 0 && window.top == 0)
        || (extent.bottom == patch.rows() && window.bottom == frame.height())
}

/// Pixels of the disc and of the black round it.
#[inline(always)]
fn counts(patch: &Patch, disc: (&Extent, &[Span]), ring: (&Extent, &[Span])) -> (Counted, Counted) {
    (count(patch.words, disc, &patch.white), count(patch.words, ring, &patch.black))
}

#[inline(always)]
fn count(words: usize, (extent, spans): (&Extent, &[Span]), bits: &[u64]) -> Counted {
    let spans = &spans[extent.top..extent.bottom];
    let bits = &bits[extent.top * words..extent.bottom * words];
    let mut pixels = 0;
    if words == 1 {
        for (bits, span) in bits.iter().zip(spans) {
            pixels += (bits & span.bits(0)).count_ones();
        }
    } else {
        for (row, span) in bits.chunks_exact(words).zip(spans) {
            for (word, bits) in row.iter().enumerate() {
                pixels += (bits & span.bits(word)).count_ones();
            }
        }
    }
    Counted::new(pixels, extent)
}
