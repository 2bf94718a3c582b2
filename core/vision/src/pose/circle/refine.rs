//! A circle fitted to both rims by Gauss-Newton, with covariance and misfit.
//!
//! The unknowns are x = (α, ln d, w) of [`Circle`]. The residuals h(x) are the five harmonics of
//! both rims, measured less predicted. With their derivatives J ([`super::jacobian`]) and the rims'
//! information W:
//!
//! (Σ Jᵀ W J) δx = Σ Jᵀ W h      misfit = Σ hᵀ W h - δxᵀ Σ Jᵀ W h
//!
//! The start is the circle of the outer rim alone, which the inner rim changes little. One step is
//! enough unless it changes the lean by more than a share of itself, over which the derivative 2w
//! of the elongation changes. Motion within the exposure is corrected after the step
//! ([`super::motion_blur`]).
//!
//! With the mirrored lean -w only the terms of ln d with α and w change sign, so one normal matrix
//! and one inverse serve both circles.

use super::{
    cone::Circle,
    jacobian::Linearization,
    motion_blur::Covariance5,
    tilt_posterior::{self, LeanSpread},
};
use crate::{
    pose::rim::projection::Rim,
    simd::{Lane, Vec3, dot},
};

#[derive(Clone, Copy, Debug)]
pub struct Estimate<T> {
    pub circle: Circle<T>,
    pub covariance: Covariance5<T>,
    /// Squared Mahalanobis length of the residuals of both rims.
    pub misfit: T,
}

/// The more likely circle, the other one, and the likelihood of the first. Where there is only one,
/// `other` equals `first` and the likelihood is 1.
#[derive(Clone, Copy, Debug)]
pub struct Estimates<T> {
    pub first: Estimate<T>,
    pub other: Estimate<T>,
    pub likelihood: T,
}

/// Usually one is enough.
const MAX_STEPS: usize = 10;
/// A step whose square is at most this share of the squared lean is the last one.
const LAST_STEP: f64 = 0.02;

/// Fits both circles to both rims; `None` if both leave the space of circles in front of the
/// camera. The lean of the second start is about that of the first one reversed.
#[inline(always)]
pub fn refine(starts: &[Circle<f64>; 2], rims: &[Rim<f64>; 2]) -> Option<Estimates<f64>> {
    let [first, second] = GaussNewtonStep::both(starts, rims);
    match [first.finish(rims), second.finish(rims)] {
        [Some(a), Some(b)] => Some(Estimates::ordered(&a, &b)),
        // The other one has left the space of circles in front of the camera.
        [Some(only), None] | [None, Some(only)] => Some(Estimates::alone(only)),
        [None, None] => None,
    }
}

/// As [`refine`] with a single step; the mask is set where that step is enough for both circles.
#[inline(always)]
pub fn refine_once<T: Lane>(
    starts: &[Circle<T>; 2],
    rims: &[Rim<T>; 2],
) -> (Estimates<T>, T::Mask) {
    let [a, b] = GaussNewtonStep::both(starts, rims);
    let is_single_step = a.valid & b.valid & a.is_last & b.is_last;
    (Estimates::ordered(&a.estimate, &b.estimate), is_single_step)
}

impl<T: Lane> Estimates<T> {
    #[inline(always)]
    pub fn alone(only: Estimate<T>) -> Self {
        Self { first: only, other: only, likelihood: only.misfit.splat(1.0) }
    }

    /// The two may coincide.
    #[inline(always)]
    fn ordered(a: &Estimate<T>, b: &Estimate<T>) -> Self {
        let swapped = b.misfit.below(a.misfit);
        let first = Estimate::choose(swapped, b, a);
        let other = Estimate::choose(swapped, a, b);
        let odds = ((first.misfit - other.misfit) * 0.5).exponential();
        let likelihood = (odds + 1.0).under(1.0);
        // At close range perspective alone determines the tilt, and both starts converge to one
        // circle.
        let are_two = tilt_posterior::are_distinct(&first.lean(), &other.lean());
        Self {
            first,
            other: Estimate::choose(are_two, &other, &first),
            likelihood: T::choose(are_two, likelihood, odds.splat(1.0)),
        }
    }
}

#[derive(Clone, Copy)]
struct GaussNewtonStep<T: Lane> {
    estimate: Estimate<T>,
    /// Where the result is a circle in front of the camera.
    valid: T::Mask,
    is_last: T::Mask,
}

impl GaussNewtonStep<f64> {
    #[inline(always)]
    fn finish(self, rims: &[Rim<f64>; 2]) -> Option<Estimate<f64>> {
        let mut step = self;
        for _ in 1..MAX_STEPS {
            if !step.valid || step.is_last {
                break;
            }
            let circle = &step.estimate.circle;
            let linear = Linearization::new(circle, rims);
            step = GaussNewtonStep::from(circle, rims, &linear, 1.0);
        }
        step.valid.then_some(step.estimate)
    }
}

impl<T: Lane> GaussNewtonStep<T> {
    #[inline(always)]
    fn both(starts: &[Circle<T>; 2], rims: &[Rim<T>; 2]) -> [Self; 2] {
        let linear = Linearization::new(&starts[0], rims);
        let first = Self::from(&starts[0], rims, &linear, 1.0);
        let second = Self::from(&starts[1], rims, &linear, -1.0);
        [first, second]
    }

    /// With the derivatives at this circle (`sign` 1) or at its mirror image (-1).
    #[inline(always)]
    fn from(circle: &Circle<T>, rims: &[Rim<T>; 2], linear: &Linearization<T>, sign: f64) -> Self {
        let (mut right, mut blur_gradient, mut square) =
            linear.rims[0].gradient(circle, &rims[0], sign);
        let (right_inner, smeared_inner, square_inner) =
            linear.rims[1].gradient(circle, &rims[1], sign);
        square = square + square_inner;
        for k in 0..2 {
            blur_gradient[k] = blur_gradient[k] + smeared_inner[k];
        }
        for k in 0..5 {
            right[k] = right[k] + right_inner[k];
        }
        let mut covariance = linear.covariance;
        // With the mirrored lean only the terms of ln d with α and w change sign.
        for k in [0, 1, 3, 4] {
            covariance[2][k] = covariance[2][k] * sign;
            covariance[k][2] = covariance[k][2] * sign;
        }
        let mut change = right;
        for row in 0..5 {
            change[row] = dot(&covariance[row], &right);
        }
        let explained = dot(&change, &right);
        let fall = linear.blur.marginalize(blur_gradient, sign, &mut change, &mut covariance);
        let tilted = circle.lean.square();
        let (circle, valid) = circle.moved(&change);
        let turned = change[3] * change[3] + change[4] * change[4];
        let misfit = (square - explained - fall).larger(square.splat(0.0));
        // The constant, a microradian squared, ends the iteration for upright circles.
        let is_last = turned.at_most(tilted * LAST_STEP + 1e-12);
        let valid = valid & linear.valid;
        Self { estimate: Estimate { circle, covariance, misfit }, valid, is_last }
    }
}

impl<T: Lane> Estimate<T> {
    #[inline(always)]
    fn lean(&self) -> LeanSpread<T> {
        let c = &self.covariance;
        LeanSpread { mean: self.circle.lean, covariance: [c[3][3], c[3][4], c[4][4]] }
    }

    /// Derivatives of the position by (α, ln d), and of the rotation by w, in the local frame.
    ///
    /// p = d (α, 1); the normal changes by δn = (δw, -(w·δw)/n_z), and the left rotation that
    /// achieves it, without rotation about the normal, is n × δn.
    #[inline(always)]
    pub fn changes(&self) -> ([Vec3<T>; 3], [Vec3<T>; 2]) {
        let depth_m = self.circle.depth_m;
        let normal = self.circle.normal();
        let (zero, one) = (depth_m.splat(0.0), depth_m.splat(1.0));
        let per_facing = normal.z.under(-1.0);
        let place = [
            Vec3::new(depth_m, zero, zero),
            Vec3::new(zero, depth_m, zero),
            self.circle.position_m(),
        ];
        let turns = [
            normal.cross(Vec3::new(one, zero, normal.x * per_facing)),
            normal.cross(Vec3::new(zero, one, normal.y * per_facing)),
        ];
        (place, turns)
    }

    #[inline(always)]
    fn choose(mask: T::Mask, yes: &Self, no: &Self) -> Self {
        let mut covariance = yes.covariance;
        for (row, other) in covariance.iter_mut().zip(&no.covariance) {
            for (own, other) in row.iter_mut().zip(other) {
                *own = T::choose(mask, *own, *other);
            }
        }
        Self {
            circle: Circle::choose(mask, &yes.circle, &no.circle),
            covariance,
            misfit: T::choose(mask, yes.misfit, no.misfit),
        }
    }
}
