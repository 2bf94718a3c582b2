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
    ellipse::{Ellipse, Moments},
    frame::Frame,
    marker::{
        paper_edge::NO_MARGIN_PX,
        reject::Reject,
        ring::{
            checks::{are_levels, check_disc_box, check_ring_box, check_shapes, is_inside},
            pixels::{
                edge_band::{EdgeBands, THIN_PX, WIDE_PX, pixels_in},
                ellipse_mask::Area,
                patch::{Patch, WORD_PX},
                segments::SegmentSize,
            },
            probe::{Probe, Rules},
            subpixel::{
                blur::{SharpRims, remove_blur},
                levels::{LevelSamples, Levels, PartSums},
                moments::{BandPixels, BandWeights, moments},
                thin_ring::{RimDistances, ThinPixels},
                unevenness::{RimPixels, unevenness},
            },
            weighed_rim::{Cuts, WeighedRim},
        },
    },
};

/// Iterations of a thin ring's black level and rims.
const THIN_TURNS: usize = 2;
/// Deviation of a blurred edge where none is measured, pixels.
const USUAL_BLUR_PX: f64 = 0.75;

/// Both rims without blur, and their quality.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RefinedRims {
    pub outer: Ellipse,
    pub inner: Ellipse,
    pub black: f64,
    pub white: f64,
    /// As in [`crate::marker::Ring`].
    pub unevenness: f64,
    /// Both rims have the same shape.
    pub is_similar: bool,
    /// Only the part inside of the threshold's edge was weighed.
    pub is_cut: bool,
    /// As in [`crate::marker::Ring`].
    pub margin_px: f64,
}

/// Error of each harmonic of the outer rim with a margin that is narrow, pixels, its increase by what is missing of white
/// two or three pixels beyond the rim; from rendered rings.
const MARGIN_PX: f64 = 0.01;
const DIM_MARGIN_PX: f64 = 0.07;

/// Bands, and their position in a patch.
pub(crate) struct BandLayout<'a> {
    pub patch: &'a Patch,
    pub bands: EdgeBands<'a>,
    /// A pixel in the middle, its column even, in the bands' rows.
    pub middle: (usize, usize),
    pub outer: Area,
    pub inner: Area,
    /// If segments were filled.
    pub sizes: Option<SegmentSizes<'a>>,
}

/// Sizes of the black segment and of the disc.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SegmentSizes<'a> {
    pub ring: &'a SegmentSize,
    pub disc: &'a SegmentSize,
}

/// Both rims by grey levels, with all tests.
#[simd]
pub(crate) fn refine_rims<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    layout: &BandLayout,
    distances: &mut RimDistances,
) -> Result<RefinedRims, Reject> {
    let BandLayout { patch, bands, middle, .. } = layout;
    let (words, window) = (patch.words, &patch.window);
    let first = bands.top * words;
    let grey = &patch.grey[first..first + bands.disc_core.len()];
    let parts = PartSums::new(simd, grey, bands, words, *middle);
    let levels = Levels::new(&parts, bands.core_px, bands.black_px);
    let (black, white) = (levels.black.level, levels.white.level);
    let contrast = white - black;
    if contrast.is_nan() || contrast < rules.min_contrast {
        return Err(Reject::Contrast);
    }
    let margin = levels.is_margin.then_some(levels.margin);
    // A narrow margin needs the bands of segments.
    if margin.is_none() && layout.sizes.is_none() {
        return Err(Reject::Contrast);
    }
    let is_cut = margin.is_none() && !levels.has_near_margin();
    let (core, band, inside_px, outside_px) = if margin.is_some() {
        (bands.ring_core, bands.ring_band, bands.inside_px, WIDE_PX)
    } else if is_cut {
        let cut_px = cut_px(f64::from(probe.threshold) - 0.5, black, white);
        (bands.thin_core, bands.half_band, THIN_PX, cut_px)
    } else {
        (bands.thin_core, bands.thin_band, THIN_PX, THIN_PX)
    };
    let regions = RimRegions {
        grey,
        words,
        origin: (window.left + middle.0, window.top + bands.top + middle.1),
        middle: *middle,
        outer: RimRegion { core, band, area: layout.outer, cuts: Cuts { inside_px, outside_px } },
        inner: RimRegion {
            core: bands.disc_core,
            band: bands.disc_band,
            area: layout.inner,
            cuts: Cuts { inside_px: bands.core_px, outside_px: bands.inside_px },
        },
        margin: margin.map_or(white, |margin| margin.level),
        white,
    };
    let mut outer = regions.outer(simd, black)?;
    let mut inner = regions.inner(simd, black)?;
    let mut samples = LevelSamples { black: levels.black, white: levels.white, margin };
    let is_thin = bands.black_px < WIDE_PX;
    let mut found;
    let mut turn = 0;
    loop {
        if is_thin {
            let pixels = ThinPixels {
                grey,
                whole: bands.whole,
                white: bands.white,
                words,
                first: (window.left, window.top + bands.top),
            };
            let (outer, inner) = (outer.rim_ellipse(), inner.rim_ellipse());
            RimDistances::measure(simd, distances, &pixels, &outer, &inner);
        }
        let thin = is_thin.then_some(&*distances);
        found = remove_blur(simd, &outer, &inner, &samples, thin);
        if !is_thin || turn == THIN_TURNS {
            break;
        }
        turn += 1;
        samples.black.level = found.black;
        (outer, inner) = (regions.outer(simd, found.black)?, regions.inner(simd, found.black)?);
    }

    if !are_levels(found.black, found.white, rules) {
        return Err(Reject::Contrast);
    }
    if let Some(sizes) = layout.sizes {
        check_ring_box(sizes.ring, &outer, rules)?;
        check_disc_box(sizes.disc, &inner)?;
    }
    let is_similar = check_shapes(&outer, &inner, rules)?;
    if !is_inside((frame.width(), frame.height()), &outer) {
        return Err(Reject::FrameEdge);
    }
    let center = outer.rim.at(0).center;
    let unevenness = unevenness(simd, &RimPixels::of(patch), center, &outer.matrix(), contrast)?;
    if margin.is_some() {
        let (outer_pixels, inner_pixels) = (pixels_in(band), pixels_in(bands.disc_band));
        let moved =
            levels.movement((&outer, f64::from(outer_pixels)), (&inner, f64::from(inner_pixels)));
        for (rim, (du, dv)) in [&mut found.outer, &mut found.inner].into_iter().zip(moved) {
            rim.center.u -= du;
            rim.center.v -= dv;
        }
    }
    let SharpRims { outer, inner, black, white } = found;
    let margin_px = match (margin, is_cut) {
        (Some(_), _) => 0.0,
        (None, true) => NO_MARGIN_PX,
        (None, false) => MARGIN_PX + DIM_MARGIN_PX * (1.0 - levels.near_share()).max(0.0),
    };
    Ok(RefinedRims { outer, inner, black, white, unevenness, is_similar, is_cut, margin_px })
}

/// The pixels that weigh in for both rims.
struct RimRegions<'a> {
    grey: &'a [[u8; WORD_PX]],
    words: usize,
    /// The pixel that sums are relative to, in the frame and in the rows.
    origin: (usize, usize),
    middle: (usize, usize),
    outer: RimRegion<'a>,
    inner: RimRegion<'a>,
    /// Levels of the margin and of the disc.
    margin: f64,
    white: f64,
}

/// The pixels that weigh in for one rim.
struct RimRegion<'a> {
    core: &'a [u64],
    band: &'a [u64],
    /// Contains both.
    area: Area,
    cuts: Cuts,
}

impl RimRegions<'_> {
    #[inline(always)]
    fn outer<S: Simd>(&self, simd: S, black: f64) -> Result<WeighedRim, Reject> {
        self.weigh(simd, &self.outer, BandWeights::between(self.margin, black))
    }

    #[inline(always)]
    fn inner<S: Simd>(&self, simd: S, black: f64) -> Result<WeighedRim, Reject> {
        self.weigh(simd, &self.inner, BandWeights::between(black, self.white))
    }

    #[inline(always)]
    fn weigh<S: Simd>(
        &self,
        simd: S,
        region: &RimRegion,
        weights: BandWeights,
    ) -> Result<WeighedRim, Reject> {
        let pixels = BandPixels {
            grey: self.grey,
            core: region.core,
            band: region.band,
            words: self.words,
            area: region.area,
        };
        let Moments { n, u, v, uu, uv, vv } = moments(simd, &pixels, self.middle, weights);
        let origin = (self.origin.0 as f64, self.origin.1 as f64);
        let weighed = WeighedRim::new([n, v, vv, u, uv, uu], origin, region.cuts);
        if weighed.valid { Ok(weighed) } else { Err(Reject::TooSmall) }
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
