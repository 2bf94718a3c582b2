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
            for at in (from * words + word..to * words).step_by(words) {
                let pixels = u8x64::load_array(simd, grey[at]);
                for set in 0..N {
                    let chosen = mask8x64::from_bitmask(simd, sets[set][at]);
                    lanes[set] += chosen.select(pixels, none).pairwise_widening_add();
                }
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
            let [of_left, of_right] = &mut levels[set];
            for &bits in sets[set][word..].iter().step_by(words) {
                of_left.pixels += (bits & left).count_ones();
                of_right.pixels += (bits & !left).count_ones();
            }
        }
    }
    levels
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

/// Moments of the pixels of `core` and `belt`, whose rows lie `first_v` and following from the
/// origin, and whose first column `first_u`.
#[simd]
pub(crate) fn moments<S: Simd>(
    simd: S,
    grey: &[[u8; WORD_PX]],
    (core, belt): (&[u64], &[u64]),
    words: usize,
    (first_u, first_v): (f32, f32),
    weights: Weights,
) -> Moments {
    let mut moments = Moments::default();
    for word in 0..words {
        let set = |at: usize| core[at] | belt[at];
        let any = (word..grey.len()).step_by(words).fold(0, |any, at| any | set(at));
        if any == 0 {
            continue;
        }
        let (first, last) = (any.trailing_zeros() as usize, 63 - any.leading_zeros() as usize);
        let blocks = (last - first) / LANES + 1;
        let first = first.min(WORD_PX - LANES * blocks);
        for block in 0..blocks {
            let column = first + block * LANES;
            let u = first_u + (word * WORD_PX + column) as f32;
            let sums = lanes(simd, grey, (core, belt), (word, words, column), first_v, weights);
            add(&mut moments, simd, sums, u);
        }
    }
    moments
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
    let [mut n, mut nv, mut nvv] = [zero; 3];
    let mut v = f32x16::splat(simd, first_v);
    let rows = grey.len() / words;
    for row in 0..rows {
        let at = row * words + word;
        let pixels: &[u8; LANES] =
            grey[at][column..].first_chunk().expect("sixteen columns of a word");
        let pixels = f32x16::from_fn(simd, |lane| f32::from(pixels[lane]));
        let in_belt = mask32x16::from_bitmask(simd, belt[at] >> column & 0xffff);
        let in_core = mask32x16::from_bitmask(simd, core[at] >> column & 0xffff);
        let weight = in_belt.select(pixels.mul_add(gain, offset), in_core.select(whole, zero));
        let weight_v = weight * v;
        n += weight;
        nv += weight_v;
        nvv = weight_v.mul_add(v, nvv);
        v += 1.0;
    }
    [n, nv, nvv]
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
