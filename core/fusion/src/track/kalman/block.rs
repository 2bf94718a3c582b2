//! 3×3 matrices as three SIMD columns; a product takes nine multiply-add steps.
//!
//! A column is four lanes wide; the last lane is undefined and never mixes with the others. There are no closures: a
//! closure would not be compiled with the vector instructions of the function around it.

use fearless_simd::{Simd, SimdBase, SimdFloat, f64x4};
use nalgebra::{Matrix3, Vector3};

#[derive(Clone, Copy)]
pub(super) struct Block<S: Simd>([f64x4<S>; 3]);

/// Columns of a matrix, each padded to four numbers.
pub(super) type Columns = [[f64; 4]; 3];

/// Two 3×3 matrices, the rows of value and rate of a 6×3 matrix.
#[derive(Clone, Copy)]
pub(super) struct StateBlocks<S: Simd> {
    pub(super) value: Block<S>,
    pub(super) rate: Block<S>,
}

/// The same as columns.
#[derive(Clone, Copy)]
pub(super) struct StateColumns {
    pub(super) value: Columns,
    pub(super) rate: Columns,
}

impl<S: Simd> StateBlocks<S> {
    #[inline(always)]
    pub(super) fn from_columns(simd: S, columns: &StateColumns) -> Self {
        Self {
            value: Block::from_array(simd, &columns.value),
            rate: Block::from_array(simd, &columns.rate),
        }
    }

    #[inline(always)]
    pub(super) fn to_columns(self) -> StateColumns {
        StateColumns { value: self.value.to_array(), rate: self.rate.to_array() }
    }

    #[inline(always)]
    pub(super) fn scaled(self, by: f64) -> Self {
        Self { value: self.value.scaled(by), rate: self.rate.scaled(by) }
    }
}

impl<S: Simd> Block<S> {
    #[inline(always)]
    pub(super) fn from_matrix(simd: S, matrix: &Matrix3<f64>) -> Self {
        let to_array = matrix.as_slice();
        Self([
            f64x4::from_slice(simd, &to_array[..4]),
            f64x4::from_slice(simd, &to_array[3..7]),
            column(simd, [matrix.m13, matrix.m23, matrix.m33]),
        ])
    }

    #[inline(always)]
    pub(super) fn from_transposed(simd: S, matrix: &Matrix3<f64>) -> Self {
        let m = matrix;
        Self([
            column(simd, [m.m11, m.m12, m.m13]),
            column(simd, [m.m21, m.m22, m.m23]),
            column(simd, [m.m31, m.m32, m.m33]),
        ])
    }

    #[inline(always)]
    pub(super) fn from_columns(simd: S, [x, y, z]: [[f64; 3]; 3]) -> Self {
        Self([column(simd, x), column(simd, y), column(simd, z)])
    }

    /// Inverse of [`Self::to_array`].
    #[inline(always)]
    pub(super) fn from_array(simd: S, [x, y, z]: &Columns) -> Self {
        Self([
            f64x4::load_array_ref(simd, x),
            f64x4::load_array_ref(simd, y),
            f64x4::load_array_ref(simd, z),
        ])
    }

    #[inline(always)]
    pub(super) fn to_array(self) -> Columns {
        let mut to_array = [[0.0; 4]; 3];
        self.0[0].store_array(&mut to_array[0]);
        self.0[1].store_array(&mut to_array[1]);
        self.0[2].store_array(&mut to_array[2]);
        to_array
    }

    #[inline(always)]
    pub(super) fn matrix(self) -> Matrix3<f64> {
        let mut matrix = Matrix3::zeros();
        self.write(&mut matrix);
        matrix
    }

    #[inline(always)]
    pub(super) fn write(self, to: &mut Matrix3<f64>) {
        let mut last = [0.0; 4];
        self.0[2].store_array(&mut last);
        let to = to.as_mut_slice();
        // Each store overwrites the undefined lane of the one before.
        self.0[0].store_slice(&mut to[..4]);
        self.0[1].store_slice(&mut to[3..7]);
        to[6..].copy_from_slice(&last[..3]);
    }

    #[inline(always)]
    pub(super) fn add(self, other: Self) -> Self {
        Self([self.0[0] + other.0[0], self.0[1] + other.0[1], self.0[2] + other.0[2]])
    }

    #[inline(always)]
    pub(super) fn add_scaled(self, other: Self, by: f64) -> Self {
        Self([
            other.0[0].mul_add(by, self.0[0]),
            other.0[1].mul_add(by, self.0[1]),
            other.0[2].mul_add(by, self.0[2]),
        ])
    }

    #[inline(always)]
    pub(super) fn scaled(self, by: f64) -> Self {
        Self([self.0[0] * by, self.0[1] * by, self.0[2] * by])
    }

    /// Product `self` · `right`.
    #[inline(always)]
    pub(super) fn times(self, right: &Matrix3<f64>) -> Self {
        let m = right;
        Self([
            self.linear_combination([m.m11, m.m21, m.m31]),
            self.linear_combination([m.m12, m.m22, m.m32]),
            self.linear_combination([m.m13, m.m23, m.m33]),
        ])
    }

    /// `self` + `left` · `right`ᵀ.
    #[inline(always)]
    pub(super) fn add_product(self, left: Self, right: &Matrix3<f64>) -> Self {
        let m = right;
        Self([
            left.accumulate(self.0[0], [m.m11, m.m12, m.m13]),
            left.accumulate(self.0[1], [m.m21, m.m22, m.m23]),
            left.accumulate(self.0[2], [m.m31, m.m32, m.m33]),
        ])
    }

    /// `self` + `left` · `right`ᵀ.
    #[inline(always)]
    pub(super) fn add_product_with_array(self, left: Self, right: &Columns) -> Self {
        let [x, y, z] = right;
        Self([
            left.accumulate(self.0[0], [x[0], y[0], z[0]]),
            left.accumulate(self.0[1], [x[1], y[1], z[1]]),
            left.accumulate(self.0[2], [x[2], y[2], z[2]]),
        ])
    }

    #[inline(always)]
    pub(super) fn times_vector(self, vector: &Vector3<f64>) -> Vector3<f64> {
        let mut product = [0.0; 4];
        self.linear_combination([vector.x, vector.y, vector.z]).store_array(&mut product);
        Vector3::new(product[0], product[1], product[2])
    }

    #[inline(always)]
    fn linear_combination(self, [x, y, z]: [f64; 3]) -> f64x4<S> {
        self.0[2].mul_add(z, self.0[1].mul_add(y, self.0[0] * x))
    }

    #[inline(always)]
    fn accumulate(self, sum: f64x4<S>, [x, y, z]: [f64; 3]) -> f64x4<S> {
        self.0[2].mul_add(z, self.0[1].mul_add(y, self.0[0].mul_add(x, sum)))
    }
}

#[inline(always)]
fn column<S: Simd>(simd: S, [x, y, z]: [f64; 3]) -> f64x4<S> {
    f64x4::load_array(simd, [x, y, z, 0.0])
}
