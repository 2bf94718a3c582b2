//! Numbers side by side: one body of mathematics for one case and for several at once.
//!
//! A function over [`Lane`] is the same for `f64` and for a vector of them, one case in each lane: it has no
//! branch that depends on a number, but masks and selections, so that in every lane just those
//! operations are done that would be done alone. Nothing is fused, hence the results are the same to
//! the last bit (`pose::closed::tests::every_simd_level_gives_the_same_poses`).
//!
//! Everything here is `inline(always)`, and so has to be what is written over it: vector instructions
//! are those of the function marked with `#[simd]` that all of it ends up in. A plain closure or
//! `array::map` in between would be compiled for any processor, and called.
//!
//! Vectors and matrices of up to three numbers are here as well, since nalgebra's need numbers that know
//! their zero, which a vector of the processor at hand does not.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

use fearless_simd::{
    Select, Simd, SimdBase, SimdFloat, SimdMask, f64x4, f64x8, mask64x4, mask64x8,
};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Truth, one for each lane.
pub trait Mask: Copy + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self> {
    /// In one lane.
    fn is_set(self, lane: usize) -> bool;
    /// Whether it is in any.
    fn any(self) -> bool;
}

/// A number, or one for each lane.
pub trait Lane:
    Copy
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
{
    type Mask: Mask;
    /// What a function gives for each lane, by its number.
    fn each<const N: usize>(self, of: impl FnMut(usize) -> [f64; N]) -> [Self; N];
    /// The same number in all lanes, as many as this has.
    fn splat(self, value: f64) -> Self;
    /// The number in one lane.
    fn lane(self, lane: usize) -> f64;
    fn root(self) -> Self;
    fn size(self) -> Self;
    fn below(self, other: Self) -> Self::Mask;
    fn at_most(self, other: Self) -> Self::Mask;
    fn choose(mask: Self::Mask, yes: Self, no: Self) -> Self;

    /// `of` divided by this.
    #[inline(always)]
    fn under(self, of: f64) -> Self {
        self.splat(of) / self
    }

    #[inline(always)]
    fn squared(self) -> Self {
        self * self
    }

    /// Whether it is above zero.
    #[inline(always)]
    fn is_positive(self) -> Self::Mask {
        self.splat(0.0).below(self)
    }

    /// The larger one; the other one where this is not a number.
    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        Self::choose(other.below(self), self, other)
    }

    /// Sine and cosine of an angle of up to π/2 to either side, exact to 2e-15.
    ///
    /// The series up to the fifteenth power at half of it, then doubled.
    #[inline(always)]
    fn sine_and_cosine(self) -> (Self, Self) {
        let half = self * 0.5;
        let s = half * half;
        let mut sin = s * (-1.0 / 210.0) + 1.0;
        let mut cos = s * (-1.0 / 182.0) + 1.0;
        for k in [6.0, 5.0, 4.0, 3.0, 2.0, 1.0] {
            sin = sin * s * (-1.0 / (2.0 * k * (2.0 * k + 1.0))) + 1.0;
            cos = cos * s * (-1.0 / (2.0 * k * (2.0 * k - 1.0))) + 1.0;
        }
        let sin = sin * half;
        (sin * cos * 2.0, sin * sin * -2.0 + 1.0)
    }

    /// eˣ, exact to 1e-12 of itself for |x| ≤ 40; what is beyond is taken for that.
    ///
    /// The series up to the seventh power at x/1024, then squared ten times.
    #[inline(always)]
    fn exponential(self) -> Self {
        let held = Self::choose(self.below(self.splat(40.0)), self, self.splat(40.0));
        let x = held.larger(self.splat(-40.0)) * (1.0 / 1024.0);
        let mut value = x * (1.0 / 7.0) + 1.0;
        value = value * x * (1.0 / 6.0) + 1.0;
        value = value * x * (1.0 / 5.0) + 1.0;
        value = value * x * (1.0 / 4.0) + 1.0;
        value = value * x * (1.0 / 3.0) + 1.0;
        value = value * x * 0.5 + 1.0;
        value = value * x + 1.0;
        for _ in 0..10 {
            value = value * value;
        }
        value
    }
}

impl Mask for bool {
    #[inline(always)]
    fn is_set(self, _: usize) -> bool {
        self
    }

    #[inline(always)]
    fn any(self) -> bool {
        self
    }
}

impl Lane for f64 {
    type Mask = bool;

    #[inline(always)]
    fn each<const N: usize>(self, mut of: impl FnMut(usize) -> [f64; N]) -> [Self; N] {
        of(0)
    }

    #[inline(always)]
    fn splat(self, value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        self
    }

    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn size(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn below(self, other: Self) -> bool {
        self < other
    }

    #[inline(always)]
    fn at_most(self, other: Self) -> bool {
        self <= other
    }

    #[inline(always)]
    fn choose(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
}

macro_rules! lanes {
    ($vector:ident, $mask:ident, $count:literal) => {
        impl<S: Simd> Mask for $mask<S> {
            #[inline(always)]
            fn is_set(self, lane: usize) -> bool {
                self.to_bitmask() >> lane & 1 != 0
            }

            #[inline(always)]
            fn any(self) -> bool {
                self.any_true()
            }
        }

        impl<S: Simd> Lane for $vector<S> {
            type Mask = $mask<S>;

            #[inline(always)]
            fn each<const N: usize>(self, mut of: impl FnMut(usize) -> [f64; N]) -> [Self; N] {
                let mut vectors = [self; N];
                for lane in 0..$count {
                    let values = of(lane);
                    for (vector, value) in vectors.iter_mut().zip(values) {
                        vector[lane] = value;
                    }
                }
                vectors
            }

            #[inline(always)]
            fn splat(self, value: f64) -> Self {
                SimdBase::splat(self.simd, value)
            }

            #[inline(always)]
            fn lane(self, lane: usize) -> f64 {
                self[lane]
            }

            #[inline(always)]
            fn root(self) -> Self {
                SimdFloat::sqrt(self)
            }

            #[inline(always)]
            fn size(self) -> Self {
                SimdBase::abs(self)
            }

            #[inline(always)]
            fn below(self, other: Self) -> Self::Mask {
                SimdBase::simd_lt(self, other)
            }

            #[inline(always)]
            fn at_most(self, other: Self) -> Self::Mask {
                SimdBase::simd_le(self, other)
            }

            #[inline(always)]
            fn choose(mask: Self::Mask, yes: Self, no: Self) -> Self {
                mask.select(yes, no)
            }
        }
    };
}
lanes!(f64x4, mask64x4, 4);
lanes!(f64x8, mask64x8, 8);

/// (x, y).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vec2<T> {
    pub x: T,
    pub y: T,
}

/// (x, y, z).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vec3<T> {
    pub x: T,
    pub y: T,
    pub z: T,
}

/// Row by row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mat2<T> {
    pub m11: T,
    pub m12: T,
    pub m21: T,
    pub m22: T,
}

/// By its rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mat3<T>(pub [Vec3<T>; 3]);

impl<T: Lane> Vec2<T> {
    #[inline(always)]
    pub fn new(x: T, y: T) -> Self {
        Self { x, y }
    }

    #[inline(always)]
    pub fn dot(self, other: Self) -> T {
        self.x * other.x + self.y * other.y
    }

    #[inline(always)]
    pub fn square(self) -> T {
        self.dot(self)
    }

    #[inline(always)]
    pub fn push(self, z: T) -> Vec3<T> {
        Vec3 { x: self.x, y: self.y, z }
    }

    #[inline(always)]
    pub fn choose(mask: T::Mask, yes: Self, no: Self) -> Self {
        Self { x: T::choose(mask, yes.x, no.x), y: T::choose(mask, yes.y, no.y) }
    }

    #[inline(always)]
    pub fn lane(self, lane: usize) -> Vec2<f64> {
        Vec2 { x: self.x.lane(lane), y: self.y.lane(lane) }
    }
}

impl<T: Lane> Add for Vec2<T> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y }
    }
}

impl<T: Lane> Sub for Vec2<T> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y }
    }
}

impl<T: Lane> Neg for Vec2<T> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self { x: -self.x, y: -self.y }
    }
}

impl<T: Lane> Mul<T> for Vec2<T> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, by: T) -> Self {
        Self { x: self.x * by, y: self.y * by }
    }
}

impl<T: Lane> Vec3<T> {
    #[inline(always)]
    pub fn new(x: T, y: T, z: T) -> Self {
        Self { x, y, z }
    }

    #[inline(always)]
    pub fn dot(self, other: Self) -> T {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    #[inline(always)]
    pub fn square(self) -> T {
        self.dot(self)
    }

    #[inline(always)]
    pub fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    #[inline(always)]
    pub fn xy(self) -> Vec2<T> {
        Vec2 { x: self.x, y: self.y }
    }

    #[inline(always)]
    pub fn choose(mask: T::Mask, yes: Self, no: Self) -> Self {
        Self {
            x: T::choose(mask, yes.x, no.x),
            y: T::choose(mask, yes.y, no.y),
            z: T::choose(mask, yes.z, no.z),
        }
    }

    #[inline(always)]
    pub fn lane(self, lane: usize) -> Vec3<f64> {
        Vec3 { x: self.x.lane(lane), y: self.y.lane(lane), z: self.z.lane(lane) }
    }
}

impl<T: Lane> Add for Vec3<T> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl<T: Lane> Sub for Vec3<T> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

impl<T: Lane> Mul<T> for Vec3<T> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, by: T) -> Self {
        Self { x: self.x * by, y: self.y * by, z: self.z * by }
    }
}

impl<T: Lane> Mat2<T> {
    #[inline(always)]
    pub fn new(m11: T, m12: T, m21: T, m22: T) -> Self {
        Self { m11, m12, m21, m22 }
    }

    #[inline(always)]
    pub fn of_columns(first: Vec2<T>, second: Vec2<T>) -> Self {
        Self { m11: first.x, m12: second.x, m21: first.y, m22: second.y }
    }

    #[inline(always)]
    pub fn columns(self) -> [Vec2<T>; 2] {
        [Vec2::new(self.m11, self.m21), Vec2::new(self.m12, self.m22)]
    }

    #[inline(always)]
    pub fn determinant(self) -> T {
        self.m11 * self.m22 - self.m12 * self.m21
    }

    /// The inverse, and where there is one.
    #[inline(always)]
    pub fn inverse(self) -> (Self, T::Mask) {
        let determinant = self.determinant();
        let per = determinant.under(1.0);
        let inverse = Self::new(self.m22 * per, -self.m12 * per, -self.m21 * per, self.m11 * per);
        (inverse, determinant.size().is_positive())
    }

    #[inline(always)]
    pub fn times(self, other: Self) -> Self {
        let [first, second] = other.columns();
        Self::of_columns(self * first, self * second)
    }

    /// M Mᵀ.
    #[inline(always)]
    pub fn square(self) -> Self {
        let mixed = self.m11 * self.m21 + self.m12 * self.m22;
        Self::new(
            self.m11 * self.m11 + self.m12 * self.m12,
            mixed,
            mixed,
            self.m21 * self.m21 + self.m22 * self.m22,
        )
    }

    #[inline(always)]
    pub fn choose(mask: T::Mask, yes: Self, no: Self) -> Self {
        let [a, b] = yes.columns();
        let [c, d] = no.columns();
        Self::of_columns(Vec2::choose(mask, a, c), Vec2::choose(mask, b, d))
    }

    #[inline(always)]
    pub fn lane(self, lane: usize) -> Mat2<f64> {
        Mat2 {
            m11: self.m11.lane(lane),
            m12: self.m12.lane(lane),
            m21: self.m21.lane(lane),
            m22: self.m22.lane(lane),
        }
    }
}

impl<T: Lane> Mul<Vec2<T>> for Mat2<T> {
    type Output = Vec2<T>;

    #[inline(always)]
    fn mul(self, v: Vec2<T>) -> Vec2<T> {
        Vec2::new(self.m11 * v.x + self.m12 * v.y, self.m21 * v.x + self.m22 * v.y)
    }
}

impl<T: Lane> Mat3<T> {
    #[inline(always)]
    pub fn transpose(self) -> Self {
        let [a, b, c] = self.0;
        Self([Vec3::new(a.x, b.x, c.x), Vec3::new(a.y, b.y, c.y), Vec3::new(a.z, b.z, c.z)])
    }

    #[inline(always)]
    pub fn times(self, other: Self) -> Self {
        let [a, b, c] = other.transpose().0;
        Self([self * a, self * b, self * c]).transpose()
    }

    #[inline(always)]
    pub fn lane(self, lane: usize) -> Mat3<f64> {
        Mat3([self.0[0].lane(lane), self.0[1].lane(lane), self.0[2].lane(lane)])
    }
}

impl<T: Lane> Mul<Vec3<T>> for Mat3<T> {
    type Output = Vec3<T>;

    #[inline(always)]
    fn mul(self, v: Vec3<T>) -> Vec3<T> {
        Vec3::new(self.0[0].dot(v), self.0[1].dot(v), self.0[2].dot(v))
    }
}

impl From<Vec2<f64>> for Vector2<f64> {
    #[inline(always)]
    fn from(v: Vec2<f64>) -> Self {
        Self::new(v.x, v.y)
    }
}

impl From<Vec3<f64>> for Vector3<f64> {
    #[inline(always)]
    fn from(v: Vec3<f64>) -> Self {
        Self::new(v.x, v.y, v.z)
    }
}

impl From<Mat2<f64>> for Matrix2<f64> {
    #[inline(always)]
    fn from(m: Mat2<f64>) -> Self {
        Self::new(m.m11, m.m12, m.m21, m.m22)
    }
}

impl From<Mat3<f64>> for Matrix3<f64> {
    #[inline(always)]
    fn from(Mat3([x, y, z]): Mat3<f64>) -> Self {
        Self::new(x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn sines_and_cosines_are_exact(x in -1.571..1.571f64) {
            let (sin, cos) = x.sine_and_cosine();
            prop_assert!((sin - x.sin()).abs() < 2e-15 && (cos - x.cos()).abs() < 2e-15, "{x}");
        }

        #[test]
        fn exponentials_are_exact(x in -40.0..40.0f64) {
            let off = x.exponential() / x.exp() - 1.0;
            prop_assert!(off.abs() < 1e-12, "{x}: {off}");
        }
    }

    #[test]
    fn exponentials_end_where_they_are_held() {
        assert_eq!((-1e3f64).exponential(), (-40f64).exponential());
        assert_eq!(1e3f64.exponential(), 40f64.exponential());
    }
}
