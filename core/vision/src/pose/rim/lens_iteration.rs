//! The ellipse of a rim that the lens distorts strongly, by iteration.
//!
//! Eight points of a rim pass through the lens ([`crate::camera::Camera::rays_near`]). The zeroth
//! and first harmonics over t of their images y are the affine part of the lens, averaged over the
//! rim; in its coordinates y is nearly u = (cos t, sin t). The lens maps the line s u from the
//! rim's centre to y(s) = y₀ + s P₁ + s² P₂ + s³ P₃. The ray of the middle gives y₀ and P₁, and y
//! at t and t + π give the even and the odd part. So dy/ds at the rim is known, and with it the
//! crossing of the line with another ellipse, q = (1 - |y|)/(y/|y| · dy/ds) before the unit circle.
//! The ellipse is the unit circle changed so that mean(ψ q) = 0, found by a few iterations. Without
//! distortion q is zero and the ellipse exact. The remaining error is of third order in P₂, by
//! [`RESIDUAL_FACTOR`].

use super::{
    plane_ellipse::{COS, POINTS, PlaneEllipse, SIN, linearized_lens, plane_points},
    rim_pair::RimEllipse,
};
use crate::{
    camera::NearRays,
    simd::{Mat2, Mat3, Vec2},
};

const MAX_ITERATIONS: usize = 8;
/// Change of the ellipse in the last iteration; each one gains two digits.
const SETTLED: f64 = 1e-6;
/// Remaining error of a rim's shape, in cubes of |P₂|: the maximum over rims under the strongest
/// lenses (`tests/golden.rs`), 1.3 for exact ones and 5 for those fitted to points.
const RESIDUAL_FACTOR: f64 = 5.0;

/// The ellipse through the images of the points of the outer (0) or the inner rim (1); `None`
/// if one lies 90° or more from the frame's axis.
#[inline(always)]
pub fn fit(
    near: &NearRays<f64, { 2 * POINTS }>,
    rim: usize,
    rims: &[RimEllipse<f64>; 2],
    base_from_camera: &Option<Mat3<f64>>,
) -> Option<PlaneEllipse<f64>> {
    let own = near.rays.map(|axis| std::array::from_fn(|i| axis[rim * POINTS + i]));
    let ([mut x, mut y], ahead) = plane_points(&own, base_from_camera);
    if !ahead {
        return None;
    }
    let center = Vec2::new(mean(&x, &ONE), mean(&y, &ONE));
    let affine = Mat2::new(
        2.0 * mean(&x, &COS),
        2.0 * mean(&x, &SIN),
        2.0 * mean(&y, &COS),
        2.0 * mean(&y, &SIN),
    );
    let (inverse, true) = affine.inverse() else { return None };
    for i in 0..POINTS {
        let v = inverse * (Vec2::new(x[i], y[i]) - center);
        (x[i], y[i]) = (v.x, v.y);
    }
    let (middle, linear) = linearized_lens(near, rims[0].center, &rims[rim], base_from_camera);
    let (middle, linear) = (inverse * (middle - center), inverse.times(linear));
    // dy/ds = P₁ + 2 P₂ + 3 P₃, with the even part y₀ + P₂ and the odd one P₁ + P₃.
    let (mut along_x, mut along_y) = ([0.0; POINTS], [0.0; POINTS]);
    let mut bending = 0.0;
    for i in 0..POINTS {
        let opposite = (i + POINTS / 2) % POINTS;
        let (even, odd) = (0.5 * (x[i] + x[opposite]), 0.5 * (x[i] - x[opposite]));
        let first = linear.m11 * COS[i] + linear.m12 * SIN[i];
        along_x[i] = 3.0 * odd - 2.0 * first + 2.0 * (even - middle.x);
        bending += (even - middle.x).powi(2);
        let (even, odd) = (0.5 * (y[i] + y[opposite]), 0.5 * (y[i] - y[opposite]));
        let first = linear.m21 * COS[i] + linear.m22 * SIN[i];
        along_y[i] = 3.0 * odd - 2.0 * first + 2.0 * (even - middle.y);
        bending += (even - middle.y).powi(2);
    }
    // The ellipse as the unit circle, moved by `shift` and scaled by `growth`.
    let mut shift = Vec2::new(0.0, 0.0);
    let mut growth = Mat2::new(1.0, 0.0, 0.0, 1.0);
    for _ in 0..MAX_ITERATIONS {
        let (back, true) = growth.inverse() else { return None };
        let mut q = [0.0; POINTS];
        for i in 0..POINTS {
            let (dx, dy) = (x[i] - shift.x, y[i] - shift.y);
            let (dx, dy) = (back.m11 * dx + back.m12 * dy, back.m12 * dx + back.m22 * dy);
            let (ex, ey) = (along_x[i], along_y[i]);
            let (ex, ey) = (back.m11 * ex + back.m12 * ey, back.m12 * ex + back.m22 * ey);
            // |y| - 1 is half of |y|² - 1 less an eighth of its square.
            let excess = dx * dx + dy * dy - 1.0;
            let beyond = excess * (0.5 - 0.125 * excess);
            q[i] = beyond * (1.0 + beyond) / (dx * ex + dy * ey);
        }
        let moved = Vec2::new(2.0 * mean(&q, &COS), 2.0 * mean(&q, &SIN));
        let (size, elongation, turn) =
            (mean(&q, &ONE), 2.0 * mean(&q, &COS_2), 2.0 * mean(&q, &SIN_2));
        shift = shift + moved;
        growth.m11 += size + elongation;
        growth.m12 += turn;
        growth.m21 += turn;
        growth.m22 += size - elongation;
        let change = moved.x.abs() + moved.y.abs() + size.abs() + elongation.abs() + turn.abs();
        if change <= SETTLED {
            break;
        }
    }
    let residual_shape = (bending / POINTS as f64).powi(3) * (RESIDUAL_FACTOR * RESIDUAL_FACTOR);
    Some(PlaneEllipse {
        center: center + affine * shift,
        semiaxes: affine.times(growth),
        residual_shape,
    })
}

#[inline(always)]
fn mean(values: &[f64; POINTS], weights: &[f64; POINTS]) -> f64 {
    let mut sum = 0.0;
    for i in 0..POINTS {
        sum += values[i] * weights[i];
    }
    sum * (1.0 / POINTS as f64)
}

const ONE: [f64; POINTS] = [1.0; POINTS];
/// cos 2t of the points …
const COS_2: [f64; POINTS] = [1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0, 0.0];
/// … and sin 2t.
const SIN_2: [f64; POINTS] = [0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0];
