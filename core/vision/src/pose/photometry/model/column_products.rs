//! Sums of products of the linear problem's columns: JᵀJ and Jᵀr.
//!
//! Pixels arrive in vectors and are buffered. Every [`PIXELS`] of them are multiplied, three
//! columns by three, which keeps sums and factors in registers.

use fearless_simd::prelude::*;
use fearless_simd_macros::simd;
use nalgebra::SMatrix;

/// Columns: residual, parameters, mirrored pose, motion.
pub const COLUMNS: usize = 14;
/// Columns without those of the motion, which are the last.
pub const STILL: usize = 12;
const GROUP: usize = 3;
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

    /// Sets the products with the residual; all others keep their values.
    #[inline(always)]
    pub fn set_gradient<S: Simd, const MOTION: bool>(&mut self, gradient: &[S::f32s; COLUMNS]) {
        for (column, product) in gradient.iter().enumerate().take(column_count(MOTION)) {
            let mut lanes = [0.0; LANES];
            product.store_slice(&mut lanes[..S::f32s::LEN]);
            self.set(0, column, lanes);
        }
    }

    /// Multiplies the rest of the buffer, and adds up the lanes.
    #[inline(always)]
    pub fn finish<S: Simd, const MOTION: bool>(&mut self, simd: S) {
        multiply::<S, MOTION>(simd, self);
        for row in 0..column_count(MOTION) {
            for column in row..column_count(MOTION) {
                self.set(row, column, self.lanes[row * COLUMNS + column]);
            }
        }
    }

    #[inline(always)]
    fn set(&mut self, row: usize, column: usize, lanes: [f32; LANES]) {
        let sum = sum_of(lanes);
        self.products[(row, column)] = sum;
        self.products[(column, row)] = sum;
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
    for first in (0..STILL).step_by(GROUP) {
        multiply_block::<S, GROUP, GROUP, true>(simd, sums, first, first);
        for second in (first + GROUP..STILL).step_by(GROUP) {
            multiply_block::<S, GROUP, GROUP, false>(simd, sums, first, second);
        }
        if MOTION {
            multiply_block::<S, GROUP, 2, false>(simd, sums, first, column::MOTION);
        }
    }
    if MOTION {
        multiply_block::<S, 2, 2, true>(simd, sums, column::MOTION, column::MOTION);
    }
    sums.count = 0;
    sums.is_stale = false;
}

/// Adds the products of `A` columns from `first` on with `B` columns from `second` on; only those
/// on and above the diagonal if both are the same.
#[inline(always)]
fn multiply_block<S: Simd, const A: usize, const B: usize, const SAME: bool>(
    simd: S,
    sums: &mut ProductSums,
    first: usize,
    second: usize,
) {
    let (count, width) = (sums.count, S::f32s::LEN);
    let (mut lefts, mut rights) = ([&sums.buffer[..0]; A], [&sums.buffer[..0]; B]);
    for (i, left) in lefts.iter_mut().enumerate() {
        *left = &sums.buffer[(first + i) * STRIDE..][..count];
    }
    for (j, right) in rights.iter_mut().enumerate() {
        *right = &sums.buffer[(second + j) * STRIDE..][..count];
    }
    let zero = S::f32s::splat(simd, 0.0);
    let mut block = [[zero; B]; A];
    let mut start = 0;
    while start + width <= count {
        let (mut a, mut b) = ([zero; A], [zero; B]);
        for (a, left) in a.iter_mut().zip(lefts) {
            *a = S::f32s::from_slice(simd, &left[start..start + width]);
        }
        for (b, right) in b.iter_mut().zip(rights) {
            *b = S::f32s::from_slice(simd, &right[start..start + width]);
        }
        for i in 0..A {
            for j in if SAME { i } else { 0 }..B {
                block[i][j] = a[i].mul_add(b[j], block[i][j]);
            }
        }
        start += width;
    }
    for (i, products) in block.iter().enumerate() {
        for (j, product) in products.iter().enumerate().skip(if SAME { i } else { 0 }) {
            let sum = &mut sums.lanes[(first + i) * COLUMNS + second + j][..width];
            let before = if sums.is_stale { zero } else { S::f32s::from_slice(simd, sum) };
            (before + *product).store_slice(sum);
        }
    }
}
