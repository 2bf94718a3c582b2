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
//!
//! With the rims' information W, Σ Jᵀ W J and its inverse consist of blocks for the place (α, ln d)
//! and the lean.

use super::{
    cone::{Circle, PER_ROOT, shape_harmonics},
    motion_blur::{self, Covariance5, MotionBlur},
};
use crate::{
    pose::rim::projection::Rim,
    simd::{Lane, Mat2, Vec2, Vec3, dot},
};

/// Normal matrix at a circle, with the Jacobians that it is made of.
pub struct Linearization<T: Lane> {
    pub rims: [RimJacobian<T>; 2],
    normal: NormalMatrix<T>,
    pub blur: MotionBlur<T>,
}

/// Blocks of Σ Jᵀ W J.
#[derive(Clone, Copy)]
struct NormalMatrix<T> {
    /// 11, 12, 13, 22, 23 and 33.
    place: [T; 6],
    between: [[T; 2]; 3],
    /// 11, 12 and 22.
    lean: [T; 3],
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
        let normal = linear[0].normal(&rims[0]).plus(&linear[1].normal(&rims[1]));
        let blur = linear[0].blur.0.plus(&linear[1].blur.0);
        Self { rims: linear, normal, blur }
    }

    /// Inverse by the Schur complement of the place, and where the matrix is positive definite.
    #[inline(always)]
    pub fn covariance(&self) -> (Covariance5<T>, T::Mask) {
        let NormalMatrix { place, between: b, lean } = &self.normal;
        let (place, place_valid) = inverse3(place);
        let mut follow = *b;
        for row in 0..3 {
            for k in 0..2 {
                follow[row][k] =
                    place[row][0] * b[0][k] + place[row][1] * b[1][k] + place[row][2] * b[2][k];
            }
        }
        let mut rest = *lean;
        for (rest, (k, l)) in rest.iter_mut().zip([(0, 0), (0, 1), (1, 1)]) {
            *rest =
                *rest - b[0][k] * follow[0][l] - b[1][k] * follow[1][l] - b[2][k] * follow[2][l];
        }
        let [r11, r12, r22] = rest;
        let determinant = r11 * r22 - r12 * r12;
        let per = determinant.under(1.0);
        let (l11, l12, l22) = (r22 * per, -r12 * per, r11 * per);
        let mut all = [[per; 5]; 5];
        (all[3][3], all[3][4], all[4][3], all[4][4]) = (l11, l12, l12, l22);
        for row in 0..3 {
            let cross = (
                -(follow[row][0] * l11 + follow[row][1] * l12),
                -(follow[row][0] * l12 + follow[row][1] * l22),
            );
            (all[row][3], all[3][row]) = (cross.0, cross.0);
            (all[row][4], all[4][row]) = (cross.1, cross.1);
            for column in row..3 {
                let own =
                    place[row][column] - cross.0 * follow[column][0] - cross.1 * follow[column][1];
                (all[row][column], all[column][row]) = (own, own);
            }
        }
        (all, place_valid & determinant.is_positive() & r11.is_positive())
    }
}

impl<T: Lane> NormalMatrix<T> {
    #[inline(always)]
    fn plus(mut self, other: &Self) -> Self {
        for k in 0..6 {
            self.place[k] = self.place[k] + other.place[k];
        }
        for row in 0..3 {
            for k in 0..2 {
                self.between[row][k] = self.between[row][k] + other.between[row][k];
            }
            self.lean[row] = self.lean[row] + other.lean[row];
        }
        self
    }
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
    fn normal(&self, rim: &Rim<T>) -> NormalMatrix<T> {
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
        NormalMatrix {
            place: [p11, p12, by_depth.x, p22, by_depth.y, self.by_depth.dot(by_depth) + w.size],
            between: [
                [pt1.x, pt2.x],
                [pt1.y, pt2.y],
                [by_depth.dot(t1) - first.x, by_depth.dot(t2) - second.x],
            ],
            lean: [
                t1.dot(pt1) + shape[0].dot(first),
                t1.dot(pt2) + shape[0].dot(second),
                t2.dot(pt2) + shape[1].dot(second),
            ],
        }
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

/// Inverse of a symmetric 3 × 3 matrix, given by its upper triangle, and where it is positive
/// definite.
#[inline(always)]
fn inverse3<T: Lane>([m11, m12, m13, m22, m23, m33]: &[T; 6]) -> ([[T; 3]; 3], T::Mask) {
    let (m11, m12, m13, m22, m23, m33) = (*m11, *m12, *m13, *m22, *m23, *m33);
    let c11 = m22 * m33 - m23 * m23;
    let c12 = m13 * m23 - m12 * m33;
    let c13 = m12 * m23 - m13 * m22;
    let determinant = m11 * c11 + m12 * c12 + m13 * c13;
    let c22 = m11 * m33 - m13 * m13;
    let c23 = m12 * m13 - m11 * m23;
    let c33 = m11 * m22 - m12 * m12;
    let per = determinant.under(1.0);
    let (c12, c13, c23) = (c12 * per, c13 * per, c23 * per);
    let inverse = [[c11 * per, c12, c13], [c12, c22 * per, c23], [c13, c23, c33 * per]];
    (inverse, determinant.is_positive() & c33.is_positive() & m11.is_positive())
}
