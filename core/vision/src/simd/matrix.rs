//! Vectors and matrices of two and three numbers per lane.
//!
//! Nalgebra's types need a `Zero` that a runtime-sized vector does not have. Sums are evaluated in the order written, so
//! that each lane equals the scalar result.

use std::ops::Mul;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::simd::Lane;

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

/// Rows first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mat2<T> {
    pub m11: T,
    pub m12: T,
    pub m21: T,
    pub m22: T,
}

/// By rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mat3<T>(pub [Vec3<T>; 3]);

/// Implements `lane` by that of each field.
macro_rules! lane_by_field {
    ($type:ident { $($field:ident),* }) => {
        impl<T: Lane> $type<T> {
            #[inline(always)]
            pub fn lane(&self, lane: usize) -> $type<f64> {
                $type { $($field: self.$field.lane(lane)),* }
            }
        }
    };
}
pub(crate) use lane_by_field;

/// Implements sums and multiples by component.
macro_rules! arithmetic {
    ($type:ident { $($field:ident),* }) => {
        impl<T: Lane> std::ops::Add for $type<T> {
            type Output = Self;

            #[inline(always)]
            fn add(self, other: Self) -> Self {
                Self { $($field: self.$field + other.$field),* }
            }
        }

        impl<T: Lane> std::ops::Sub for $type<T> {
            type Output = Self;

            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                Self { $($field: self.$field - other.$field),* }
            }
        }

        impl<T: Lane> std::ops::Neg for $type<T> {
            type Output = Self;

            #[inline(always)]
            fn neg(self) -> Self {
                Self { $($field: -self.$field),* }
            }
        }

        impl<T: Lane> std::ops::Mul<T> for $type<T> {
            type Output = Self;

            #[inline(always)]
            fn mul(self, by: T) -> Self {
                Self { $($field: self.$field * by),* }
            }
        }
    };
}
pub(crate) use arithmetic;

/// Implements what a vector does by component.
macro_rules! vector {
    ($type:ident { $($field:ident),* }) => {
        arithmetic!($type { $($field),* });
        lane_by_field!($type { $($field),* });

        impl<T: Lane> $type<T> {
            #[inline(always)]
            pub fn new($($field: T),*) -> Self {
                Self { $($field),* }
            }

            #[inline(always)]
            pub fn choose(mask: T::Mask, yes: Self, no: Self) -> Self {
                Self { $($field: T::choose(mask, yes.$field, no.$field)),* }
            }
        }
    };
}
vector!(Vec2 { x, y });
vector!(Vec3 { x, y, z });
lane_by_field!(Mat2 { m11, m12, m21, m22 });

impl<T: Lane> Vec2<T> {
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
}

impl<T: Lane> Vec3<T> {
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

    /// The inverse, and the lanes that have one.
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

/// Sum of the products of two lists.
#[inline(always)]
pub fn dot<T: Lane, const N: usize>(a: &[T; N], b: &[T; N]) -> T {
    let mut sum = a[0] * b[0];
    for i in 1..N {
        sum = sum + a[i] * b[i];
    }
    sum
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
