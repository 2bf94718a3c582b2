//! Refines both rims by the grey levels of their edge bands, and tests them.
//!
//! | module | content |
//! | --- | --- |
//! | `levels` | levels of disc, black and margin; lighting gradient |
//! | `moments` | sums over pixels, weighted by grey levels |
//! | `blur` | removal of the blur |
//! | `thin_ring` | black level of a ring thinner than the blur |
//! | `unevenness` | deviation of the levels along the outer rim |
//!
//! Input: edge bands, from segments or predicted rims. Output: both rims without blur, and the quality of the outer one;
//! steps 4 and 5 of [`crate::marker::ring::measure`].

pub(crate) mod blur;
pub(crate) mod levels;
pub(crate) mod moments;
pub(crate) mod thin_ring;
pub(crate) mod unevenness;

use fearless_simd::Simd;
use fearless_simd_macros::simd;

use crate::{
    camera::PixelPoint,
    ellipse::Symmetric2,
    frame::Frame,
    marker::{
        reject::Reject,
        ring::{
            checks::{check_boxes, check_levels, check_shapes},
            pixels::{
                edge_band::{EdgeBands, THIN_PX, WIDE_PX, pixels_in},
                ellipse_mask::Area,
                patch::{Patch, WORD_PX},
                segments::SegmentSize,
            },
            probe::{Probe, Rules},
            subpixel::{
                blur::{Cuts, LevelSample, SharpRims, WeighedRim, remove_blur},
                levels::Levels,
                moments::{BandWeights, moments},
                thin_ring::RimDistances,
                unevenness::{Pixels, unevenness},
            },
        },
    },
};

/// Iterations of a thin ring's black level and rims.
const THIN_TURNS: usize = 2;
/// Deviation of a blurred edge where none is measured, pixels.
const USUAL_BLUR_PX: f64 = 0.75;
/// Smallest distance of the outer rim from the frame's edge, pixels.
pub(crate) const EDGE_PX: f64 = 1.0;

/// Properties of the outer rim besides its ellipse.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RimQuality {
    /// As in [`crate::marker::Ring`].
    pub unevenness: f64,
    /// Both rims have the same shape.
    pub similar: bool,
    /// Only the part inside of the threshold's edge was weighed.
    pub cut: bool,
}

/// Bands, and their position.
pub(crate) struct BandLayout<'a> {
    pub bands: EdgeBands<'a>,
    /// A pixel in the middle, its column even, in the bands' rows.
    pub middle: (usize, usize),
    pub outer: Area,
    pub inner: Area,
    /// Sizes of black and disc, if segments were filled.
    pub sizes: Option<(&'a SegmentSize, &'a SegmentSize)>,
}

/// Both rims by grey levels, with all tests.
#[simd]
pub(crate) fn refine_rims<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    (patch, layout): (&Patch, &BandLayout),
    distances: &mut RimDistances,
) -> Result<(SharpRims, RimQuality), Reject> {
    let BandLayout { bands, middle, .. } = layout;
    let (words, window) = (patch.words, &patch.window);
    let first = bands.top * words;
    let grey = &patch.grey[first..first + bands.disc_core.len()];
    let levels = Levels::new(simd, grey, bands, words, *middle);
    let (black, white) = (levels.black.mean(), levels.disc.mean());
    let contrast = white - black;
    if contrast.is_nan() || contrast < rules.min_contrast {
        return Err(Reject::Contrast);
    }
    let margin = levels.margin();
    // A narrow margin needs the bands of segments.
    if margin.is_none() && layout.sizes.is_none() {
        return Err(Reject::Contrast);
    }
    let cut_px = cut_px(f64::from(probe.threshold) - 0.5, black, white);
    let cut = margin.is_none() && !levels.has_near_margin();
    let (of_outer, cuts) = match margin {
        Some(_) => (
            (bands.ring_core, bands.ring_band),
            Cuts { inside_px: bands.inside_px, outside_px: WIDE_PX },
        ),
        None if !cut => {
            ((bands.thin_core, bands.thin_band), Cuts { inside_px: THIN_PX, outside_px: THIN_PX })
        }
        None => {
            ((bands.thin_core, bands.half_band), Cuts { inside_px: THIN_PX, outside_px: cut_px })
        }
    };
    let around = Cuts { inside_px: bands.core_px, outside_px: bands.inside_px };
    let regions = RimRegions {
        grey,
        words,
        origin: (window.left + middle.0, window.top + bands.top + middle.1),
        middle: *middle,
        outer: (of_outer, cuts, layout.outer),
        inner: ((bands.disc_core, bands.disc_band), around, layout.inner),
        white: (margin.map_or(white, |margin| margin.mean()), white),
    };
    let mut outer = regions.outer(simd, black)?;
    let mut inner = regions.inner(simd, black)?;
    let of_white = LevelSample::new(levels.disc, bands.core_px);
    let of_margin = margin.map(|margin| LevelSample::new(margin, WIDE_PX));
    let mut of_black = LevelSample::new(levels.black, bands.black_px);
    let thin = bands.black_px < WIDE_PX;
    let origin = (window.left, window.top + bands.top);
    let mut found;
    let mut turn = 0;
    loop {
        if thin {
            let sets = (grey, bands.whole, bands.white);
            RimDistances::measure(
                simd,
                distances,
                sets,
                words,
                origin,
                (&outer.rim_ellipse(), &inner.rim_ellipse()),
            );
        }
        let levels = (&of_black, &of_white, of_margin.as_ref());
        found = remove_blur(simd, (&outer, &inner), levels, thin.then_some(&*distances));
        if !thin || turn == THIN_TURNS {
            break;
        }
        turn += 1;
        of_black.level = found.black;
        (outer, inner) =
            (regions.outer(simd, of_black.level)?, regions.inner(simd, of_black.level)?);
    }

    check_levels(found.black, found.white, rules)?;
    if let Some((ring_size, disc_size)) = layout.sizes {
        check_boxes((ring_size, &outer.shape), (disc_size, &inner.shape), rules)?;
    }
    let similar = check_shapes((&outer.shape, &outer.rim), (&inner.shape, &inner.rim), rules)?;
    let matrix = outer.shape.matrix_of(&outer.rim);
    check_edge(frame, outer.shape.center, &matrix)?;
    let pixels = Pixels::of(patch);
    let unevenness = unevenness(simd, &pixels, outer.shape.center, &matrix, contrast)?;
    if margin.is_some() {
        let bands = (pixels_in(of_outer.1), pixels_in(bands.disc_band));
        let (of_outer, of_inner) = levels.movement((&outer, &inner), bands, contrast);
        for (rim, moved) in [(&mut found.outer, of_outer), (&mut found.inner, of_inner)] {
            rim.center.u -= moved.u;
            rim.center.v -= moved.v;
        }
    }
    Ok((found, RimQuality { unevenness, similar, cut }))
}

/// The pixels that weigh in for both rims.
struct RimRegions<'a> {
    grey: &'a [[u8; WORD_PX]],
    words: usize,
    /// The pixel that sums are relative to, in the frame and in the rows.
    origin: (usize, usize),
    middle: (usize, usize),
    /// Core and band of each rim, where the band ends, and its area.
    outer: ((&'a [u64], &'a [u64]), Cuts, Area),
    inner: ((&'a [u64], &'a [u64]), Cuts, Area),
    /// Levels of the margin and of the disc.
    white: (f64, f64),
}

impl RimRegions<'_> {
    #[inline(always)]
    fn outer<S: Simd>(&self, simd: S, black: f64) -> Result<WeighedRim, Reject> {
        let weights = BandWeights::between(self.white.0, black);
        let sums = moments(
            simd,
            self.grey,
            self.outer.0,
            (self.words, &self.outer.2),
            self.middle,
            weights,
        );
        WeighedRim::new(&sums, self.origin, self.outer.1).ok_or(Reject::TooSmall)
    }

    #[inline(always)]
    fn inner<S: Simd>(&self, simd: S, black: f64) -> Result<WeighedRim, Reject> {
        let weights = BandWeights::between(black, self.white.1);
        let sums = moments(
            simd,
            self.grey,
            self.inner.0,
            (self.words, &self.inner.2),
            self.middle,
            weights,
        );
        WeighedRim::new(&sums, self.origin, self.inner.1).ok_or(Reject::TooSmall)
    }
}

/// Distance of the threshold's edge outside of the rim, for a usual blur.
#[inline(always)]
fn cut_px(threshold: f64, black: f64, white: f64) -> f64 {
    // σ Φ⁻¹(1/2 + p), by its series.
    let p = ((threshold - black) / (white - black) - 0.5).clamp(-0.4, 0.4);
    let pi = std::f64::consts::PI;
    USUAL_BLUR_PX * (2.0 * pi).sqrt() * (p + p * p * p * pi / 3.0)
}

/// Whether the rim is far enough from the frame's edge.
#[inline(always)]
fn check_edge(frame: &Frame, center: PixelPoint, matrix: &Symmetric2) -> Result<(), Reject> {
    let (half_u, half_v) = (matrix.uu.sqrt() + EDGE_PX, matrix.vv.sqrt() + EDGE_PX);
    let inside = center.u >= half_u
        && center.v >= half_v
        && center.u + half_u <= (frame.width() - 1) as f64
        && center.v + half_v <= (frame.height() - 1) as f64;
    if inside { Ok(()) } else { Err(Reject::FrameEdge) }
}
