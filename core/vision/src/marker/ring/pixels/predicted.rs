//! Edge bands of a tracked ring, from its predicted rims.
//!
//! A ring seldom changes its shape from one frame to the next, so its rims need not be traced: the
//! bands of [`crate::marker::ring::pixels::edge_band`] follow from the two ellipses of the previous frame and their
//! displacement. The white disc gives the latter: the centroid of the white pixels within the ellipse halfway between the
//! rims is its centre to a tenth of a pixel (rms; a disc of 12 px), as long as it stays in the black. After a large
//! displacement it is computed twice, since only a part of the disc lies in that ellipse at first.
//!
//! The prediction is verified: every pixel between the bands must be on its side of the threshold,
//! black in the ring, white in the disc and in the margin beside the band, which is stricter than
//! [`crate::marker::ring::pixels::segment_fill`] (not even a narrow bridge is possible). And the measured rims must lie in
//! the middle of their bands ([`PredictedRims::is_near`]). A ring that fails is measured by its segments.

use fearless_simd::{Simd, prelude::*};
use fearless_simd_macros::simd;

use crate::{
    ellipse::Ellipse,
    marker::ring::pixels::{
        edge_band::{BandScratch, CROSS_PX, EdgeBands, MIN_BLACK, MIN_WHITE, WIDE_PX, pixels_in},
        ellipse_mask::{Area, FilledEllipse, LANES, PatchEllipse, RimEllipse, RowBits},
        patch::{Patch, WORD_PX},
    },
};

/// Largest deviation from the predicted rims, pixels, before their bands are drawn again; with a
/// blur of 0.7 px, a band then still contains all but two thousandths of a pixel of its rim's
/// light.
const OFF_PX: f64 = 0.5;
/// Smallest width of the black at its narrowest: two bands, and a gap.
const MIN_RING_PX: f64 = 2.0 * WIDE_PX + 0.75;
/// Smallest shorter semiaxis of the disc.
const MIN_DISC_PX: f64 = WIDE_PX + 1.0;

#[derive(Clone, Copy, Debug)]
pub(crate) struct PredictedRims {
    pub outer: RimEllipse,
    pub inner: RimEllipse,
}

/// Whether a band about `rim` contains the one found.
fn is_near(rim: &Ellipse, found: &Ellipse) -> bool {
    let (du, dv) = (found.center.u - rim.center.u, found.center.v - rim.center.v);
    let longer_px = (found.semi_major_px - rim.semi_major_px).abs();
    let wider_px = (found.semi_minor_px - rim.semi_minor_px).abs();
    let turn_rad = (found.angle_rad - rim.angle_rad).abs();
    let turn_rad = turn_rad.min(std::f64::consts::PI - turn_rad);
    let turned_px = turn_rad * (found.semi_major_px - found.semi_minor_px);
    du * du + dv * dv <= OFF_PX * OFF_PX && longer_px + wider_px + turned_px <= 2.0 * OFF_PX
}

impl PredictedRims {
    /// Rims without displacement.
    pub fn new(outer: &Ellipse, inner: &Ellipse) -> Self {
        Self { outer: RimEllipse::new(outer), inner: RimEllipse::new(inner) }
    }

    /// These rims, displaced.
    pub fn moved(mut self, du: f64, dv: f64) -> Self {
        for rim in [&mut self.outer, &mut self.inner] {
            rim.ellipse.center.u += du;
            rim.ellipse.center.v += dv;
        }
        self
    }

    /// Whether bands about these rims contain the rims found.
    pub fn is_near(&self, outer: &Ellipse, inner: &Ellipse) -> bool {
        is_near(&self.outer.ellipse, outer) && is_near(&self.inner.ellipse, inner)
    }
}

/// The bands of predicted rims.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PredictedBands<'a> {
    pub bands: EdgeBands<'a>,
    /// Areas of both rims' bands, in the bands' rows.
    pub outer: Area,
    pub inner: Area,
    /// A pixel in the middle, its column even, in the bands' rows.
    pub middle: (usize, usize),
}

const PLANES: usize = 7;

/// The ellipses that bound the bands, from the inside out: the disc's, the ring's, and those of the
/// margin.
#[inline(always)]
pub(crate) fn band_ellipses(outer: &PatchEllipse, inner: &PatchEllipse) -> [FilledEllipse; 6] {
    [
        inner.grown(-WIDE_PX),
        inner.grown(WIDE_PX),
        outer.grown(-WIDE_PX),
        outer.grown(WIDE_PX),
        outer.grown(WIDE_PX + CROSS_PX),
        outer.grown(2.0 * WIDE_PX),
    ]
}

/// The bands of predicted rims, moved to the disc found. `None` if they extend beyond the patch, if
/// the black is too narrow for them, or if pixels between them have the wrong colour.
#[simd]
pub(crate) fn bands_about<'a, S: Simd>(
    simd: S,
    patch: &Patch,
    predicted: &PredictedRims,
    scratch: &'a mut BandScratch,
) -> Option<PredictedBands<'a>> {
    let (outer, inner) =
        (PatchEllipse::new(&predicted.outer, patch), PatchEllipse::new(&predicted.inner, patch));
    let words = patch.words;
    let ellipses = band_ellipses(&outer, &inner);
    let (top, bottom) = ellipses[5].rows(patch.rows())?;
    ellipses[5].area(patch, top)?;
    // Rows are drawn in groups of sixteen; the last ones may be unused.
    let plane_length = (bottom - top).next_multiple_of(LANES) * words;
    if scratch.len() < PLANES * plane_length {
        scratch.resize(PLANES * plane_length, 0);
    }
    let mut planes = scratch.chunks_exact_mut(plane_length);
    let mut planes: [&mut [u64]; PLANES] =
        std::array::from_fn(|_| planes.next().expect("the scratch holds all planes"));
    // The ellipses lie within the outermost one, which does not reach the patch's edge.
    let is_only = words == 1;
    let mut wrong = RowBits::none(simd);
    for row in (0..bottom - top).step_by(LANES) {
        // Without closures over vectors, which might not be inlined.
        let (first, columns) = (top + row, words * WORD_PX);
        let core = ellipses[0].row_spans(simd, first, columns);
        let disc = ellipses[1].row_spans(simd, first, columns);
        let ring = ellipses[2].row_spans(simd, first, columns);
        let whole = ellipses[3].row_spans(simd, first, columns);
        let beside = ellipses[4].row_spans(simd, first, columns);
        let beyond = ellipses[5].row_spans(simd, first, columns);
        for word in 0..words {
            let (core, disc) = (core.bits(simd, word, is_only), disc.bits(simd, word, is_only));
            let (ring, whole) = (ring.bits(simd, word, is_only), whole.bits(simd, word, is_only));
            let (beside, beyond) =
                (beside.bits(simd, word, is_only), beyond.bits(simd, word, is_only));
            let white = RowBits::load(simd, &patch.white, ((top + row) * words + word, words));
            let (black, near) = (ring.without(disc), beside.without(whole));
            wrong = wrong
                .with(core.with(near).without(white))
                .with(black.within(white))
                .with(disc.without(ring));
            let at = (row * words + word, words);
            let [disc_core, disc_band, ring_core, ring_band, between, margin, far] = &mut planes;
            core.store(disc_core, at);
            disc.without(core).store(disc_band, at);
            ring.store(ring_core, at);
            whole.without(ring).store(ring_band, at);
            black.store(between, at);
            near.store(margin, at);
            beyond.without(beside).store(far, at);
        }
    }
    let length = (bottom - top) * words;
    let [disc_core, disc_band, ring_core, ring_band, black, near, far] =
        planes.map(|plane| &plane[..length]);
    if wrong.any() || pixels_in(disc_core) < MIN_WHITE || pixels_in(black) < MIN_BLACK {
        return None;
    }
    Some(PredictedBands {
        outer: ellipses[3].area(patch, top)?,
        inner: ellipses[1].area(patch, top)?,
        middle: (outer.u as usize & !1, outer.v as usize - top),
        bands: EdgeBands {
            top,
            white: &[],
            whole: &[],
            disc_core,
            disc_band,
            ring_core,
            ring_band,
            thin_core: &[],
            thin_band: &[],
            half_band: &[],
            black,
            near,
            far,
            core_px: WIDE_PX,
            inside_px: WIDE_PX,
            black_px: WIDE_PX,
        },
    })
}

/// Displacement of the disc from its prediction, pixels. `None` if the disc is not visible, or the
/// ring is too thin.
#[simd]
pub(crate) fn disc_motion<S: Simd>(
    simd: S,
    patch: &Patch,
    predicted: &PredictedRims,
) -> Option<(f64, f64)> {
    let ring_px = predicted.outer.ellipse.semi_minor_px - predicted.inner.ellipse.semi_minor_px;
    if ring_px < MIN_RING_PX || predicted.inner.ellipse.semi_minor_px < MIN_DISC_PX {
        return None;
    }
    let half_px = 0.5 * ring_px;
    let mut rim = PatchEllipse::new(&predicted.inner, patch);
    let (from_u, from_v) = (rim.u, rim.v);
    for _ in 0..2 {
        let (u, v) = white_centroid(simd, patch, &rim.grown(half_px))?;
        let (du, dv) = (u - rim.u, v - rim.v);
        (rim.u, rim.v) = (u, v);
        // Half the width of the black, on average, separated the ellipse from the disc.
        if du * du + dv * dv < 0.5 * half_px * half_px {
            break;
        }
    }
    Some((rim.u - from_u, rim.v - from_v))
}

/// Centroid of the white pixels in an ellipse, assuming one run per row.
#[simd]
fn white_centroid<S: Simd>(simd: S, patch: &Patch, ellipse: &FilledEllipse) -> Option<(f64, f64)> {
    let words = patch.words;
    let (top, bottom) = ellipse.rows(patch.rows())?;
    let is_only = words == 1 && ellipse.area(patch, top).is_some();
    let (mut pixels, mut twice_u, mut sum_v) = (0u32, 0u32, 0u32);
    for row in (top..bottom).step_by(LANES) {
        let row_spans = ellipse.row_spans(simd, row, words * WORD_PX);
        for word in 0..words {
            let white = RowBits::load(simd, &patch.white, (row * words + word, words));
            let RowBits(a, b) = row_spans.bits(simd, word, is_only).within(white);
            let mut rows = [0; LANES];
            a.store_slice(&mut rows[..8]);
            b.store_slice(&mut rows[8..]);
            for (lane, bits) in rows.into_iter().enumerate() {
                let count = bits.count_ones();
                // The middle of a run is that of its ends; an empty row counts zero.
                let ends = bits.trailing_zeros() + 63 - bits.leading_zeros().min(63);
                pixels += count;
                twice_u += count * (ends + 2 * (word * WORD_PX) as u32);
                sum_v += count * (row + lane) as u32;
            }
        }
    }
    let per = 1.0 / f64::from(pixels);
    (pixels >= MIN_WHITE).then(|| (0.5 * f64::from(twice_u) * per, f64::from(sum_v) * per))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        camera::PixelPoint,
        frame::{Frame, Window},
        marker::{kind::Polarity, ring::pixels::patch::Threshold},
    };
    use fearless_simd::{Level, dispatch};
    use proptest::prelude::*;

    const SIDE: usize = 150;

    fn ring(u: f64, v: f64, (major, flat, angle_rad): (f64, f64, f64)) -> PredictedRims {
        let rim = |semi_major_px: f64| Ellipse {
            center: PixelPoint { u, v },
            semi_major_px,
            semi_minor_px: semi_major_px * flat,
            angle_rad,
        };
        PredictedRims::new(&rim(major), &rim(0.4 * major))
    }

    /// A picture of the ring, and a window of `columns` columns around it.
    fn patch(ring: &PredictedRims, columns: usize) -> Patch {
        let inside = |rim: &RimEllipse, u: usize, v: usize| {
            rim.ellipse.contains(PixelPoint { u: u as f64, v: v as f64 })
        };
        let pixel = |at: usize| {
            let (u, v) = (at % SIDE, at / SIDE);
            let is_black = inside(&ring.outer, u, v) && !inside(&ring.inner, u, v);
            if is_black { 40u8 } else { 200 }
        };
        let pixels: Vec<u8> = (0..SIDE * SIDE).map(pixel).collect();
        let frame = Frame::new(&pixels, SIDE, SIDE, SIDE).unwrap();
        let left = (ring.outer.ellipse.center.u as usize).saturating_sub(columns / 2);
        let window = Window { left, top: 5, right: (left + columns).min(SIDE), bottom: 145 };
        let mut patch = Patch::default();
        let with = Threshold { level: 120, polarity: Polarity::BlackRing };
        dispatch!(Level::new(), simd => Patch::load(simd, &mut patch, &frame, window, with));
        patch
    }

    fn bands<'a>(
        patch: &Patch,
        predicted: &PredictedRims,
        scratch: &'a mut BandScratch,
    ) -> Option<PredictedBands<'a>> {
        dispatch!(Level::new(), simd => bands_about(simd, patch, predicted, scratch))
    }

    proptest! {
        #[test]
        fn bands_are_bounded_by_grown_and_shrunk_ellipses(
            u in 60.0..90.0f64,
            v in 60.0..90.0f64,
            major in 14.0..40.0f64,
            flat in 0.75..1.0f64,
            angle_rad in -1.5..1.5f64,
        ) {
            let predicted = ring(u, v, (major, flat, angle_rad));
            let patch = patch(&predicted, if major < 24.0 { 64 } else { 100 });
            let mut scratch = BandScratch::new();
            let found = bands(&patch, &predicted, &mut scratch).unwrap();
            let EdgeBands { top, disc_core, disc_band, ring_core, ring_band, black, near, far, .. } =
                found.bands;
            let (outer, inner) = (predicted.outer.ellipse, predicted.inner.ellipse);
            let edges = [
                inner.grown(-WIDE_PX),
                inner.grown(WIDE_PX),
                outer.grown(-WIDE_PX),
                outer.grown(WIDE_PX),
                outer.grown(WIDE_PX + CROSS_PX),
                outer.grown(2.0 * WIDE_PX),
            ];
            for at in 0..disc_core.len() * WORD_PX {
                let (row, column) = (at / (WORD_PX * patch.words), at % (WORD_PX * patch.words));
                let place = PixelPoint {
                    u: (patch.window.left + column) as f64,
                    v: (patch.window.top + top + row) as f64,
                };
                // Either result is right on an edge itself.
                let on_edge = |e: &Ellipse| e.grown(1e-4).contains(place) != e.grown(-1e-4).contains(place);
                if edges.iter().any(on_edge) {
                    continue;
                }
                let [core, disc, within, whole, beside, beyond] = edges.map(|e| e.contains(place));
                let ours = [disc_core, disc_band, ring_core, ring_band, black, near, far]
                    .map(|set| set[at / WORD_PX] >> (at % WORD_PX) & 1 == 1);
                let plain = [
                    core,
                    disc && !core,
                    within,
                    whole && !within,
                    within && !disc,
                    beside && !whole,
                    beyond && !beside,
                ];
                prop_assert_eq!(ours, plain, "{:?}", place);
                for area in [(&found.outer, whole), (&found.inner, disc)] {
                    let Area { rows, columns } = area.0;
                    let held = (rows.0..rows.1).contains(&row) && (columns.0..columns.1).contains(&column);
                    prop_assert!(held || !area.1);
                }
            }
        }

        #[test]
        fn the_disc_gives_the_displacement_of_the_ring(
            // Further away the disc leaves the ellipse, and the ring is left to its segments.
            away_px in 0.0..4.0f64,
            towards_rad in -3.2..3.2f64,
            flat in 0.8..1.0f64,
            angle_rad in -1.5..1.5f64,
        ) {
            let (du, dv) = (away_px * towards_rad.cos(), away_px * towards_rad.sin());
            let there = ring(72.3 + du, 75.6 + dv, (15.0, flat, angle_rad));
            let predicted = ring(72.3, 75.6, (15.0, flat, angle_rad));
            let patch = patch(&there, 64);
            let moved = dispatch!(Level::new(), simd => disc_motion(simd, &patch, &predicted)).unwrap();
            prop_assert!((moved.0 - du).hypot(moved.1 - dv) < 0.4, "{moved:?} {du} {dv}");
        }
    }

    #[test]
    fn missing_or_bridged_rings_have_no_predicted_bands() {
        let predicted = ring(72.3, 75.6, (15.0, 0.9, 0.3));
        let mut scratch = BandScratch::new();
        let whole = patch(&predicted, 64);
        assert!(bands(&whole, &predicted, &mut scratch).is_some());
        assert!(bands(&whole, &predicted.moved(4.0, 0.0), &mut scratch).is_none());
        let found = bands(&whole, &predicted, &mut scratch).unwrap().bands;
        // One pixel between the bands is enough.
        for (set, white) in [(found.near, false), (found.disc_core, false), (found.black, true)] {
            let at = set.iter().position(|&bits| bits != 0).unwrap();
            let pixel = 1 << set[at].trailing_zeros();
            let mut corrupted = patch(&predicted, 64);
            corrupted.white[found.top * corrupted.words + at] ^= pixel;
            assert_eq!(corrupted.white[found.top * corrupted.words + at] & pixel != 0, white);
            assert!(bands(&corrupted, &predicted, &mut BandScratch::new()).is_none());
        }
    }

    #[test]
    fn thin_rings_have_no_predicted_bands() {
        let thin = ring(72.3, 75.6, (8.0, 0.9, 0.3));
        let patch = patch(&thin, 64);
        assert!(dispatch!(Level::new(), simd => disc_motion(simd, &patch, &thin)).is_none());
    }
}
