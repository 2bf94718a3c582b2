//! Sums over a roundel's pixels: levels, and moments weighted by grey levels.
//!
//! Σ w, Σ w v and Σ w v² over the rows are taken for sixteen columns at a time, one per lane; factors u are applied once
//! per column at the end. In `f32`, with u and v relative to the roundel's middle, the rounding of a sum is below 1e-6 of
//! it.

use fearless_simd::{
    Simd, f32x16, i16x32, mask8x64, mask16x32, mask32x16, prelude::*, u8x64, u16x32, u32x16,
};
use fearless_simd_macros::simd;

use crate::{
    ellipse::Moments,
    marker::ring::pixels::{
        ellipse_mask::{Area, LANE_NUMBERS},
        patch::WORD_PX,
    },
};

/// Columns per vector.
const LANES: usize = 16;

/// Sets summed by [`levels`].
const SETS: usize = 4;

/// Sums of the grey levels of sets of pixels, four columns per lane.
#[derive(Clone, Copy)]
pub(crate) struct GreyLanes<S: Simd> {
    pub all: [u32x16<S>; SETS],
    /// Columns left of the middle.
    pub left: [u32x16<S>; SETS],
    /// Σ I² of the last set.
    pub square: u32x16<S>,
}

/// Sum of the lanes.
#[inline(always)]
pub(crate) fn total<S: Simd>(lanes: u32x16<S>) -> u64 {
    let (low, high) = lanes.widen();
    (low + high).as_slice().iter().sum()
}

/// Sums over sets of pixels, all and left of an even column of the patch. A lane has the range for
/// a whole frame, and for the squares of 16,000 rows.
#[simd]
pub(crate) fn levels<S: Simd>(
    simd: S,
    grey: &[[u8; WORD_PX]],
    sets: [&[u64]; SETS],
    words: usize,
    column: usize,
) -> GreyLanes<S> {
    let none = u8x64::splat(simd, 0);
    let (nothing, zero) = (u16x32::splat(simd, 0), u32x16::splat(simd, 0));
    let mut sums = GreyLanes { all: [zero; SETS], left: [zero; SETS], square: zero };
    let [a, b, c, d] = sets.map(|set| &set[..grey.len()]);
    let rows = grey.len() / words;
    for word in 0..words {
        let columns = column.saturating_sub(word * WORD_PX).min(WORD_PX);
        let left = mask16x32::from_bitmask(simd, (1 << (columns / 2)) - 1);
        let mut from = 0;
        while from < rows {
            // This many rows fit into 16 bits: each lane takes two pixels of a row.
            let to = (from + 64).min(rows);
            let mut lanes = [nothing; SETS];
            let mut at = from * words + word;
            while at < (to * words).min(grey.len()) {
                let pixels = u8x64::load_array(simd, grey[at]);
                let bits = [a[at], b[at], c[at], d[at]];
                let mut chosen = none;
                for set in 0..SETS {
                    chosen = mask8x64::from_bitmask(simd, bits[set]).select(pixels, none);
                    lanes[set] += chosen.pairwise_widening_add();
                }
                let (low, high) = chosen.widen();
                let (low, high) = (low.bitcast::<i16x32<S>>(), high.bitcast::<i16x32<S>>());
                let squares = low.pairwise_dot_product(low) + high.pairwise_dot_product(high);
                sums.square += squares.bitcast::<u32x16<S>>();
                at += words;
            }
            for (set, lanes) in lanes.into_iter().enumerate() {
                sums.all[set] += lanes.pairwise_widening_add();
                sums.left[set] += left.select(lanes, nothing).pairwise_widening_add();
            }
            from = to;
        }
    }
    sums
}

/// Number of set bits, and of those before a column.
#[inline(always)]
pub(crate) fn count(set: &[u64], words: usize, column: usize) -> (u32, u32) {
    let (mut all, mut some) = (0u64, 0u64);
    for word in 0..words {
        let columns = column.saturating_sub(word * WORD_PX).min(WORD_PX);
        let left = u64::MAX.checked_shl(columns as u32).map_or(u64::MAX, |right| !right);
        if words == 1 {
            for bits in set {
                all += u64::from(bits.count_ones());
                some += u64::from((bits & left).count_ones());
            }
        } else {
            for row in set.chunks_exact(words) {
                all += u64::from(row[word].count_ones());
                some += u64::from((row[word] & left).count_ones());
            }
        }
    }
    (all as u32, some as u32)
}

/// Weights of pixels: w = `offset` + `gain` I in the band, `core` in the core.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BandWeights {
    pub offset: f32,
    pub gain: f32,
    pub core: f32,
}

impl BandWeights {
    /// 0 at grey level `from`, 1 at `to` and in the core.
    pub fn between(from: f64, to: f64) -> Self {
        let gain = 1.0 / (to - from);
        Self { offset: (-gain * from) as f32, gain: gain as f32, core: 1.0 }
    }
}

/// The pixels of a rim's core and band.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BandPixels<'a> {
    pub grey: &'a [[u8; WORD_PX]],
    pub core: &'a [u64],
    pub band: &'a [u64],
    pub words: usize,
    /// Contains core and band.
    pub area: Area,
}

/// Weighted sums over the pixels, relative to the middle.
#[simd]
pub(crate) fn moments<S: Simd>(
    simd: S,
    pixels: &BandPixels,
    (middle_u, middle_v): (usize, usize),
    weights: BandWeights,
) -> Moments {
    let BandPixels { grey, core, band, words, area } = *pixels;
    let mut sums = [f32x16::splat(simd, 0.0); 6];
    let rows = area.rows.0 * words..(area.rows.1 * words).min(grey.len());
    let pixels = BandPixels {
        grey: &grey[rows.clone()],
        core: &core[rows.clone()],
        band: &band[rows],
        ..*pixels
    };
    let first_v = area.rows.0 as f32 - middle_v as f32;
    for word in 0..words {
        let first = area.columns.0.saturating_sub(word * WORD_PX);
        let end = area.columns.1.saturating_sub(word * WORD_PX).min(WORD_PX);
        if first >= end {
            continue;
        }
        let blocks = (end - first).div_ceil(LANES);
        let first = first.min(WORD_PX - LANES * blocks);
        for block in 0..blocks {
            let column = first + block * LANES;
            let u = (word * WORD_PX + column) as f32 - middle_u as f32;
            let of_block = lanes(simd, &pixels, word, column, first_v, weights);
            add(&mut sums, simd, of_block, u);
        }
    }
    let [n, u, v, uu, uv, vv] = sums;
    Moments {
        n: f64::from(n.reduce_sum()),
        u: f64::from(u.reduce_sum()),
        v: f64::from(v.reduce_sum()),
        uu: f64::from(uu.reduce_sum()),
        uv: f64::from(uv.reduce_sum()),
        vv: f64::from(vv.reduce_sum()),
    }
}

/// Σ w, Σ w v, Σ w v² of sixteen columns.
#[simd]
fn lanes<S: Simd>(
    simd: S,
    pixels: &BandPixels,
    word: usize,
    column: usize,
    first_v: f32,
    weights: BandWeights,
) -> [f32x16<S>; 3] {
    let zero = f32x16::splat(simd, 0.0);
    let (offset, gain) = (f32x16::splat(simd, weights.offset), f32x16::splat(simd, weights.gain));
    let whole = f32x16::splat(simd, weights.core);
    let BandPixels { grey, core, band, words, .. } = *pixels;
    let (core, band) = (&core[..grey.len()], &band[..grey.len()]);
    let column = column.min(WORD_PX - LANES);
    let pixels = PixelColumns { grey, core, band, column, offset, gain, whole };
    // Even and odd rows have separate sums, which shortens the dependency chain.
    let [mut n, mut nv, mut nvv] = [zero; 3];
    let [mut odd_n, mut odd_nv, mut odd_nvv] = [zero; 3];
    let mut v = f32x16::splat(simd, first_v);
    let mut at = word;
    while at + words < grey.len() {
        let (even, odd) = (pixels.weight(simd, at), pixels.weight(simd, at + words));
        let next_v = v + 1.0;
        let (even_v, odd_v) = (even * v, odd * next_v);
        n += even;
        odd_n += odd;
        nv += even_v;
        odd_nv += odd_v;
        nvv = even_v.mul_add(v, nvv);
        odd_nvv = odd_v.mul_add(next_v, odd_nvv);
        v += 2.0;
        at += 2 * words;
    }
    if at < grey.len() {
        let last = pixels.weight(simd, at);
        n += last;
        nv += last * v;
        nvv = (last * v).mul_add(v, nvv);
    }
    [n + odd_n, nv + odd_nv, nvv + odd_nvv]
}

/// Sixteen columns of rows, with their weights.
#[derive(Clone, Copy)]
struct PixelColumns<'a, S: Simd> {
    grey: &'a [[u8; WORD_PX]],
    core: &'a [u64],
    band: &'a [u64],
    column: usize,
    offset: f32x16<S>,
    gain: f32x16<S>,
    whole: f32x16<S>,
}

impl<S: Simd> PixelColumns<'_, S> {
    #[inline(always)]
    fn weight(&self, simd: S, at: usize) -> f32x16<S> {
        let pixels: &[u8; LANES] =
            self.grey[at][self.column..].first_chunk().expect("sixteen columns of a word");
        let pixels = f32x16::from_fn(simd, |lane| f32::from(pixels[lane]));
        let in_band = mask32x16::from_bitmask(simd, self.band[at] >> self.column & 0xffff);
        let in_core = mask32x16::from_bitmask(simd, self.core[at] >> self.column & 0xffff);
        let in_core = in_core.select(self.whole, f32x16::splat(simd, 0.0));
        in_band.select(pixels.mul_add(self.gain, self.offset), in_core)
    }
}

/// Adds sixteen columns to Σ w, Σ w u, Σ w v, Σ w u², Σ w u v and Σ w v².
#[inline(always)]
fn add<S: Simd>(sums: &mut [f32x16<S>; 6], simd: S, [n, nv, nvv]: [f32x16<S>; 3], first_u: f32) {
    let u = f32x16::load_array(simd, LANE_NUMBERS) + first_u;
    let nu = n * u;
    sums[0] += n;
    sums[1] += nu;
    sums[2] += nv;
    sums[3] = nu.mul_add(u, sums[3]);
    sums[4] = nv.mul_add(u, sums[4]);
    sums[5] += nvv;
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};
    use proptest::prelude::*;

    /// RowBits of pixels with four sets of them.
    fn rows() -> impl Strategy<Value = (usize, Vec<[u8; WORD_PX]>, [Vec<u64>; SETS])> {
        (1usize..4, 1usize..140).prop_flat_map(|(words, rows)| {
            let set = || proptest::collection::vec(any::<u64>(), words * rows);
            let grey = proptest::collection::vec(any::<[u8; WORD_PX]>(), words * rows);
            (Just(words), grey, [set(), set(), set(), set()])
        })
    }

    /// GreySum levels of a set, with their columns and rows.
    fn pixels(words: usize, grey: &[[u8; WORD_PX]], set: &[u64]) -> Vec<(usize, usize, u64)> {
        (0..set.len() * WORD_PX)
            .filter(|at| set[at / WORD_PX] >> (at % WORD_PX) & 1 == 1)
            .map(|at| {
                let row = WORD_PX * words;
                (at % row, at / row, u64::from(grey[at / WORD_PX][at % WORD_PX]))
            })
            .collect()
    }

    proptest! {
        #[test]
        fn levels_equal_scalar_sums((words, grey, sets) in rows(), half_column in 0usize..96) {
            let column = 2 * half_column;
            let of: [&[u64]; SETS] = std::array::from_fn(|set| sets[set].as_slice());
            let ours = dispatch!(Level::new(), simd => {
                let sums = levels(simd, &grey, of, words, column);
                (sums.all.map(total), sums.left.map(total), total(sums.square))
            });
            let plain = sets.each_ref().map(|set| pixels(words, &grey, set));
            let sum = |set: &Vec<(usize, usize, u64)>| set.iter().map(|pixel| pixel.2).sum::<u64>();
            prop_assert_eq!(ours.0, plain.each_ref().map(sum));
            let left = plain.each_ref().map(|set| {
                set.iter().filter(|pixel| pixel.0 < column).copied().collect::<Vec<_>>()
            });
            prop_assert_eq!(ours.1, left.each_ref().map(sum));
            prop_assert_eq!(ours.2, plain[3].iter().map(|pixel| pixel.2.pow(2)).sum::<u64>());
            let sizes = count(of[0], words, column);
            prop_assert_eq!(sizes, (plain[0].len() as u32, left[0].len() as u32));
        }

        #[test]
        fn moments_equal_scalar_sums((words, grey, sets) in rows()) {
            let (core, band) = (&sets[0], &sets[1]);
            let all = Area { rows: (0, grey.len() / words), columns: (0, words * WORD_PX) };
            let middle = (words * WORD_PX / 2, grey.len() / words / 2);
            let weights = BandWeights::between(200.0, 40.0);
            let ours = dispatch!(Level::new(), simd => {
                let pixels = BandPixels { grey: &grey, core, band, words, area: all };
                moments(simd, &pixels, middle, weights)
            });
            let only: Vec<u64> = core.iter().zip(band).map(|(core, band)| core & !band).collect();
            let of_core = pixels(words, &grey, &only).into_iter().map(|(u, v, _)| (u, v, 1.0));
            let of_band = pixels(words, &grey, band)
                .into_iter()
                .map(|(u, v, grey)| (u, v, (200.0 - grey as f64) / 160.0));
            let mut plain = Moments::default();
            let mut size = Moments::default();
            for (u, v, w) in of_core.chain(of_band) {
                let (u, v) = (u as f64 - middle.0 as f64, v as f64 - middle.1 as f64);
                for (sums, w) in [(&mut plain, w), (&mut size, f64::abs(w))] {
                    sums.n += w;
                    sums.vv += w * v * v;
                    sums.uu += w * u * u;
                }
                plain.u += w * u;
                plain.v += w * v;
                plain.uv += w * u * v;
            }
            let reach = (words * WORD_PX) as f64 + grey.len() as f64;
            for (ours, plain, scale) in [
                (ours.n, plain.n, size.n),
                (ours.u, plain.u, size.n * reach),
                (ours.v, plain.v, size.n * reach),
                (ours.uu, plain.uu, size.uu),
                (ours.uv, plain.uv, size.uu + size.vv),
                (ours.vv, plain.vv, size.vv),
            ] {
                prop_assert!((ours - plain).abs() <= 3e-6 * scale + 1e-3, "{ours} {plain}");
            }
        }
    }
}
