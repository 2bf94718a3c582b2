//! Sums of products of the linear problem's columns: JᵀJ and Jᵀr.
//!
//! Pixels arrive in vectors and are buffered. Every [`PIXELS`] of them are multiplied, three
//! columns by three, which keeps sums and factors in registers.

use fearless_simd::{Level, dispatch, prelude::*};
use fearless_simd_macros::simd;
use nalgebra::SMatrix;

/// Columns: residual, parameters, mirrored pose, motion.
pub const COLUMNS: usize = 14;
/// Columns without those of the motion, which are the last.
pub const STILL: usize = 12;
/// Columns multiplied at once.
const GROUP: usize = 3;
const GROUPS: usize = STILL / GROUP;
/// Capacity of the buffer.
const PIXELS: usize = 256;
/// Lanes of the widest vector.
const LANES: usize = 16;
/// Length of a column in the buffer, with the rest of its last vector.
const STRIDE: usize = PIXELS + LANES;

/// Indices of the columns; that of the residual is 0.
pub mod column {
    /// White level.
    pub const WHITE: usize = 1;
    /// Step from white to black.
    pub const STEP: usize = 2;
    /// σ², over half the step.
    pub const BLUR: usize = 3;
    /// Gradient of the light, two columns.
    pub const LIGHT: usize = 4;
    /// Shift across the line of sight, two columns; from here on over the step.
    pub const SHIFT: usize = 6;
    /// Logarithm of the range.
    pub const RANGE: usize = 8;
    /// Rotations about the print's x and y, two columns.
    pub const TILT: usize = 9;
    /// Displacement to the mirrored pose.
    pub const MIRROR: usize = 11;
    /// Square of the motion, two columns, over 1/48 of the step; left out where the motion is held.
    pub const MOTION: usize = 12;
}

pub type Products<const COUNT: usize = COLUMNS> = SMatrix<f64, COUNT, COUNT>;

/// Buffered pixels, and sums over those multiplied.
#[derive(Clone, Debug)]
pub struct ProductSums {
    buffer: Vec<f32>,
    count: usize,
    lanes: Vec<[f32; LANES]>,
    /// Whether the sums are those of an earlier linearization.
    is_stale: bool,
    /// After [`ProductSums::finish`]: Σ over pixels of column times column.
    pub products: Products,
    /// Sum of [`super::residual_patches`].
    pub patches: f32,
}

impl Default for ProductSums {
    fn default() -> Self {
        Self {
            buffer: vec![0.0; STRIDE * COLUMNS],
            count: 0,
            lanes: vec![[0.0; LANES]; COLUMNS * COLUMNS],
            is_stale: true,
            products: Products::zeros(),
            patches: 0.0,
        }
    }
}

impl ProductSums {
    pub fn clear(&mut self) {
        self.count = 0;
        self.is_stale = true;
    }

    /// Buffers the first `count` pixels of a vector, and multiplies when the buffer is full.
    #[inline(always)]
    pub fn push<S: Simd, const MOTION: bool>(
        &mut self,
        simd: S,
        columns: &[S::f32s; COLUMNS],
        count: usize,
    ) {
        let lanes = S::f32s::LEN;
        let buffer = &mut self.buffer[self.count..self.count + (COLUMNS - 1) * STRIDE + LANES];
        for column in 0..column_count(MOTION) {
            columns[column].store_slice(&mut buffer[column * STRIDE..column * STRIDE + lanes]);
        }
        self.count += count;
        if self.count > PIXELS - lanes {
            multiply::<S, MOTION>(simd, self);
        }
    }

    /// Stores sums of the products with the residual; all others keep their values.
    pub fn take_gradient<S: Simd, const MOTION: bool>(&mut self, gradient: &[S::f32s; COLUMNS]) {
        for (column, lanes) in gradient.iter().enumerate().take(column_count(MOTION)) {
            lanes.store_slice(&mut self.lanes[column][..S::f32s::LEN]);
        }
    }

    /// Adds up the lanes that [`ProductSums::take_gradient`] stored.
    pub fn finish_gradient(&mut self, with_motion: bool) {
        for column in 0..column_count(with_motion) {
            let sum = sum_of(self.lanes[column]);
            self.products[(0, column)] = sum;
            self.products[(column, 0)] = sum;
        }
    }

    /// Multiplies the rest of the buffer, and adds up the lanes.
    pub fn finish(&mut self, level: Level, with_motion: bool) {
        if with_motion {
            dispatch!(level, simd => multiply::<_, true>(simd, self));
        } else {
            dispatch!(level, simd => multiply::<_, false>(simd, self));
        }
        for row in 0..column_count(with_motion) {
            for column in row..column_count(with_motion) {
                let sum = sum_of(self.lanes[row * COLUMNS + column]);
                self.products[(row, column)] = sum;
                self.products[(column, row)] = sum;
            }
        }
    }
}

const fn column_count(with_motion: bool) -> usize {
    if with_motion { COLUMNS } else { STILL }
}

/// Pairwise, which shortens the chain of dependent additions.
#[inline(always)]
fn sum_of(mut lanes: [f32; LANES]) -> f64 {
    for half in [8, 4, 2] {
        for lane in 0..half {
            lanes[lane] += lanes[lane + half];
        }
    }
    f64::from(lanes[0] + lanes[1])
}

#[simd]
fn multiply<S: Simd, const MOTION: bool>(simd: S, sums: &mut ProductSums) {
    let (count, lanes) = (sums.count, S::f32s::LEN);
    for column in sums.buffer.chunks_exact_mut(STRIDE).take(column_count(MOTION)) {
        S::f32s::splat(simd, 0.0).store_slice(&mut column[count..count + lanes]);
    }
    sums.count = count.next_multiple_of(lanes);
    for first in 0..GROUPS {
        for second in first..GROUPS {
            if first == second {
                multiply_group(simd, sums, GROUP * first);
            } else {
                multiply_groups(simd, sums, GROUP * first, GROUP * second);
            }
        }
        if MOTION {
            multiply_motion::<S, 0>(simd, sums, GROUP * first);
        }
    }
    if MOTION {
        multiply_motion::<S, 1>(simd, sums, STILL - 1);
    }
    sums.count = 0;
    sums.is_stale = false;
}

/// Adds a block of products, or overwrites a stale sum.
#[inline(always)]
fn accumulate<S: Simd>(simd: S, sums: &mut ProductSums, place: usize, product: S::f32s) {
    let sum = &mut sums.lanes[place][..S::f32s::LEN];
    let before =
        if sums.is_stale { S::f32s::splat(simd, 0.0) } else { S::f32s::from_slice(simd, sum) };
    (before + product).store_slice(sum);
}

/// Products of the three columns from `first` on with each other.
#[inline(always)]
fn multiply_group<S: Simd>(simd: S, sums: &mut ProductSums, first: usize) {
    let width = S::f32s::LEN;
    let count = sums.count;
    let column = |index: usize| &sums.buffer[index * STRIDE..][..count];
    let (a0, a1, a2) = (column(first), column(first + 1), column(first + 2));
    let mut block = [S::f32s::splat(simd, 0.0); GROUP * (GROUP + 1) / 2];
    let lists = a0.chunks_exact(width).zip(a1.chunks_exact(width)).zip(a2.chunks_exact(width));
    for ((a0, a1), a2) in lists {
        let a0 = S::f32s::from_slice(simd, a0);
        let a1 = S::f32s::from_slice(simd, a1);
        let a2 = S::f32s::from_slice(simd, a2);
        block[0] = a0.mul_add(a0, block[0]);
        block[1] = a0.mul_add(a1, block[1]);
        block[2] = a0.mul_add(a2, block[2]);
        block[3] = a1.mul_add(a1, block[3]);
        block[4] = a1.mul_add(a2, block[4]);
        block[5] = a2.mul_add(a2, block[5]);
    }
    for (product, (i, j)) in block.into_iter().zip([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)])
    {
        accumulate(simd, sums, (first + i) * COLUMNS + first + j, product);
    }
}

/// Products of the three columns from `first` on with the three from `second` on.
#[inline(always)]
fn multiply_groups<S: Simd>(simd: S, sums: &mut ProductSums, first: usize, second: usize) {
    let width = S::f32s::LEN;
    let count = sums.count;
    let column = |index: usize| &sums.buffer[index * STRIDE..][..count];
    let (a0, a1, a2) = (column(first), column(first + 1), column(first + 2));
    let (b0, b1, b2) = (column(second), column(second + 1), column(second + 2));
    let mut block = [S::f32s::splat(simd, 0.0); GROUP * GROUP];
    let lists = a0.chunks_exact(width).zip(a1.chunks_exact(width)).zip(a2.chunks_exact(width));
    let lists = lists.zip(b0.chunks_exact(width)).zip(b1.chunks_exact(width));
    for (((((a0, a1), a2), b0), b1), b2) in lists.zip(b2.chunks_exact(width)) {
        let a0 = S::f32s::from_slice(simd, a0);
        let a1 = S::f32s::from_slice(simd, a1);
        let a2 = S::f32s::from_slice(simd, a2);
        let b0 = S::f32s::from_slice(simd, b0);
        let b1 = S::f32s::from_slice(simd, b1);
        let b2 = S::f32s::from_slice(simd, b2);
        block[0] = a0.mul_add(b0, block[0]);
        block[1] = a0.mul_add(b1, block[1]);
        block[2] = a0.mul_add(b2, block[2]);
        block[3] = a1.mul_add(b0, block[3]);
        block[4] = a1.mul_add(b1, block[4]);
        block[5] = a1.mul_add(b2, block[5]);
        block[6] = a2.mul_add(b0, block[6]);
        block[7] = a2.mul_add(b1, block[7]);
        block[8] = a2.mul_add(b2, block[8]);
    }
    for i in 0..GROUP {
        for j in 0..GROUP {
            accumulate(simd, sums, (first + i) * COLUMNS + second + j, block[GROUP * i + j]);
        }
    }
}

/// Products of three columns, without the first `SKIP`, with the two of the motion.
#[inline(always)]
fn multiply_motion<S: Simd, const SKIP: usize>(simd: S, sums: &mut ProductSums, first: usize) {
    let width = S::f32s::LEN;
    let count = sums.count;
    let column = |index: usize| &sums.buffer[index * STRIDE..][..count];
    let (a0, a1, a2) = (column(first), column(first + 1), column(first + 2));
    let (b0, b1) = (column(column::MOTION), column(column::MOTION + 1));
    let mut block = [S::f32s::splat(simd, 0.0); 2 * GROUP];
    let lists = a0.chunks_exact(width).zip(a1.chunks_exact(width)).zip(a2.chunks_exact(width));
    for ((((a0, a1), a2), b0), b1) in lists.zip(b0.chunks_exact(width)).zip(b1.chunks_exact(width))
    {
        let a0 = S::f32s::from_slice(simd, a0);
        let a1 = S::f32s::from_slice(simd, a1);
        let a2 = S::f32s::from_slice(simd, a2);
        let b0 = S::f32s::from_slice(simd, b0);
        let b1 = S::f32s::from_slice(simd, b1);
        block[0] = a0.mul_add(b0, block[0]);
        block[1] = a0.mul_add(b1, block[1]);
        block[2] = a1.mul_add(b0, block[2]);
        block[3] = a1.mul_add(b1, block[3]);
        block[4] = a2.mul_add(b0, block[4]);
        block[5] = a2.mul_add(b1, block[5]);
    }
    for i in SKIP..GROUP {
        for j in 0..2 {
            accumulate(simd, sums, (first + i) * COLUMNS + column::MOTION + j, block[2 * i + j]);
        }
    }
}
