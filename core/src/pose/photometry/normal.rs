//! Sums of products of the linear problem's columns.
//!
//! Pixels come in vectors, are kept until [`PIXELS`] are together, and then multiplied three columns
//! by three, which keeps sums and factors in registers.

use fearless_simd::{Level, dispatch, prelude::*};
use fearless_simd_macros::simd;
use nalgebra::SMatrix;

/// Columns: the residual, and what the parameters move.
pub const COLUMNS: usize = 12;
/// Columns multiplied at once.
const GROUP: usize = 3;
/// Pixels kept at most.
const PIXELS: usize = 256;
/// Lanes of the widest vector.
const LANES: usize = 16;

/// Places of the columns.
pub mod column {
    /// Frame less model, grey levels.
    pub const RESIDUAL: usize = 0;
    /// Of the white level.
    pub const WHITE: usize = 1;
    /// Of the step from white to black.
    pub const STEP: usize = 2;
    /// Of σ², over half the step.
    pub const BLUR: usize = 3;
    /// Of the light's gradient, two.
    pub const LIGHT: usize = 4;
    /// Of a shift across the line of sight, two; from here on over the step.
    pub const SHIFT: usize = 6;
    /// Of the logarithm of the range.
    pub const RANGE: usize = 8;
    /// Of turns about the print's x and y.
    pub const TILT: usize = 9;
    /// Of a turn about the normal.
    pub const YAW: usize = 11;
}

/// All products' sums.
pub type Products = SMatrix<f64, COLUMNS, COLUMNS>;

/// Pixels not yet multiplied, and sums of those that are.
#[derive(Clone, Debug)]
pub struct Sums {
    kept: Vec<[f32; PIXELS]>,
    count: usize,
    lanes: Vec<[f32; LANES]>,
    /// After [`Sums::finish`]: Σ over pixels of column times column.
    pub products: Products,
}

impl Default for Sums {
    fn default() -> Self {
        Self {
            kept: vec![[0.0; PIXELS]; COLUMNS],
            count: 0,
            lanes: vec![[0.0; LANES]; COLUMNS * COLUMNS],
            products: Products::zeros(),
        }
    }
}

/// One vector's place in all columns.
pub struct Columns<'a> {
    sums: &'a mut Sums,
    start: usize,
    lanes: usize,
}

impl Columns<'_> {
    /// Writes one column's values.
    #[inline(always)]
    pub fn put(&mut self, column: usize, values: &[f32]) {
        self.sums.kept[column][self.start..self.start + self.lanes].copy_from_slice(values);
    }

    /// Multiplies, once enough pixels are together.
    #[inline(always)]
    pub fn done<S: Simd>(self, simd: S) {
        if self.sums.count == PIXELS {
            multiply(simd, self.sums);
        }
    }
}

impl Sums {
    /// Back to nothing.
    pub fn clear(&mut self) {
        self.count = 0;
        self.lanes.fill([0.0; LANES]);
    }

    /// The next so many pixels.
    #[inline(always)]
    pub fn next(&mut self, lanes: usize) -> Columns<'_> {
        let start = self.count;
        self.count += lanes;
        Columns { sums: self, start, lanes }
    }

    /// Multiplies what is left, and adds up.
    pub fn finish(&mut self, level: Level) {
        dispatch!(level, simd => multiply(simd, self));
        for row in 0..COLUMNS {
            for column in row / GROUP * GROUP..COLUMNS {
                let sum: f32 = self.lanes[row * COLUMNS + column].iter().sum();
                self.products[(row, column)] = f64::from(sum);
                self.products[(column, row)] = f64::from(sum);
            }
        }
    }
}

#[simd]
fn multiply<S: Simd>(simd: S, sums: &mut Sums) {
    let width = S::f32s::LEN;
    let count = sums.count;
    for first in (0..COLUMNS).step_by(GROUP) {
        for second in (first..COLUMNS).step_by(GROUP) {
            let left: [&[f32]; GROUP] = std::array::from_fn(|i| &sums.kept[first + i][..count]);
            let right: [&[f32]; GROUP] = std::array::from_fn(|i| &sums.kept[second + i][..count]);
            let mut block = [[S::f32s::splat(simd, 0.0); GROUP]; GROUP];
            for start in (0..count).step_by(width) {
                let load = |list: &[f32]| S::f32s::from_slice(simd, &list[start..start + width]);
                let (left, right) = (left.map(load), right.map(load));
                for i in 0..GROUP {
                    for j in 0..GROUP {
                        block[i][j] = left[i].mul_add(right[j], block[i][j]);
                    }
                }
            }
            for (i, row) in block.iter().enumerate() {
                for (j, value) in row.iter().enumerate() {
                    let sum = &mut sums.lanes[(first + i) * COLUMNS + second + j][..width];
                    (S::f32s::from_slice(simd, sum) + *value).store_slice(sum);
                }
            }
        }
    }
    sums.count = 0;
}
