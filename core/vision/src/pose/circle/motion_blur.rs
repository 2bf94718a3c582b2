//! Motion within the exposure, which both rims share, in the closed form.
//!
//! Even motion by m while the shutter is open extends the second moments of an area along m: m mᵀ/3
//! adds to A Aᵀ of either rim, whatever its size, whereas a tilt adds in proportion to the size.
//! Its traceless part N = ν₁ diag(1, -1) + ν₂ offdiag(1, 1) looks like a tilt, a larger one for the
//! smaller rim, which makes ν observable: two unknowns that both rims share, in the plane z = 1 of
//! the local frame.
//!
//! With s the derivatives of the harmonics by ν, the other symbols of [`super::refine`], and C = (Σ
//! Jᵀ W J)⁻¹, the step without ν is corrected afterwards:
//!
//! u = Σ Jᵀ W s    G = Σ sᵀ W s - uᵀ C u    g = Σ sᵀ W h - uᵀ δx    ν̂ = G⁻¹ g    K = (G + 1/V)⁻¹
//!
//! δx → δx - C u K g    C → C + C u K uᵀ C    misfit → misfit - gᵀ K g
//!
//! **Prior.** The exposure time is unknown, so ν has a zero-mean prior with the variance of its own
//! estimate, V = ½|ν̂|². Still roundels lose a twentieth of their depth precision; rims that
//! contradict each other as motion makes them do are corrected. Lens distortion makes rims
//! contradict each other without motion: the residual of their ellipses (`Rim::residual_shape`) is
//! subtracted from |ν̂|². The error of the moments of rims found by their edges grows with ν: the
//! covariance is multiplied by 1 + ½ m V tr G, m = [`MODEL_ERROR`].
//!
//! **Accuracy** (`roundel-tests`, `tests/robustness.rs`: 20 to 60 px, motion up to 3 px): 91 to 98
//! % of positions and poses inside their 95 % region; without ν it is 67 to 93 % of the poses.
//! Depth errors at 2 to 3 px of motion halve.
//!
//! PERF: `--bench pose`, 30 px, `plumb_bob`: alone 0.59 → 0.70 µs, one of 64 0.16 → 0.18 µs.
//!
//! **Limits.** Rotation within the exposure is not modelled, nor is motion of coded and elliptical
//! discs.

use super::cone::shape_harmonics;
use crate::{
    pose::rim::projection::Rim,
    simd::{Lane, Mat2, Vec3},
};

/// Squared relative error of the moments, per variance of ν.
pub const MODEL_ERROR: f64 = 0.05;
/// ν is observable where the determinant of its information exceeds this share of that with the
/// pose known.
const MIN_DETERMINANT_SHARE: f64 = 1e-5;
/// Longer motion is not treated as motion. |ν| is a sixth of its square.
const MAX_MOTION_PX: f64 = 8.0;

/// Over (α, ln d, w).
pub type Covariance5<T> = [[T; 5]; 5];

/// W s of one rim: size, elongation and turn for either component of ν.
pub type Weighted<T> = [Vec3<T>; 2];

/// Information of both rims about ν.
#[derive(Clone, Copy)]
pub struct MotionBlur<T: Lane> {
    /// Σ sᵀ W s: 11, 12 and 22.
    own: [T; 3],
    /// u, by ln d and w.
    with: [[T; 3]; 2],
    /// Converts ν to pixels² at the outer rim.
    scale_px2: T,
    /// Part of |ν̂|² that lens distortion explains.
    lens_part: T,
    /// False for the rim of an elliptical disc.
    has_shape: T::Mask,
}

/// s of a rim: size, elongation and turn by either component of ν.
#[inline(always)]
fn shape<T: Lane>(i: &Mat2<T>) -> [Vec3<T>; 2] {
    [
        shape_harmonics(
            i.m11 * i.m11 - i.m12 * i.m12,
            i.m11 * i.m21 - i.m12 * i.m22,
            i.m21 * i.m21 - i.m22 * i.m22,
        ),
        shape_harmonics(i.m11 * i.m12 * 2.0, i.m11 * i.m22 + i.m12 * i.m21, i.m21 * i.m22 * 2.0),
    ]
}

impl<T: Lane> MotionBlur<T> {
    /// `by_lean` are the derivatives of size, elongation and turn by the lean. The outer rim comes
    /// first in sums.
    #[inline(always)]
    pub fn new(rim: &Rim<T>, by_lean: &[Vec3<T>; 2]) -> (Self, Weighted<T>) {
        let w = &rim.information;
        let shape = shape(&rim.inverse);
        let (one, two) = (w.times_shape(shape[0]), w.times_shape(shape[1]));
        let own = [shape[0].dot(one), shape[0].dot(two), shape[1].dot(two)];
        let with = [
            [-one.x, by_lean[0].dot(one), by_lean[1].dot(one)],
            [-two.x, by_lean[0].dot(two), by_lean[1].dot(two)],
        ];
        let scale_px2 = rim.inverse.determinant().size() * rim.area_px2;
        let lens_part = rim.residual_shape * rim.shape.determinant();
        let has_shape = w.elongation.is_positive();
        (Self { own, with, scale_px2, lens_part, has_shape }, [one, two])
    }

    #[inline(always)]
    pub fn plus(mut self, other: &Self) -> Self {
        self.has_shape = self.has_shape & other.has_shape;
        for k in 0..3 {
            self.own[k] = self.own[k] + other.own[k];
            for j in 0..2 {
                self.with[j][k] = self.with[j][k] + other.with[j][k];
            }
        }
        self
    }

    /// Corrects a step at a circle (`sign` 1) or at its mirror image (-1); `gradient` is Σ sᵀ W h.
    /// Returns the decrease of the misfit.
    #[inline(always)]
    pub fn marginalize(
        &self,
        gradient: [T; 2],
        sign: f64,
        change: &mut [T; 5],
        covariance: &mut Covariance5<T>,
    ) -> T {
        let [one, two] = self.with.map(
            #[inline(always)]
            |u| [u[0], u[1] * sign, u[2] * sign],
        );
        let (c_one, c_two) = (times(covariance, &one), times(covariance, &two));
        let dot = |u: &[T; 3], x: &[T; 5]| u[0] * x[2] + u[1] * x[3] + u[2] * x[4];
        let g11 = self.own[0] - dot(&one, &c_one);
        let g12 = self.own[1] - dot(&one, &c_two);
        let g22 = self.own[2] - dot(&two, &c_two);
        let g = [gradient[0] - dot(&one, change), gradient[1] - dot(&two, change)];
        let determinant = g11 * g22 - g12 * g12;
        let per = determinant.under(1.0);
        let estimate = [(g22 * g[0] - g12 * g[1]) * per, (g11 * g[1] - g12 * g[0]) * per];
        let square = estimate[0] * estimate[0] + estimate[1] * estimate[1];
        let max_px2 = MAX_MOTION_PX * MAX_MOTION_PX / 6.0;
        let is_motion = (square * self.scale_px2.squared()).below(square.splat(max_px2 * max_px2));
        let observable = self.has_shape
            & is_motion
            & (self.own[0] * self.own[2] * MIN_DETERMINANT_SHARE).below(determinant);
        let zero = square.splat(0.0);
        let prior = T::choose(observable, (square - self.lens_part).larger(zero) * 0.5, zero);
        // K = V (V G + 1)⁻¹, zero where V is.
        let (a11, a12, a22) = (prior * g11 + 1.0, prior * g12, prior * g22 + 1.0);
        let by = prior * (a11 * a22 - a12 * a12).under(1.0);
        let (k11, k12, k22) = (a22 * by, -(a12 * by), a11 * by);
        let k = [k11 * g[0] + k12 * g[1], k12 * g[0] + k22 * g[1]];
        for row in 0..5 {
            change[row] = change[row] - c_one[row] * k[0] - c_two[row] * k[1];
            let left = [k11 * c_one[row] + k12 * c_two[row], k12 * c_one[row] + k22 * c_two[row]];
            for column in row..5 {
                let own =
                    covariance[row][column] + left[0] * c_one[column] + left[1] * c_two[column];
                (covariance[row][column], covariance[column][row]) = (own, own);
            }
        }
        let model_error = prior * (g11 + g22) * (0.5 * MODEL_ERROR) + 1.0;
        for row in covariance.iter_mut() {
            for value in row {
                *value = *value * model_error;
            }
        }
        g[0] * k[0] + g[1] * k[1]
    }
}

/// C u.
#[inline(always)]
fn times<T: Lane>(covariance: &Covariance5<T>, u: &[T; 3]) -> [T; 5] {
    let mut product = [u[0]; 5];
    for (product, c) in product.iter_mut().zip(covariance) {
        *product = c[2] * u[0] + c[3] * u[1] + c[4] * u[2];
    }
    product
}

#[cfg(test)]
mod tests {
    use crate::{
        camera::{Lens, PixelPoint},
        ellipse::{Ellipse, Symmetric2},
        marker::{Kind, Ring},
        pose::{
            RimNoise, locate,
            tests::{camera, pose, rim_of},
        },
        rigid::orientation_of_normal,
    };

    /// A rim whose area has moved by m.
    fn smeared(rim: &Ellipse, [u, v]: [f64; 2]) -> Ellipse {
        let (sin, cos) = rim.angle_rad.sin_cos();
        let (a2, b2) = (rim.semi_major_px.powi(2), rim.semi_minor_px.powi(2));
        let moments = Symmetric2 {
            uu: a2 * cos * cos + b2 * sin * sin + u * u / 3.0,
            uv: (a2 - b2) * sin * cos + u * v / 3.0,
            vv: a2 * sin * sin + b2 * cos * cos + v * v / 3.0,
        };
        let (long, short, angle_rad) = moments.eigen();
        Ellipse { semi_major_px: long.sqrt(), semi_minor_px: short.sqrt(), angle_rad, ..*rim }
    }

    #[test]
    fn motion_does_not_tilt_the_normal() {
        let camera = camera(Lens::PlumbBob([0.0; 5]));
        let kind = Kind::plain("", 0.16, 0.064);
        for i in 0..12 {
            let (sin, cos) = (f64::from(i) * 0.55).sin_cos();
            let at = PixelPoint { u: 900.0 + 30.0 * f64::from(i), v: 500.0 };
            // 15 px of semiaxis, from slight to strong tilt.
            let tilt_rad = 0.05 + 0.07 * f64::from(i);
            let (position_m, normal) = pose(&camera, at, 6.0, tilt_rad, 1.0);
            let turn = orientation_of_normal(&normal);
            let rim = |radius_m| {
                smeared(&rim_of(&camera, &position_m, &turn, [radius_m; 2]), [2.5 * cos, 2.5 * sin])
            };
            let ring = Ring::of_rims(rim(0.08), rim(0.032));
            let estimate = locate(&camera, &kind, &ring, &RimNoise::default()).unwrap();
            let off = [estimate.normal, estimate.other_normal].map(|n| n.angle(&normal));
            assert!(off[0].min(off[1]) < 0.06, "{i}: {off:?}");
            let lean = |n: &nalgebra::Vector3<f64>| n.dot(&position_m.normalize()).powi(2);
            let off = lean(&estimate.normal) - lean(&normal);
            // The outer rim alone would be off by 0.01.
            assert!(off.abs() < 3e-3, "{i}: {off}");
        }
    }
}
