//! Sums over a roundel's pixels: levels, and moments weighted by grey levels.
//!
//! Sixteen columns are summed at a time, each in its own lane, Σ w, Σ w v and Σ w v² over the rows;
//! what multiplies u enters once a column in the end. In `f32`, with u and v counted from the
//! roundel's middle, a sum's rounding is below 1e-6 of it.

use fearless_simd::{
    Simd, f32x16, mask8x64, mask16x32, mask32x16, prelude::*, u8x64, u16x32, u32x16,
};
use fearless_simd_macros::simd;

use crate::{ellipse::Moments, marker::patch::WORD_PX};

/// Columns summed at a time.
const LANES: usize = 16;

/// Number and sum of grey levels of a set of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Grey {
    pub pixels: u32,
    pub sum: u64,
}

impl Grey {
    /// Not a number without pixels.
    pub fn mean(&self) -> f64 {
        self.sum as f64 / f64::from(self.pixels)
    }

    /// Both sets together.
    pub fn joined(self, other: Grey) -> Grey {
        Grey { pixels: self.pixels + other.pixels, sum: self.sum + other.sum }
    }
}

/// Levels of several sets of pixels, (left, right) of an even column of the patch.
#[simd]
pub(crate) fn levels<S: Simd, const N: usize>(
    simd: S,
    grey: &[[u8; WORD_PX]],
    sets: [&[u64]; N],
    words: usize,
    column: usize,
) -> [[Grey; 2]; N] {
    let none = u8x64::splat(simd, 0);
    let nothing = u16x32::splat(simd, 0);
    let mut levels = [[Grey::default(); 2]; N];
    let sets = sets.map(|set| &set[..grey.len()]);
    let rows = grey.len() / words;
    for word in 0..words {
        let columns = column.saturating_sub(word * WORD_PX).min(WORD_PX);
        let left = u64::MAX.checked_shl(columns as u32).map_or(u64::MAX, |right| !right);
        let left_pairs = mask16x32::from_bitmask(simd, (1 << (columns / 2)) - 1);
        let mut from = 0;
        while from < rows {
            // So many rows fit into 16 bits: each lane takes two pixels of a row.
            let to = (from + 64).min(rows);
            let mut lanes = [nothing; N];
            let mut at = from * words + word;
            while at < (to * words).min(grey.len()) {
                let pixels = u8x64::load_array(simd, grey[at]);
                for set in 0..N {
                    let chosen = mask8x64::from_bitmask(simd, sets[set][at]);
                    lanes[set] += chosen.select(pixels, none).pairwise_widening_add();
                }
                at += words;
            }
            for set in 0..N {
                let [of_left, of_right] = &mut levels[set];
                let sum = |lanes: u16x32<S>| u64::from(lanes.pairwise_widening_add().reduce_sum());
                let (all, some) = (sum(lanes[set]), sum(left_pairs.select(lanes[set], nothing)));
                of_left.sum += some;
                of_right.sum += all - some;
            }
            from = to;
        }
        for set in 0..N {
            let (all, some) = if words == 1 {
                count(sets[set].iter(), left)
            } else {
                count(sets[set][word.min(grey.len())..].iter().step_by(words), left)
            };
            levels[set][0].pixels += some;
            levels[set][1].pixels += all - some;
        }
    }
    levels
}

/// How many bits are set, and how many of them among the `chosen` ones of each word.
#[inline(always)]
fn count<'a>(set: impl Iterator<Item = &'a u64>, chosen: u64) -> (u32, u32) {
    let (mut all, mut some) = (0u64, 0u64);
    for bits in set {
        all += u64::from(bits.count_ones());
        some += u64::from((bits & chosen).count_ones());
    }
    (all as u32, some as u32)
}

/// Σ I² of a set of pixels.
#[simd]
pub(crate) fn square<S: Simd>(simd: S, grey: &[[u8; WORD_PX]], set: &[u64]) -> u64 {
    let none = u8x64::splat(simd, 0);
    let mut sum = 0;
    // A lane takes four pixels of a row, so this many rows are sure to fit into 32 bits.
    for (grey, set) in grey.chunks(1 << 13).zip(set.chunks(1 << 13)) {
        let mut lanes = u32x16::splat(simd, 0);
        for (pixels, &bits) in grey.iter().zip(set) {
            let chosen = mask8x64::from_bitmask(simd, bits);
            let pixels = chosen.select(u8x64::load_array(simd, *pixels), none);
            let (low, high) = pixels.widening_mul(pixels);
            lanes += low.pairwise_widening_add() + high.pairwise_widening_add();
        }
        sum += lanes.as_slice().iter().map(|&lane| u64::from(lane)).sum::<u64>();
    }
    sum
}

/// How grey levels count: w = `offset` + `gain` I in the belt, `core` in the core.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weights {
    pub offset: f32,
    pub gain: f32,
    pub core: f32,
}

impl Weights {
    /// 0 at grey level `from`, 1 at `to` and in the core.
    pub fn between(from: f64, to: f64) -> Self {
        let gain = 1.0 / (to - from);
        Self { offset: (-gain * from) as f32, gain: gain as f32, core: 1.0 }
    }
}

/// Moments of the pixels of `core` and `belt`, of which there are none outside of these rows and
/// columns; sums are counted from the pixel `first` rows and columns after the first one.
#[simd]
pub(crate) fn moments<S: Simd>(
    simd: S,
    grey: &[[u8; WORD_PX]],
    (core, belt): (&[u64], &[u64]),
    (words, area): (usize, &Area),
    (middle_u, middle_v): (usize, usize),
    weights: Weights,
) -> Moments {
    let mut moments = Moments::default();
    let rows = area.rows.0 * words..(area.rows.1 * words).min(grey.len());
    let (grey, core, belt) = (&grey[rows.clone()], &core[rows.clone()], &belt[rows]);
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
            let sums = lanes(simd, grey, (core, belt), (word, words, column), first_v, weights);
            add(&mut moments, simd, sums, u);
        }
    }
    moments
}

/// Rows and columns (first, end).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Area {
    pub rows: (usize, usize),
    pub columns: (usize, usize),
}

/// Σ w, Σ w v, Σ w v² of sixteen columns.
#[simd]
fn lanes<S: Simd>(
    simd: S,
    grey: &[[u8; WORD_PX]],
    (core, belt): (&[u64], &[u64]),
    (word, words, column): (usize, usize, usize),
    first_v: f32,
    weights: Weights,
) -> [f32x16<S>; 3] {
    let zero = f32x16::splat(simd, 0.0);
    let (offset, gain) = (f32x16::splat(simd, weights.offset), f32x16::splat(simd, weights.gain));
    let whole = f32x16::splat(simd, weights.core);
    let (core, belt) = (&core[..grey.len()], &belt[..grey.len()]);
    let column = column.min(WORD_PX - LANES);
    let pixels = Pixels { grey, core, belt, column, offset, gain, whole };
    // Every other row has sums of its own, so that no addition waits for the one before.
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

/// Sixteen columns of rows, with what weighs them.
#[derive(Clone, Copy)]
struct Pixels<'a, S: Simd> {
    grey: &'a [[u8; WORD_PX]],
    core: &'a [u64],
    belt: &'a [u64],
    column: usize,
    offset: f32x16<S>,
    gain: f32x16<S>,
    whole: f32x16<S>,
}

impl<S: Simd> Pixels<'_, S> {
    #[inline(always)]
    fn weight(&self, simd: S, at: usize) -> f32x16<S> {
        let pixels: &[u8; LANES] =
            self.grey[at][self.column..].first_chunk().expect("sixteen columns of a word");
        let pixels = f32x16::from_fn(simd, |lane| f32::from(pixels[lane]));
        let in_belt = mask32x16::from_bitmask(simd, self.belt[at] >> self.column & 0xffff);
        let in_core = mask32x16::from_bitmask(simd, self.core[at] >> self.column & 0xffff);
        let in_core = in_core.select(self.whole, f32x16::splat(simd, 0.0));
        in_belt.select(pixels.mul_add(self.gain, self.offset), in_core)
    }
}

#[inline(always)]
fn add<S: Simd>(moments: &mut Moments, simd: S, [n, nv, nvv]: [f32x16<S>; 3], first_u: f32) {
    let u = f32x16::from_fn(simd, |lane| lane as f32) + first_u;
    let nu = n * u;
    moments.n += f64::from(n.reduce_sum());
    moments.u += f64::from(nu.reduce_sum());
    moments.uu += f64::from((nu * u).reduce_sum());
    moments.v += f64::from(nv.reduce_sum());
    moments.uv += f64::from((nv * u).reduce_sum());
    moments.vv += f64::from(nvv.reduce_sum());
}
