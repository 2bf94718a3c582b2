//! 3×3 blocks as three columns in vectors, so that a product is nine steps of multiply and add.
//!
//! A column is four wide; what its last lane holds means nothing, and stays out of the others. There are no
//! closures here: they would not be part of the function that has the vector instructions.

use fearless_simd::{Simd, SimdBase, SimdFloat, f64x4};
use nalgebra::{Matrix3, Vector3};

/// A 3×3 matrix.
#[derive(Clone, Copy)]
pub(super) struct Block<S: Simd>([f64x4<S>; 3]);

/// Its numbers, column by column.
pub(super) type Numbers = [[f64; 4]; 3];

impl<S: Simd> Block<S> {
    #[inline(always)]
    pub(super) fn of(simd: S, matrix: &Matrix3<f64>) -> Self {
        let numbers = matrix.as_slice();
        Self([
            f64x4::from_slice(simd, &numbers[..4]),
            f64x4::from_slice(simd, &numbers[3..7]),
            column(simd, [matrix.m13, matrix.m23, matrix.m33]),
        ])
    }

    /// Of the transpose.
    #[inline(always)]
    pub(super) fn of_transposed(simd: S, matrix: &Matrix3<f64>) -> Self {
        let m = matrix;
        Self([
            column(simd, [m.m11, m.m12, m.m13]),
            column(simd, [m.m21, m.m22, m.m23]),
            column(simd, [m.m31, m.m32, m.m33]),
        ])
    }

    /// Of its columns.
    #[inline(always)]
    pub(super) fn of_columns(simd: S, [x, y, z]: [[f64; 3]; 3]) -> Self {
        Self([column(simd, x), column(simd, y), column(simd, z)])
    }

    /// Of what [`Self::numbers`] gave.
    #[inline(always)]
    pub(super) fn of_numbers(simd: S, [x, y, z]: &Numbers) -> Self {
        Self([
            f64x4::load_array_ref(simd, x),
            f64x4::load_array_ref(simd, y),
            f64x4::load_array_ref(simd, z),
        ])
    }

    #[inline(always)]
    pub(super) fn numbers(self) -> Numbers {
        let mut numbers = [[0.0; 4]; 3];
        self.0[0].store_array(&mut numbers[0]);
        self.0[1].store_array(&mut numbers[1]);
        self.0[2].store_array(&mut numbers[2]);
        numbers
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
        // Each overwrites the meaningless lane of the one before.
        self.0[0].store_slice(&mut to[..4]);
        self.0[1].store_slice(&mut to[3..7]);
        to[6..].copy_from_slice(&last[..3]);
    }

    #[inline(always)]
    pub(super) fn sum(self, other: Self) -> Self {
        Self([self.0[0] + other.0[0], self.0[1] + other.0[1], self.0[2] + other.0[2]])
    }

    #[inline(always)]
    pub(super) fn plus_scaled(self, other: Self, by: f64) -> Self {
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

    /// This one times a matrix.
    #[inline(always)]
    pub(super) fn times(self, right: &Matrix3<f64>) -> Self {
        let m = right;
        Self([
            self.combined([m.m11, m.m21, m.m31]),
            self.combined([m.m12, m.m22, m.m32]),
            self.combined([m.m13, m.m23, m.m33]),
        ])
    }

    /// This one and `left` · `right`ᵀ.
    #[inline(always)]
    pub(super) fn plus(self, left: Self, right: &Matrix3<f64>) -> Self {
        let m = right;
        Self([
            left.added_to(self.0[0], [m.m11, m.m12, m.m13]),
            left.added_to(self.0[1], [m.m21, m.m22, m.m23]),
            left.added_to(self.0[2], [m.m31, m.m32, m.m33]),
        ])
    }

    /// The same with a right one as numbers.
    #[inline(always)]
    pub(super) fn plus_by(self, left: Self, right: &Numbers) -> Self {
        let [x, y, z] = right;
        Self([
            left.added_to(self.0[0], [x[0], y[0], z[0]]),
            left.added_to(self.0[1], [x[1], y[1], z[1]]),
            left.added_to(self.0[2], [x[2], y[2], z[2]]),
        ])
    }

    /// The product with a vector.
    #[inline(always)]
    pub(super) fn times_vector(self, vector: &Vector3<f64>) -> Vector3<f64> {
        let mut product = [0.0; 4];
        self.combined([vector.x, vector.y, vector.z]).store_array(&mut product);
        Vector3::new(product[0], product[1], product[2])
    }

    #[inline(always)]
    fn combined(self, [x, y, z]: [f64; 3]) -> f64x4<S> {
        self.0[2].mul_add(z, self.0[1].mul_add(y, self.0[0] * x))
    }

    #[inline(always)]
    fn added_to(self, sum: f64x4<S>, [x, y, z]: [f64; 3]) -> f64x4<S> {
        self.0[2].mul_add(z, self.0[1].mul_add(y, self.0[0].mul_add(x, sum)))
    }
}

#[inline(always)]
fn column<S: Simd>(simd: S, [x, y, z]: [f64; 3]) -> f64x4<S> {
    f64x4::load_array(simd, [x, y, z, 0.0])
}
