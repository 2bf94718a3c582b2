//! A circle fitted to both rims, with covariance and misfit.
//!
//! The unknowns are x = (α, ln d, w) of [`Circle`]; the residuals are both rims' five numbers, seen less
//! predicted, h(x), with the derivatives J and the rims' information W:
//!
//! (Σ Jᵀ W J) δx = Σ Jᵀ W h      misfit = Σ hᵀ W h - δxᵀ Σ Jᵀ W h
//!
//! Of J the leading terms are taken, those left out being smaller by r, the circle's size as an angle:
//!
//! | | centre c | size h₀ | elongation h₃, turn h₄ |
//! | --- | --- | --- | --- |
//! | α | I | – | – |
//! | ln d | -2 r² n_z w | -1 | – |
//! | w | r² (n_z I - w wᵀ/n_z) | of N = -r² A⁻¹ (e wᵀ + w eᵀ) A⁻ᵀ | likewise |
//!
//! The start is the outer rim's own circle, and what the inner rim changes is little: one step of Gauss
//! and Newton is the solution, unless it moves the lean by more than a share of itself, over which the
//! elongation's derivative (2w) is another.
//!
//! With the other lean, -w, only the terms of ln d with α and w change their sign: one normal matrix,
//! and one inverse, serve both.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, SMatrix, Vector2, Vector3};

use super::{
    cone::{Circle, PER_ROOT},
    rim::Rim,
};

/// Over (α, ln d, w).
pub type Covariance5 = SMatrix<f64, 5, 5>;

/// A circle, and what is known of it.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    pub circle: Circle,
    pub covariance: Covariance5,
    /// Squared Mahalanobis length of what the circle leaves unexplained of both rims.
    pub misfit: f64,
}

/// Steps at most; one is the rule.
const MAX_STEPS: usize = 10;
/// A step whose square is this share of the lean's square, or less, is the last one.
const LAST_STEP: f64 = 0.02;

/// Fits both circles to both rims; `None` for one that leaves the space of circles in front of the
/// camera. The second one's lean is about the first one's reversed.
#[inline(always)]
pub fn refine_both(starts: &[Circle; 2], rims: &[Rim; 2]) -> [Option<Estimate>; 2] {
    let linear = Linear::of(&starts[0], rims);
    let Some(covariance) = linear.covariance() else { return [None, None] };
    let mirrored = mirrored(&covariance);
    let first = step(&starts[0], rims, &linear, &covariance, 1.0);
    let second = step(&starts[1], rims, &linear, &mirrored, -1.0);
    [finish(first, rims), finish(second, rims)]
}

/// An estimate after a step, and whether that was the last one.
type Step = Option<(Estimate, bool)>;

#[inline(always)]
fn finish(step: Step, rims: &[Rim; 2]) -> Option<Estimate> {
    match step? {
        (estimate, true) => Some(estimate),
        (estimate, false) => refine_on(&estimate.circle, rims),
    }
}

/// The rare steps after the first one.
#[inline(never)]
fn refine_on(start: &Circle, rims: &[Rim; 2]) -> Option<Estimate> {
    let mut circle = *start;
    for taken in 2..=MAX_STEPS {
        let linear = Linear::of(&circle, rims);
        let covariance = linear.covariance()?;
        let (estimate, is_last) = step(&circle, rims, &linear, &covariance, 1.0)?;
        if is_last || taken == MAX_STEPS {
            return Some(estimate);
        }
        circle = estimate.circle;
    }
    None
}

/// One step from a circle, with the derivatives at it (`sign` 1) or at its mirror image (-1).
#[inline(always)]
fn step(
    circle: &Circle,
    rims: &[Rim; 2],
    linear: &Linear,
    covariance: &Covariance5,
    sign: f64,
) -> Step {
    let mut right = [0.0; 5];
    let mut square = 0.0;
    for (rim, at) in rims.iter().zip(&linear.rims) {
        let left = circle.compare(rim);
        let weighted = rim.information.times(&left);
        for k in 0..5 {
            square += left[k] * weighted[k];
        }
        // The centre's part, in the plane, and the shape's.
        let i = &rim.inverse;
        let pull = Vector2::new(
            PER_ROOT * (i.m11 * weighted[1] + i.m21 * weighted[2]),
            PER_ROOT * (i.m12 * weighted[1] + i.m22 * weighted[2]),
        );
        right[0] += pull.x;
        right[1] += pull.y;
        right[2] += sign * (at.by_depth.x * pull.x + at.by_depth.y * pull.y) - weighted[0];
        for k in 0..2 {
            let [size, elongation, turn] = at.shape_by_lean[k];
            let shape = size * weighted[0] + elongation * weighted[3] + turn * weighted[4];
            right[3 + k] +=
                at.by_lean[(0, k)] * pull.x + at.by_lean[(1, k)] * pull.y + sign * shape;
        }
    }
    let mut change = [0.0; 5];
    let mut explained = 0.0;
    for row in 0..5 {
        for column in 0..5 {
            change[row] += covariance[(row, column)] * right[column];
        }
        explained += change[row] * right[row];
    }
    let tilted = circle.lean.norm_squared();
    let circle = circle.moved(&change)?;
    let turned = change[3] * change[3] + change[4] * change[4];
    let misfit = (square - explained).max(0.0);
    // A millionth of a radian is nothing, however upright the circle is.
    let is_last = turned <= LAST_STEP * tilted + 1e-12;
    Some((Estimate { circle, covariance: *covariance, misfit }, is_last))
}

/// The normal matrix at a circle, in blocks of place (α, ln d) and lean, and what it is made of.
struct Linear {
    rims: [LinearRim; 2],
    place: Matrix3<f64>,
    between: Matrix3x2<f64>,
    lean: Matrix2<f64>,
}

/// Derivatives of one rim's numbers.
struct LinearRim {
    /// Of the centre by ln d.
    by_depth: Vector2<f64>,
    /// Of the centre by w.
    by_lean: Matrix2<f64>,
    /// Of size, elongation and turn by either component of w.
    shape_by_lean: [[f64; 3]; 2],
}

impl Linear {
    #[inline(always)]
    fn of(circle: &Circle, rims: &[Rim; 2]) -> Self {
        let linear = [LinearRim::of(circle, &rims[0]), LinearRim::of(circle, &rims[1])];
        let mut place = Matrix3::zeros();
        let mut between = Matrix3x2::zeros();
        let mut lean = Matrix2::zeros();
        for (rim, at) in rims.iter().zip(&linear) {
            let (w, i) = (&rim.information, &rim.inverse);
            // Information about the centre in the plane.
            let p11 = 0.5 * (w.along * i.m11 * i.m11 + w.across * i.m21 * i.m21);
            let p12 = 0.5 * (w.along * i.m11 * i.m12 + w.across * i.m21 * i.m22);
            let p22 = 0.5 * (w.along * i.m12 * i.m12 + w.across * i.m22 * i.m22);
            let (g, t) = (&at.by_depth, &at.by_lean);
            let pg = (p11 * g.x + p12 * g.y, p12 * g.x + p22 * g.y);
            place.m11 += p11;
            place.m12 += p12;
            place.m22 += p22;
            place.m13 += pg.0;
            place.m23 += pg.1;
            place.m33 += g.x * pg.0 + g.y * pg.1 + w.size;
            let shape = &at.shape_by_lean;
            let mut weighted = [[0.0; 3]; 2];
            for k in 0..2 {
                let [size, elongation, turn] = shape[k];
                weighted[k] = [
                    w.size * size + w.size_and_elongation * elongation,
                    w.size_and_elongation * size + w.elongation * elongation,
                    w.turn * turn,
                ];
                let (tx, ty) = (t[(0, k)], t[(1, k)]);
                between[(0, k)] += p11 * tx + p12 * ty;
                between[(1, k)] += p12 * tx + p22 * ty;
                between[(2, k)] += pg.0 * tx + pg.1 * ty - weighted[k][0];
            }
            let dot = |a: &[f64; 3], b: &[f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            let pt1 = (p11 * t.m11 + p12 * t.m21, p12 * t.m11 + p22 * t.m21);
            let pt2 = (p11 * t.m12 + p12 * t.m22, p12 * t.m12 + p22 * t.m22);
            lean.m11 += t.m11 * pt1.0 + t.m21 * pt1.1 + dot(&shape[0], &weighted[0]);
            lean.m12 += t.m11 * pt2.0 + t.m21 * pt2.1 + dot(&shape[0], &weighted[1]);
            lean.m22 += t.m12 * pt2.0 + t.m22 * pt2.1 + dot(&shape[1], &weighted[1]);
        }
        Self { rims: linear, place, between, lean }
    }

    /// The inverse, by the complement of the place; `None` unless positive definite.
    #[inline(always)]
    fn covariance(&self) -> Option<Covariance5> {
        let place = inverse3(&self.place)?;
        let b = &self.between;
        let mut follow = [[0.0; 2]; 3];
        for row in 0..3 {
            for k in 0..2 {
                follow[row][k] = place[row][0] * b[(0, k)]
                    + place[row][1] * b[(1, k)]
                    + place[row][2] * b[(2, k)];
            }
        }
        let rest = |k: usize, l: usize, own: f64| {
            own - b[(0, k)] * follow[0][l] - b[(1, k)] * follow[1][l] - b[(2, k)] * follow[2][l]
        };
        let (r11, r12, r22) =
            (rest(0, 0, self.lean.m11), rest(0, 1, self.lean.m12), rest(1, 1, self.lean.m22));
        let determinant = r11 * r22 - r12 * r12;
        if !(determinant > 0.0 && r11 > 0.0) {
            return None;
        }
        let per = 1.0 / determinant;
        let (l11, l12, l22) = (r22 * per, -r12 * per, r11 * per);
        let mut all = Covariance5::zeros();
        (all[(3, 3)], all[(3, 4)], all[(4, 3)], all[(4, 4)]) = (l11, l12, l12, l22);
        for row in 0..3 {
            let cross = (
                -(follow[row][0] * l11 + follow[row][1] * l12),
                -(follow[row][0] * l12 + follow[row][1] * l22),
            );
            (all[(row, 3)], all[(3, row)]) = (cross.0, cross.0);
            (all[(row, 4)], all[(4, row)]) = (cross.1, cross.1);
            for column in 0..3 {
                all[(row, column)] =
                    place[row][column] - cross.0 * follow[column][0] - cross.1 * follow[column][1];
            }
        }
        Some(all)
    }
}

impl LinearRim {
    #[inline(always)]
    fn of(circle: &Circle, rim: &Rim) -> Self {
        let r2 = (rim.radius_m / circle.depth_m).powi(2);
        let (w, facing, i) = (&circle.lean, circle.facing(), &rim.inverse);
        let bend = -r2 / facing;
        let mixed = bend * w.x * w.y;
        let by_lean = Matrix2::new(
            r2 * facing + bend * w.x * w.x,
            mixed,
            mixed,
            r2 * facing + bend * w.y * w.y,
        );
        let v = (i.m11 * w.x + i.m12 * w.y, i.m21 * w.x + i.m22 * w.y);
        let shape = |p: (f64, f64)| {
            let (n11, n22) = (-2.0 * r2 * p.0 * v.0, -2.0 * r2 * p.1 * v.1);
            let n12 = -r2 * (p.0 * v.1 + p.1 * v.0);
            [0.25 * (n11 + n22), 0.25 * PER_ROOT * (n11 - n22), 0.5 * PER_ROOT * n12]
        };
        Self {
            by_depth: w * (-2.0 * r2 * facing),
            by_lean,
            shape_by_lean: [shape((i.m11, i.m21)), shape((i.m12, i.m22))],
        }
    }
}

/// The covariance of the circle with the other lean.
#[inline(always)]
fn mirrored(covariance: &Covariance5) -> Covariance5 {
    let mut mirrored = *covariance;
    for k in [0, 1, 3, 4] {
        mirrored[(2, k)] = -mirrored[(2, k)];
        mirrored[(k, 2)] = -mirrored[(k, 2)];
    }
    mirrored
}

/// The inverse of a symmetric positive definite matrix given by its upper triangle, by cofactors.
#[inline(always)]
fn inverse3(m: &Matrix3<f64>) -> Option<[[f64; 3]; 3]> {
    let c11 = m.m22 * m.m33 - m.m23 * m.m23;
    let c12 = m.m13 * m.m23 - m.m12 * m.m33;
    let c13 = m.m12 * m.m23 - m.m13 * m.m22;
    let determinant = m.m11 * c11 + m.m12 * c12 + m.m13 * c13;
    let c22 = m.m11 * m.m33 - m.m13 * m.m13;
    let c23 = m.m12 * m.m13 - m.m11 * m.m23;
    let c33 = m.m11 * m.m22 - m.m12 * m.m12;
    if !(determinant > 0.0 && c33 > 0.0 && m.m11 > 0.0) {
        return None;
    }
    let per = 1.0 / determinant;
    let (c12, c13, c23) = (c12 * per, c13 * per, c23 * per);
    Some([[c11 * per, c12, c13], [c12, c22 * per, c23], [c13, c23, c33 * per]])
}

impl Estimate {
    /// The lean with its covariance.
    #[inline(always)]
    pub fn lean(&self) -> (Vector2<f64>, Matrix2<f64>) {
        let c = &self.covariance;
        (self.circle.lean, Matrix2::new(c[(3, 3)], c[(3, 4)], c[(4, 3)], c[(4, 4)]))
    }

    /// The changes of the position by (α, ln d), and of the rotation by w, in the local frame.
    ///
    /// p = d (α, 1); the normal moves by δn = (δw, -(w·δw)/n_z), and the left rotation that does it,
    /// with nothing about the normal, is n × δn.
    #[inline(always)]
    pub fn changes(&self) -> ([Vector3<f64>; 3], [Vector3<f64>; 2]) {
        let Circle { aside, depth_m, lean } = self.circle;
        let normal = self.circle.normal();
        let turn =
            |x: f64, y: f64, along: f64| normal.cross(&Vector3::new(x, y, -along / normal.z));
        let place = [
            Vector3::new(depth_m, 0.0, 0.0),
            Vector3::new(0.0, depth_m, 0.0),
            Vector3::new(aside.x * depth_m, aside.y * depth_m, depth_m),
        ];
        (place, [turn(1.0, 0.0, lean.x), turn(0.0, 1.0, lean.y)])
    }
}
