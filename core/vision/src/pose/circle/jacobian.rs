//! Jacobian of both rims' harmonics by the circle, and the normal matrix.
//!
//! Leading terms of the derivatives J of the five harmonics h(x) by x = (α, ln d, w); the omitted
//! terms are smaller by the angular radius r:
//!
//! | | centre c | size h₀ | elongation h₃, turn h₄ |
//! | --- | --- | --- | --- |
//! | α | I | – | – |
//! | ln d | -2 r² n_z w | -1 | – |
//! | w | r² (n_z I - w wᵀ/n_z) | of N = -r² A⁻¹ (e wᵀ + w eᵀ) A⁻ᵀ | likewise |

use super::{
    cone::{Circle, PER_ROOT, shape_harmonics},
    motion_blur::{self, Covariance5, MotionBlur},
};
use crate::{
    pose::rim::projection::Rim,
    simd::{Lane, Mat2, Vec2, Vec3, dot},
};

/// Jacobians at a circle, and the inverse of Σ Jᵀ W J with the rims' information W.
pub struct Linearization<T: Lane> {
    pub rims: [RimJacobian<T>; 2],
    pub covariance: Covariance5<T>,
    /// Where the normal matrix is positive definite.
    pub valid: T::Mask,
    pub blur: MotionBlur<T>,
}

#[derive(Clone, Copy)]
pub struct RimJacobian<T: Lane> {
    /// Derivative of the centre by ln d.
    by_depth: Vec2<T>,
    /// Derivative of the centre by w.
    by_lean: Mat2<T>,
    /// Derivatives of (size, elongation, turn) by either component of w.
    shape_by_lean: [Vec3<T>; 2],
    blur: (MotionBlur<T>, motion_blur::Weighted<T>),
}

impl<T: Lane> Linearization<T> {
    #[inline(always)]
    pub fn new(circle: &Circle<T>, rims: &[Rim<T>; 2]) -> Self {
        let linear = [RimJacobian::new(circle, &rims[0]), RimJacobian::new(circle, &rims[1])];
        let (mut normal, inner) = (linear[0].normal(&rims[0]), linear[1].normal(&rims[1]));
        for row in 0..5 {
            for column in 0..5 {
                normal[row][column] = normal[row][column] + inner[row][column];
            }
        }
        let blur = linear[0].blur.0.plus(&linear[1].blur.0);
        let valid = sweep::<T, 0>(&mut normal)
            & sweep::<T, 1>(&mut normal)
            & sweep::<T, 2>(&mut normal)
            & sweep::<T, 3>(&mut normal)
            & sweep::<T, 4>(&mut normal);
        let mut covariance = normal;
        for row in 0..5 {
            for column in 0..5 {
                covariance[row][column] = -normal[row][column];
            }
        }
        Self { rims: linear, covariance, valid, blur }
    }
}

/// The sweep operator on a symmetric matrix; returns where the pivot is positive. After all pivots
/// the matrix is its inverse with the opposite sign.
#[inline(always)]
fn sweep<T: Lane, const PIVOT: usize>(matrix: &mut Covariance5<T>) -> T::Mask {
    let row = matrix[PIVOT];
    let per_pivot = row[PIVOT].under(1.0);
    for i in 0..5 {
        let by = row[i] * per_pivot;
        for j in i..5 {
            let value = matrix[i][j] - by * row[j];
            (matrix[i][j], matrix[j][i]) = (value, value);
        }
    }
    for i in 0..5 {
        let value = row[i] * per_pivot;
        (matrix[i][PIVOT], matrix[PIVOT][i]) = (value, value);
    }
    matrix[PIVOT][PIVOT] = -per_pivot;
    row[PIVOT].is_positive()
}

impl<T: Lane> RimJacobian<T> {
    #[inline(always)]
    fn new(circle: &Circle<T>, rim: &Rim<T>) -> Self {
        let r2 = (rim.radius_m / circle.depth_m).squared();
        let (w, normal_z, i) = (circle.lean, circle.normal_z(), &rim.inverse);
        let bend = -r2 / normal_z;
        let level = r2 * normal_z;
        let mixed = bend * w.x * w.y;
        let by_lean = Mat2::new(level + bend * w.x * w.x, mixed, mixed, level + bend * w.y * w.y);
        let v = *i * w * r2;
        let mut shape_by_lean = [Vec3::new(r2, r2, r2); 2];
        for (shape, p) in shape_by_lean.iter_mut().zip(i.columns()) {
            let (n11, n22) = (p.x * v.x * -2.0, p.y * v.y * -2.0);
            let n12 = -(p.x * v.y + p.y * v.x);
            *shape = shape_harmonics(n11, n12, n22);
        }
        let blur = MotionBlur::new(rim, &shape_by_lean);
        Self { by_depth: w * (level * -2.0), by_lean, shape_by_lean, blur }
    }

    /// This rim's part of Σ Jᵀ W J.
    #[inline(always)]
    fn normal(&self, rim: &Rim<T>) -> [[T; 5]; 5] {
        let (w, i) = (&rim.information, &rim.inverse);
        // Information about the centre in the plane.
        let (along, across) = (w.along * 0.5, w.across * 0.5);
        let p11 = along * i.m11 * i.m11 + across * i.m21 * i.m21;
        let p12 = along * i.m11 * i.m12 + across * i.m21 * i.m22;
        let p22 = along * i.m12 * i.m12 + across * i.m22 * i.m22;
        let plane = Mat2::new(p11, p12, p12, p22);
        let by_depth = plane * self.by_depth;
        let [t1, t2] = self.by_lean.columns();
        let (pt1, pt2) = (plane * t1, plane * t2);
        let shape = self.shape_by_lean;
        let (first, second) = (w.times_shape(shape[0]), w.times_shape(shape[1]));
        let (d1, d2) = (by_depth.dot(t1) - first.x, by_depth.dot(t2) - second.x);
        let t12 = t1.dot(pt2) + shape[0].dot(second);
        let (d, p, q) = (by_depth, pt1, pt2);
        [
            [p11, p12, d.x, p.x, q.x],
            [p12, p22, d.y, p.y, q.y],
            [d.x, d.y, self.by_depth.dot(d) + w.size, d1, d2],
            [p.x, p.y, d1, t1.dot(p) + shape[0].dot(first), t12],
            [q.x, q.y, d2, t12, t2.dot(q) + shape[1].dot(second)],
        ]
    }

    /// This rim's parts of Σ Jᵀ W h, Σ sᵀ W h and Σ hᵀ W h.
    #[inline(always)]
    pub fn gradient(&self, circle: &Circle<T>, rim: &Rim<T>, sign: f64) -> ([T; 5], [T; 2], T) {
        let left = circle.residuals(rim);
        let weighted = rim.information.times(&left);
        let square = dot(&left, &weighted);
        // Contributions of the centre, in the plane, and of the shape.
        let i = &rim.inverse;
        let gradient = Vec2::new(
            (i.m11 * weighted[1] + i.m21 * weighted[2]) * PER_ROOT,
            (i.m12 * weighted[1] + i.m22 * weighted[2]) * PER_ROOT,
        );
        let [t1, t2] = self.by_lean.columns();
        let shape = Vec3::new(weighted[0], weighted[3], weighted[4]) * square.splat(sign);
        let right = [
            gradient.x,
            gradient.y,
            self.by_depth.dot(gradient) * sign - weighted[0],
            t1.dot(gradient) + shape.dot(self.shape_by_lean[0]),
            t2.dot(gradient) + shape.dot(self.shape_by_lean[1]),
        ];
        let shape = Vec3::new(left[0], left[3], left[4]);
        let blur_gradient = [shape.dot(self.blur.1[0]), shape.dot(self.blur.1[1])];
        (right, blur_gradient, square)
    }
}
