//! Measurement of several tracked rings at once, one per vector lane.
//!
//! | module | content |
//! | --- | --- |
//! | `planes` | pixel sets of one ring, a word per row |
//! | `row_sums`, `accumulate` | one pass over a ring's pixels: all sums |
//! | `table` | the sums of all rings, a column each; levels and weighed rims from them |
//! | `rims` | rims without blur, tests, kinds |
//!
//! From the sums to the rims leads one dependency chain of some sixty divisions and roots. The rings of one frame go
//! through it in the lanes of vectors ([`crate::simd`]), with the arithmetic of [`crate::marker::ring`].
//! Rings that fail a test, or need a rare case, are left to [`crate::marker::ring::measure`], which also gives the reason
//! for a rejection.
//!
//! PERF: `cargo bench -p roundel-tests --bench time`, fast, 30 px, AVX-512: with the sums in one pass, a ring
//! among 100 takes 0.70 of the time of measuring each separately, its pose included, and a single one 0.87.
//! No vector may pass through `array::map` here: it would be compiled for the baseline processor.

mod accumulate;
mod planes;
mod rims;
mod row_sums;
mod table;

use fearless_simd::{Level, Simd, SimdFrom, dispatch, f64x8};
use fearless_simd_macros::simd;

use crate::{
    camera::PixelPoint,
    ellipse::Symmetric2,
    frame::{Frame, Window},
    id::KindId,
    marker::{
        Ring,
        batch::{
            accumulate::accumulate_ring,
            planes::Planes,
            rims::Rims,
            table::{RINGS, RingSums, Table},
        },
        kind::Kind,
        ring::{
            measure::{RETHRESHOLD_SHARE, own_threshold},
            pixels::{
                ellipse_mask::RimEllipse,
                patch::Patch,
                predicted::{PredictedRims, disc_motion},
            },
            probe::{Probe, Rules},
            subpixel::unevenness::{RimPixels, unevenness},
            weighed_rim::{LaneEllipse, WeighedRim},
        },
    },
    simd::{Lane, Mask},
};
/// Memory of measuring a batch.
#[derive(Debug)]
pub(crate) struct BatchScratch {
    level: Level,
    patch: Patch,
    planes: Planes,
    table: Table,
    /// Where rings are predicted.
    pub probes: [Option<Probe>; BATCH_SIZE],
    /// What was found there.
    pub found: [Option<BatchedRing>; BATCH_SIZE],
}

/// A ring of a batch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BatchedRing {
    pub ring: Ring,
    /// Its rims with their matrices.
    pub rims: PredictedRims,
}

impl Default for BatchScratch {
    fn default() -> Self {
        let (patch, planes, table) = Default::default();
        let (probes, found) = ([None; BATCH_SIZE], [None; BATCH_SIZE]);
        Self { level: Level::new(), patch, planes, table, probes, found }
    }
}

impl BatchScratch {
    /// Reserves memory for windows as high as the frame.
    pub fn reserve(&mut self, height: usize) {
        self.patch.reserve(1, height);
    }
}

/// Largest number of rings per batch.
pub(crate) const BATCH_SIZE: usize = RINGS;

/// A ring whose sums are in the table.
#[derive(Clone, Copy, Debug)]
struct Accumulated<'a> {
    /// Index of its probe.
    place: usize,
    probe: &'a Probe,
    /// Displacement from the prediction, pixels.
    moved_px: (f64, f64),
    window: Window,
}

/// Finds, at the scratch's probes, rings of plain kinds with similar rims that are where predicted.
/// The result of a ring does not depend on the others.
pub(crate) fn measure_batch(
    frame: &Frame,
    rules: &Rules,
    kinds: &[Kind],
    scratch: &mut BatchScratch,
) {
    dispatch!(scratch.level, simd => measure_with(simd, frame, rules, kinds, scratch));
}

#[simd]
fn measure_with<S: Simd>(
    simd: S,
    frame: &Frame,
    rules: &Rules,
    kinds: &[Kind],
    scratch: &mut BatchScratch,
) {
    let BatchScratch { patch, planes, table, probes, found, .. } = scratch;
    let mut accumulated = [const { None }; BATCH_SIZE];
    let mut count = 0;
    for (place, probe) in probes.iter().enumerate() {
        let Some(probe) = probe else { continue };
        if let Some((moved_px, sums)) = accumulate_probe(simd, frame, probe, patch, planes) {
            table.store(count, &sums);
            accumulated[count] = Some(Accumulated { place, probe, moved_px, window: patch.window });
            count += 1;
        }
    }
    let size = (frame.width(), frame.height());
    match count {
        0 => {}
        // A batch of eight takes longer than one ring, but less than two.
        1 => {
            let rims = Rims::new(0.0, table, size, rules, kinds);
            finish(simd, frame, &accumulated, &rims, found);
        }
        _ => {
            let rims = Rims::new(f64x8::simd_from(simd, 0.0), table, size, rules, kinds);
            finish(simd, frame, &accumulated, &rims, found);
        }
    }
}

/// Displacement and sums of the ring at a probe if it is there.
#[simd]
fn accumulate_probe<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    patch: &mut Patch,
    planes: &mut Planes,
) -> Option<((f64, f64), RingSums)> {
    let predicted = probe.predicted.as_ref()?;
    if !Patch::threshold(simd, patch, frame, probe.bounds, probe.frame_threshold()) {
        return None;
    }
    let moved_px = disc_motion(simd, patch, predicted)?;
    let predicted = predicted.moved(moved_px.0, moved_px.1);
    let sums = accumulate_ring(simd, frame, patch, probe.polarity, &predicted, planes)?;
    Some((moved_px, sums))
}

/// Stores the rings that passed all tests.
#[inline(always)]
fn finish<S: Simd, T: Lane>(
    simd: S,
    frame: &Frame,
    accumulated: &[Option<Accumulated>; BATCH_SIZE],
    rims: &Rims<T>,
    results: &mut [Option<BatchedRing>; BATCH_SIZE],
) {
    for (lane, accumulated) in accumulated.iter().enumerate() {
        let Some(Accumulated { place, probe, moved_px, window }) = accumulated else { break };
        if !rims.valid.is_set(lane) || !is_near(probe, *moved_px, &rims.raw, lane) {
            continue;
        }
        let (black, white) = (rims.black.lane(lane), rims.white.lane(lane));
        let threshold = own_threshold(black, white);
        let off = f64::from(threshold.abs_diff(probe.threshold));
        if off > RETHRESHOLD_SHARE.0 * (white - black) {
            continue;
        }
        let WeighedRim { rim, matrix: [uu, uv, vv], .. } = &rims.weighed;
        let (center, matrix) = (
            PixelPoint { u: rim.u.lane(lane), v: rim.v.lane(lane) },
            Symmetric2 { uu: uu.lane(lane), uv: uv.lane(lane), vv: vv.lane(lane) },
        );
        let pixels = RimPixels::within(frame, *window);
        let contrast = rims.contrast.lane(lane);
        let Ok(unevenness) = unevenness(simd, &pixels, center, &matrix, contrast) else { continue };
        let [outer, inner] = &rims.compensated;
        let outer = RimEllipse { ellipse: outer.at(lane), matrix: outer.matrix_at(lane) };
        let inner = RimEllipse { ellipse: inner.at(lane), matrix: inner.matrix_at(lane) };
        let ring = Ring {
            kind: Some(KindId(rims.kind.lane(lane) as u16)),
            threshold,
            black,
            white,
            unevenness,
            shift_px: rims.shift_px.lane(lane),
            ..Ring::of_rims(outer.ellipse, inner.ellipse)
        };
        let ring = ring.with_polarity(probe.polarity);
        results[*place] = Some(BatchedRing { ring, rims: PredictedRims { outer, inner } });
    }
}

/// Whether the rims in a lane are in the middle of their bands.
#[inline(always)]
fn is_near<T: Lane>(
    probe: &Probe,
    (du, dv): (f64, f64),
    rims: &[LaneEllipse<T>; 2],
    lane: usize,
) -> bool {
    let (mut outer, mut inner) = (rims[0].at(lane), rims[1].at(lane));
    for found in [&mut outer, &mut inner] {
        found.center.u -= du;
        found.center.v -= dv;
    }
    probe.predicted.as_ref().is_some_and(|predicted| predicted.is_near(&outer, &inner))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        ellipse::Ellipse,
        marker::{
            kind::Polarity,
            ring::{
                checks::MAX_SPREAD_PX2,
                measure::{MeasureScratch, measure},
            },
        },
    };
    use proptest::prelude::*;
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    /// Side of the picture, and of each ring's cell.
    const SIDE: usize = 400;
    const CELL: usize = 100;

    fn rules() -> Rules {
        Rules {
            ratios: (0.38, 0.52),
            similar: true,
            min_semi_minor_px: 4.0,
            min_axis_ratio: 0.3,
            min_contrast: 30.0,
            max_spread_px2: MAX_SPREAD_PX2,
            steps_share: 0.0,
            fits_paper_edge: true,
        }
    }

    /// A ring, its ratio of diameters, and the offset of its prediction.
    fn ring() -> impl Strategy<Value = (Ellipse, f64, (f64, f64))> {
        let center = (45.0..55.0f64, 45.0..55.0f64);
        let off = (-0.4..0.4f64, -0.4..0.4f64);
        (center, 13.0..22.0f64, 0.8..1.0f64, -1.5..1.5f64, any::<bool>(), off).prop_map(
            |((u, v), semi_major_px, flat, angle_rad, is_wide, off)| {
                let center = PixelPoint { u, v };
                let semi_minor_px = semi_major_px * flat;
                let rim = Ellipse { center, semi_major_px, semi_minor_px, angle_rad };
                (rim, if is_wide { 0.5 } else { 0.4 }, off)
            },
        )
    }

    fn scaled(rim: &Ellipse, share: f64) -> Ellipse {
        let (a, b) = (rim.semi_major_px * share, rim.semi_minor_px * share);
        Ellipse { semi_major_px: a, semi_minor_px: b, ..*rim }
    }

    /// Eight rings, every other one white, and their probes.
    fn picture(rings: &[(Ellipse, f64, (f64, f64))]) -> (Vec<u8>, [Option<Probe>; BATCH_SIZE]) {
        let polarity = |place: usize| [Polarity::BlackRing, Polarity::WhiteRing][place / 2 % 2];
        let corner = |place: usize| ((place % 4 * CELL) as f64, (place / 4 * CELL) as f64);
        let level = |u: f64, v: f64| {
            let place = (v / CELL as f64) as usize % 2 * 4 + (u / CELL as f64) as usize % 4;
            let (rim, ratio, _) = &rings[place];
            let (left, top) = corner(place);
            let at = PixelPoint { u: u - left, v: v - top };
            let is_ring = rim.contains(at) && !scaled(rim, *ratio).contains(at);
            let is_white = is_ring == (polarity(place) == Polarity::WhiteRing);
            if is_white { 190.0 + 0.05 * u } else { 40.0 }
        };
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut pixel = |at: usize| {
            let (u, v) = ((at % SIDE) as f64, (at / SIDE) as f64);
            // A box two pixels wide blurs as much as a lens.
            let parts = (0..64).map(|k| {
                let (du, dv) = (f64::from(k % 8) - 3.5, f64::from(k / 8) - 3.5);
                level((u + du / 4.0).max(0.0), (v + dv / 4.0).max(0.0))
            });
            (parts.sum::<f64>() / 64.0 + rng.random_range(0.0..4.0)).round() as u8
        };
        let bytes = (0..SIDE * 2 * CELL).map(&mut pixel).collect::<Vec<_>>();
        let frame = Frame::new(&bytes, SIDE, 2 * CELL, SIDE).unwrap();
        let probe = |place: usize| {
            let (rim, ratio, off) = rings[place];
            let (left, top) = corner(place);
            let predicted =
                PredictedRims::new(&rim, &scaled(&rim, ratio)).moved(left + off.0, top + off.1);
            let PixelPoint { u, v } = predicted.outer.ellipse.center;
            let bounds = Window::around(&frame, (u, v), (31.0, 31.0));
            let center = (u as usize, v as usize);
            let threshold = if polarity(place) == Polarity::BlackRing { 118 } else { 138 };
            let (polarity, predicted) = (polarity(place), Some(predicted));
            Some(Probe { center, threshold, bounds, polarity, predicted })
        };
        let probes = std::array::from_fn(probe);
        (bytes, probes)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn batched_rings_equal_single_ones(rings in proptest::collection::vec(ring(), BATCH_SIZE)) {
            let (bytes, probes) = picture(&rings);
            let frame = Frame::new(&bytes, SIDE, 2 * CELL, SIDE).unwrap();
            let kinds = [0.4, 0.5].map(|ratio| Kind::plain("black", 0.1, 0.1 * ratio));
            let white = kinds.clone().map(|kind| Kind { polarity: Polarity::WhiteRing, ..kind });
            let kinds = [kinds, white].concat();
            for level in [Level::new(), Level::baseline()] {
                let mut scratch = BatchScratch { level, probes, ..BatchScratch::default() };
                measure_batch(&frame, &rules(), &kinds, &mut scratch);
                let found = scratch.found.map(|found| found.map(|found| found.ring));
                // A few are left to the single measurement.
                prop_assert!(found.iter().flatten().count() >= BATCH_SIZE - 2, "{:?}", found);
                let mut alone = MeasureScratch::default();
                for place in 0..BATCH_SIZE {
                    let Some(ring) = &found[place] else { continue };
                    let probe = probes[place].as_ref().unwrap();
                    let plain = measure(&frame, probe, &rules(), &kinds, &mut alone).unwrap();
                    prop_assert_eq!(
                        (ring.kind, ring.threshold, ring.polarity),
                        (plain.kind, plain.threshold, plain.polarity)
                    );
                    let numbers = |ring: &Ring| {
                        let of = |rim: &Ellipse| {
                            let (sin, cos) = (2.0 * rim.angle_rad).sin_cos();
                            let (a, b) = (rim.semi_major_px, rim.semi_minor_px);
                            [rim.center.u, rim.center.v, a, b, (a - b) * sin, (a - b) * cos]
                        };
                        let rest = [ring.black, ring.white, 100.0 * ring.unevenness];
                        [of(&ring.outer).as_slice(), &of(&ring.inner), &rest].concat()
                    };
                    for (ours, plain) in numbers(ring).into_iter().zip(numbers(&plain)) {
                        prop_assert!((ours - plain).abs() < 1e-4, "{ours} {plain}");
                    }
                    // Identical to the last bit, with any others.
                    scratch.probes = [None; BATCH_SIZE];
                    scratch.probes[BATCH_SIZE - 1 - place] = probes[place];
                    scratch.found = [None; BATCH_SIZE];
                    measure_batch(&frame, &rules(), &kinds, &mut scratch);
                    let again = scratch.found[BATCH_SIZE - 1 - place].map(|found| found.ring);
                    prop_assert_eq!(again, Some(*ring));
                }
            }
        }
    }
}
