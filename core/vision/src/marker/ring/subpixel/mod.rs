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
    ellipse::Moments,
    frame::Frame,
    marker::{
        reject::Reject,
        ring::{
            checks::{are_levels, check_boxes, check_shapes, is_inside},
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
                moments::{BandWeights, moments},
                thin_ring::RimDistances,
                unevenness::{Pixels, unevenness},
            },
            weighed_rim::{Cuts, WeighedRim},
        },
    },
};

/// Iterations of a thin ring's black level and rims.
const THIN_TURNS: usize = 2;
/// Deviation of a blurred edge where none is measured, pixels.
const USUAL_BLUR_PX: f64 = 0.75;
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
        white: (margin.map_or(white, |margin| margin.level), white),
    };
    let mut outer = regions.outer(simd, black)?;
    let mut inner = regions.inner(simd, black)?;
    let mut samples = LevelSamples { black: levels.black, white: levels.white, margin };
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
        found = remove_blur(simd, (&outer, &inner), &samples, thin.then_some(&*distances));
        if !thin || turn == THIN_TURNS {
            break;
        }
        turn += 1;
        samples.black.level = found.black;
        (outer, inner) = (regions.outer(simd, found.black)?, regions.inner(simd, found.black)?);
    }

    if !are_levels(found.black, found.white, rules) {
        return Err(Reject::Contrast);
    }
    if let Some((ring_size, disc_size)) = layout.sizes {
        check_boxes((ring_size, &outer), (disc_size, &inner), rules)?;
    }
    let similar = check_shapes(&outer, &inner, rules)?;
    if !is_inside((frame.width(), frame.height()), &outer) {
        return Err(Reject::FrameEdge);
    }
    let center = outer.rim.at(0).center;
    let unevenness = unevenness(simd, &Pixels::of(patch), center, &outer.matrix(), contrast)?;
    if margin.is_some() {
        let pixels = [of_outer.1, bands.disc_band].map(|band| f64::from(pixels_in(band)));
        let moved = levels.movement((&outer, &inner), (pixels[0], pixels[1]));
        for (rim, (du, dv)) in [&mut found.outer, &mut found.inner].into_iter().zip(moved) {
            rim.center.u -= du;
            rim.center.v -= dv;
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
        self.weigh(simd, &self.outer, BandWeights::between(self.white.0, black))
    }

    #[inline(always)]
    fn inner<S: Simd>(&self, simd: S, black: f64) -> Result<WeighedRim, Reject> {
        self.weigh(simd, &self.inner, BandWeights::between(black, self.white.1))
    }

    #[inline(always)]
    fn weigh<S: Simd>(
        &self,
        simd: S,
        (sets, cuts, area): &((&[u64], &[u64]), Cuts, Area),
        weights: BandWeights,
    ) -> Result<WeighedRim, Reject> {
        let Moments { n, u, v, uu, uv, vv } =
            moments(simd, self.grey, *sets, (self.words, area), self.middle, weights);
        let origin = (self.origin.0 as f64, self.origin.1 as f64);
        let weighed = WeighedRim::new([n, v, vv, u, uv, uu], origin, *cuts);
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
