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
//! Vectors and matrices of them are in `matrix`.

mod matrix;

use std::{
    f64::consts::{FRAC_PI_2, FRAC_PI_4, PI},
    ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub},
};

use fearless_simd::{
    Select, Simd, SimdBase, SimdFloat, SimdMask, f64x4, f64x8, mask64x4, mask64x8,
};

pub use matrix::{Mat2, Mat3, Vec2, Vec3};

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

    /// The smaller one; the other one where this is not a number.
    #[inline(always)]
    fn smaller(self, other: Self) -> Self {
        Self::choose(self.below(other), self, other)
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

    /// The angle of (`x`, `self`) in [-π, π], exact to 5e-16 of itself; of a place without a direction it is
    /// not a number.
    ///
    /// The quotient of the smaller by the larger one, from 0.66 on turned by an eighth of a circle, in the
    /// fraction of polynomials of Moshier's Cephes (`atan.c`), which is exact to 2e-16 there.
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

/// The whole number at or below one of less than four millions. Unlike a cast, it is done to several at once by the
/// compiler.
#[inline(always)]
pub(crate) fn floor(x: f32) -> i32 {
    // So large that a step of the last bit is 1.
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
    fn exponentials_end_where_they_are_held() {
        assert_eq!((-1e3f64).exponential(), (-40f64).exponential());
        assert_eq!(1e3f64.exponential(), 40f64.exponential());
    }

    #[test]
    fn whole_numbers_are_those_below() {
        for x in [0.0, -0.0, 0.3, 0.5, 0.999_999, 1.0, 1.5, 2.5, 4095.999] {
            assert_eq!([floor(x), floor(-x)], [x.floor() as i32, (-x).floor() as i32], "{x}");
        }
    }
}
