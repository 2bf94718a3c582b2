//! Numeric code that is generic over one value or one value per vector lane.
//!
//! A function over [`Lane`] computes the same for `f64` and, per lane, for a vector of them. It does not branch on
//! values but selects by masks, so every lane performs exactly the operations of the scalar case. Nothing is fused, hence
//! the results are identical to the last bit (`pose::circle::closed_form::tests::every_simd_level_gives_the_same_poses`).
//!
//! Everything here is `inline(always)`, and callers must be too: the instruction set is that of the enclosing function
//! marked with `#[simd]`. A plain closure or `array::map` in between is compiled for the baseline processor and called.
//!
//! Method names differ from those of `f64` on purpose: an inherent method such as `f64::max` or `f64::exp` would win over
//! the trait's on a concrete `f64` and give other results.
//!
//! `matrix` has vectors and matrices of lanes.

mod matrix;

use std::{
    f64::consts::{FRAC_PI_2, FRAC_PI_4, PI},
    ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub},
};

use fearless_simd::{
    Select, Simd, SimdBase, SimdFloat, SimdMask, f64x4, f64x8, mask64x4, mask64x8,
};

pub use matrix::{Mat2, Mat3, Vec2, Vec3, dot};
pub(crate) use matrix::{arithmetic, lane_by_field};

/// A truth value per lane.
pub trait Mask: Copy + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self> {
    /// The value in one lane.
    fn is_set(self, lane: usize) -> bool;
    /// Whether it is true in any lane.
    fn any(self) -> bool;
}

/// A number per lane.
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
    /// Calls `of` with each lane's index and gathers the results.
    fn each<const N: usize>(self, of: impl FnMut(usize) -> [f64; N]) -> [Self; N];
    /// The same number in all lanes.
    fn splat(self, value: f64) -> Self;
    /// The number in one lane.
    fn lane(self, lane: usize) -> f64;
    fn root(self) -> Self;
    fn size(self) -> Self;
    fn below(self, other: Self) -> Self::Mask;
    fn at_most(self, other: Self) -> Self::Mask;
    fn choose(mask: Self::Mask, yes: Self, no: Self) -> Self;

    /// `of` divided by `self`.
    #[inline(always)]
    fn under(self, of: f64) -> Self {
        self.splat(of) / self
    }

    #[inline(always)]
    fn squared(self) -> Self {
        self * self
    }

    /// Whether it is greater than zero.
    #[inline(always)]
    fn is_positive(self) -> Self::Mask {
        self.splat(0.0).below(self)
    }

    /// The larger of both; `other` where `self` is NaN.
    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        Self::choose(other.below(self), self, other)
    }

    /// The smaller of both; `other` where `self` is NaN.
    #[inline(always)]
    fn smaller(self, other: Self) -> Self {
        Self::choose(self.below(other), self, other)
    }

    /// Sine and cosine of an angle in [-π/2, π/2], accurate to 2e-15: the series to the fifteenth
    /// power at half the angle, then doubled.
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

    /// eˣ with relative error 1e-12, x clamped to [-40, 40]: the series to the seventh power at
    /// x/1024, then squared ten times.
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

    /// `atan2(self, x)`, relative error 5e-16; NaN at the origin.
    ///
    /// The smaller coordinate over the larger one, rotated by π/4 from 0.66 on, goes into the
    /// rational polynomial of Moshier's Cephes (`atan.c`), which is accurate to 2e-16 there.
    #[inline(always)]
    fn angle_from(self, x: Self) -> Self {
        let (long, short) = (x.size().larger(self.size()), x.size().smaller(self.size()));
        let is_diagonal = (long * 0.66).below(short);
        let t = Self::choose(is_diagonal, short - long, short)
            / Self::choose(is_diagonal, short + long, long);
        let s = t * t;
        let upper = ((((s * -8.750_608_600_031_904e-1) - 1.615_753_718_733_365e1) * s
            - 7.500_855_792_314_705e1)
            * s
            - 1.228_866_684_490_136_2e2)
            * s
            - 6.485_021_904_942_025e1;
        let lower = ((((s + 2.485_846_490_142_306_3e1) * s + 1.650_270_098_316_988_5e2) * s
            + 4.328_810_604_912_903e2)
            * s
            + 4.853_903_996_359_137e2)
            * s
            + 1.945_506_571_482_614e2;
        let within = t + t * s * (upper / lower);
        let within = Self::choose(is_diagonal, within + FRAC_PI_4, within);
        let is_steep = x.size().below(self.size());
        let within = Self::choose(is_steep, -within + FRAC_PI_2, within);
        let zero = x.splat(0.0);
        let within = Self::choose(x.below(zero), -within + PI, within);
        Self::choose(self.below(zero), -within, within)
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

/// Floor of a number below four million in magnitude. Unlike a cast, the compiler vectorizes it.
#[inline(always)]
pub(crate) fn floor(x: f32) -> i32 {
    // So large that the unit in the last place is 1.
    const LARGE: f32 = 12_582_912.0;
    let shifted = x + LARGE;
    let nearest = shifted.to_bits() as i32 - LARGE.to_bits() as i32;
    nearest - i32::from(shifted - LARGE > x)
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

        #[test]
        fn angles_are_exact(angle in -3.15..3.15f64, length in 1e-9..1e9f64) {
            let (x, y) = (length * angle.cos(), length * angle.sin());
            let off = y.angle_from(x) / y.atan2(x) - 1.0;
            prop_assert!(off.abs() < 5e-16, "{x} {y}: {off}");
        }
    }

    #[test]
    fn angles_on_the_axes_are_exact() {
        for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 1.0), (-2.0, -2.0)] {
            assert_eq!(f64::angle_from(y, x), y.atan2(x), "{x} {y}");
        }
        assert!(0f64.angle_from(0.0).is_nan());
    }

    #[test]
    fn exponentials_are_clamped() {
        assert_eq!((-1e3f64).exponential(), (-40f64).exponential());
        assert_eq!(1e3f64.exponential(), 40f64.exponential());
    }

    #[test]
    fn floor_rounds_down() {
        for x in [0.0, -0.0, 0.3, 0.5, 0.999_999, 1.0, 1.5, 2.5, 4095.999] {
            assert_eq!([floor(x), floor(-x)], [x.floor() as i32, (-x).floor() as i32], "{x}");
        }
    }
}
